/* Steps summed into f, g and their derivatives by the tables of nodes.c, and a point that is evaluated once. After step_costs.c. */

static void octo_add_vector(int i, const double *gradient, double *out) {
  for (int a = 0; a < T.local; ++a) {
    int block = T.local_block[i * T.local + a];
    if (block < 0) continue;
    for (int t = 0; t < 3; ++t) {
      double weight = T.weight[(i * 3 + t) * T.local + a];
      if (weight == 0.0) continue;
      for (int j = 0; j < NX; ++j) out[(size_t)block * NX + j] += weight * gradient[t * NX + j];
    }
  }
}

static void octo_add_jacobian(int i, const double *jac, const double *scale) {
#if MU > 0
  for (int k = 0; k < T.tests; ++k) {
    double test = T.test_value[i * T.tests + k];
    for (int a = 0; a < T.local; ++a) {
      int place = T.couple[(i * T.tests + k) * T.local + a];
      if (place < 0) continue;
      double *out = at.jacobian + (size_t)place * MU * NX;
      for (int t = 0; t < 3; ++t) {
        double weight = test * T.weight[(i * 3 + t) * T.local + a];
        if (weight == 0.0) continue;
        for (int r = 0; r < MU; ++r) {
          const double *row = jac + octo_ref_unactuated[r] * W3 + t * NX;
          for (int j = 0; j < NX; ++j) out[r * NX + j] += weight * scale[r] * row[j];
        }
      }
    }
  }
#endif
}

/* hessian += Wᵀ hess W: columns first, then rows, block by block. */
static void octo_add_hessian(int i, octo_nlp_scratch *s) {
  for (int b = 0; b < T.local; ++b) {
    int used = 0;
    for (int a = 0; a < T.local; ++a) used |= T.pair[(i * T.local + a) * T.local + b] >= 0;
    if (!used) continue;
    memset(s->half, 0, sizeof(s->half));
    for (int t = 0; t < 3; ++t) {
      double weight = T.weight[(i * 3 + t) * T.local + b];
      if (weight == 0.0) continue;
      for (int r = 0; r < W3; ++r)
        for (int j = 0; j < NX; ++j) s->half[r * NX + j] += weight * s->hess[r * W3 + t * NX + j];
    }
    for (int a = 0; a < T.local; ++a) {
      int place = T.pair[(i * T.local + a) * T.local + b];
      if (place < 0) continue;
      double *out = at.hessian + (size_t)place * NX * NX;
      for (int t = 0; t < 3; ++t) {
        double weight = T.weight[(i * 3 + t) * T.local + a];
        if (weight == 0.0) continue;
        for (int e = 0; e < NX * NX; ++e) out[e] += weight * s->half[t * NX * NX + e];
      }
    }
  }
}

static void octo_add_rows(int i, const double *fd, const double *scale, double *g) {
#if MU > 0
  for (int k = 0; k < T.tests; ++k) {
    int row = T.test_row[i * T.tests + k];
    if (row < 0) continue;
    for (int r = 0; r < MU; ++r) g[row + r] += T.test_value[i * T.tests + k] * scale[r] * fd[octo_ref_unactuated[r]];
  }
#endif
}

/* hess = the whole of the curvature that octo_step writes by blocks (HESS in phases.c). */
static void octo_unfold(const double *curvature, double *hess) {
  static const int row[] = {0, 0, 0, 1, 2, 1}, column[] = {0, 1, 2, 1, 2, 2};
  memset(hess, 0, W3 * W3 * sizeof(double));
  for (int k = 0; k < CURVATURE; ++k)
    for (int i = 0; i < NX; ++i)
      for (int j = 0; j < NX; ++j) {
        int a = row[k] * NX + i, b = column[k] * NX + j;
        hess[a * W3 + b] = hess[b * W3 + a] = curvature[(k * NX + i) * NX + j];
      }
}

/* Multipliers of the step's FD: those of its rows, and ∂E/∂u of its torques. */
static void octo_pull(int i, octo_nlp_scratch *s, const double *scale, const double *lam) {
  for (int j = 0; j < NX; ++j) s->lam[j] = 0.0;
  for (int j = 0; j < NU; ++j) s->lam[octo_ref_actuated[j]] = s->e_w[j];
#if MU > 0
  for (int k = 0; lam && k < T.tests; ++k) {
    int row = T.test_row[i * T.tests + k];
    if (row < 0) continue;
    for (int r = 0; r < MU; ++r) s->lam[octo_ref_unactuated[r]] += T.test_value[i * T.tests + k] * scale[r] * lam[row + r];
  }
#endif
}

static void octo_derive_step(int i, int order, octo_nlp_scratch *s, const double *dynamics, const double *scale, const double *lam) {
  double *fd = at.fd + (size_t)i * NX;
  if (order == 0) {
    octo_step(s->z[0], s->z[1], s->z[2], s->kin[0], s->kin[1], s->kin[2], dynamics, 0, 0, fd, 0, 0, s->work);
    at.f += octo_nlp_cost(s, fd, dynamics, 0);
#if NFC > 0
    for (int k = 0; k < NFC; ++k) at.f += octo_contact_cost(s, dynamics, k, 0);
#endif
    octo_add_rows(i, fd, scale, at.g);
    return;
  }
  octo_nlp_cost(s, fd, dynamics, order); /* FD of this point is known */
  if (order == 1) {
    octo_step(s->z[0], s->z[1], s->z[2], s->kin[0], s->kin[1], s->kin[2], dynamics, 0, 1, fd, s->jac, 0, s->work);
    octo_nlp_chain(s, dynamics, 1);
    octo_carry_back(i, s->gradient, 1);
    for (int r = 0; r < MU; ++r) octo_carry_back(i, s->jac + octo_ref_unactuated[r] * W3, 1);
    octo_add_vector(i, s->gradient, at.gradient);
    octo_add_jacobian(i, s->jac, scale);
    return;
  }
  octo_pull(i, s, scale, lam);
  octo_step(s->z[0], s->z[1], s->z[2], s->kin[0], s->kin[1], s->kin[2], dynamics, s->lam, 2, fd, s->jac, s->curvature, s->work);
  octo_unfold(s->curvature, s->hess);
  octo_nlp_chain(s, dynamics, 2);
  for (int r = 0; r < MU; ++r) { /* the gradient of the Lagrangian, beside its curvature */
    double value = s->lam[octo_ref_unactuated[r]];
    for (int j = 0; j < W3; ++j) s->gradient[j] += value * s->jac[octo_ref_unactuated[r] * W3 + j];
  }
  octo_carry_back(i, s->gradient, 1);
  for (int r = 0; r < W3; ++r) octo_carry_back(i, s->hess + r * W3, 1);
  for (int c = 0; c < W3; ++c) octo_carry_back(i, s->hess + c, W3);
  octo_add_vector(i, s->gradient, at.lagrangian);
  octo_add_hessian(i, s);
}

static void octo_derive(int order, double sigma, const double *lam) {
  const double *dynamics = at.p + (T.steps + 2) * NX, *q = dynamics + NP, *scale = q + (size_t)T.steps * NQ;
  octo_nlp_scratch *s = at.scratch;
  for (int t = 0; t < 3; ++t) s->known[t] = 0;
  for (int i = 0; i < T.steps; ++i) {
    octo_nlp_nodes(s, at.x, at.p, i);
    memcpy(s->q, q + (size_t)i * NQ, NQ * sizeof(double));
    if (order == 2) for (int k = 0; k < NTERM; ++k) s->q[k] *= sigma;
    octo_derive_step(i, order, s, dynamics, scale, lam);
  }
}

/* Make the values (and first derivatives) of x known. */
static void octo_point(const double *x, const double *p, int order) {
  if (at.order < 0 || memcmp(x, at.x, T.variables * sizeof(double)) || memcmp(p, at.p, at.numbers * sizeof(double))) {
    memcpy(at.x, x, T.variables * sizeof(double));
    memcpy(at.p, p, at.numbers * sizeof(double));
    at.f = 0.0;
    memset(at.g, 0, T.rows * sizeof(double));
    octo_derive(0, 1.0, 0);
    for (int k = 0; k < T.linear; ++k) at.g[T.linear_row[k]] += T.linear_value[k] * x[T.linear_column[k]];
    at.order = 0;
  }
  if (order == 1 && at.order < 1) {
    memset(at.gradient, 0, T.variables * sizeof(double));
    memset(at.jacobian, 0, (size_t)T.couples * MU * NX * sizeof(double));
    octo_derive(1, 1.0, 0);
    at.order = 1;
  }
}

static void octo_point_hessian(const double *x, const double *p, double sigma, const double *lam) {
  octo_point(x, p, 0);
  memset(at.lagrangian, 0, T.variables * sizeof(double));
  memset(at.hessian, 0, (size_t)T.pairs * NX * NX * sizeof(double));
  octo_derive(2, sigma, lam);
  for (int k = 0; lam && k < T.linear; ++k) at.lagrangian[T.linear_column[k]] += T.linear_value[k] * lam[T.linear_row[k]];
}
