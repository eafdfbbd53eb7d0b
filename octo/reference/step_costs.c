/* E of a step with exact derivatives: torques, centres of mass and contacts, chained together. After nodes.c. */

#if NCENTER > 0
/* Centre of mass of node t; with ``order``, its derivatives into rows ``first``… of s->chain: D_j = ∂com/∂q_j. */
static void octo_center(octo_nlp_scratch *s, int t, int order) {
  double mass[NB], moment[NB][3], total[3] = {0};
  const double *kin = s->kin[t];
  int first = NU + 3 * t;
  for (int b = 0; b < NB; ++b) {
    mass[b] = octo_body_mass[b];
    octo_place(kin + 12 * b, octo_body_com + 3 * b, moment[b]);
    for (int r = 0; r < 3; ++r) { moment[b][r] *= mass[b]; total[r] += moment[b][r]; }
  }
  for (int r = 0; r < 3; ++r) s->w[first + r] = total[r] / octo_mass;
  if (order < 1) return;
  for (int b = NB - 1; b > 0; --b) {
    int parent = octo_body_parent[b];
    if (parent < 0) continue;
    mass[parent] += mass[b];
    for (int r = 0; r < 3; ++r) moment[parent][r] += moment[b][r];
  }
  for (int r = 0; r < 3; ++r) memset(s->chain[first + r], 0, W3 * sizeof(double));
  for (int b = 0; b < NB; ++b)
    for (int j = octo_body_first[b]; j < octo_body_first[b + 1]; ++j) {
      const double *xi = kin + 12 * NB + 6 * j;
      double turn[3];
      octo_cross(xi, moment[b], turn);
      for (int r = 0; r < 3; ++r) s->chain[first + r][t * NX + j] = (turn[r] + mass[b] * xi[3 + r]) / octo_mass;
    }
}

/* hess += ∇²(e·com) of node t: e·(ω_i × D_j) for i an ancestor of j. */
static void octo_center_curvature(octo_nlp_scratch *s, int t) {
  const double *e = s->e_w + NU + 3 * t;
  if (e[0] == 0.0 && e[1] == 0.0 && e[2] == 0.0) return;
  for (int j = 0; j < NX; ++j) {
    double D[3], pull[3];
    for (int r = 0; r < 3; ++r) D[r] = s->chain[NU + 3 * t + r][t * NX + j];
    octo_cross(D, e, pull);
    for (int i = j; i >= 0; i = octo_before[i]) {
      double value = octo_dot(s->kin[t] + 12 * NB + 6 * i, pull);
      s->hess[(t * NX + i) * W3 + t * NX + j] += value;
      if (i != j) s->hess[(t * NX + j) * W3 + t * NX + i] += value;
    }
  }
}
#endif

#if NFC > 0
static double octo_contact_cost(octo_nlp_scratch *s, const double *p, int k, int order) {
  double e, g[18], K[18][18], along[18];
  int body = octo_touch_body[k], path[NX], count = 0;
  const double *arg[7] = {s->kin[0] + 12 * body, s->kin[1] + 12 * body, s->kin[2] + 12 * body, octo_touch_sphere + 4 * k, p, s->q, octo_touch_use + CR * k};
  double *res[3] = {&e, g, K[0]};
  if (order == 0) octo_touch0(arg, res, (void *)s->integers, s->memory, 0);
  else if (order == 1) octo_touch1(arg, res, (void *)s->integers, s->memory, 0);
  else octo_touch2(arg, res, (void *)s->integers, s->memory, 0);
  if (order < 1) return e;
  for (int j = octo_touch_dof[k]; j >= 0; j = octo_before[j]) path[count++] = j; /* descendants first */
  for (int t = 0; t < 3; ++t)
    for (int a = 0; a < count; ++a) {
      const double *xi = s->kin[t] + 12 * NB + 6 * path[a];
      for (int c = 0; c < 6; ++c) s->gradient[t * NX + path[a]] += xi[c] * g[6 * t + c];
    }
  if (order < 2) return e;
  for (int t = 0; t < 3; ++t)
    for (int b = 0; b < count; ++b) {
      const double *inner = s->kin[t] + 12 * NB + 6 * path[b];
      for (int a = 0; a < 18; ++a) {
        double sum = 0.0;
        for (int c = 0; c < 6; ++c) sum += K[a][6 * t + c] * inner[c];
        along[a] = sum;
      }
      for (int u = 0; u <= t; ++u)
        for (int a = u == t ? b : 0; a < count; ++a) {
          const double *outer = s->kin[u] + 12 * NB + 6 * path[a];
          double value = 0.0;
          for (int c = 0; c < 6; ++c) value += outer[c] * along[6 * u + c];
          int row = u * NX + path[a], column = t * NX + path[b];
          s->hess[row * W3 + column] += value;
          if (row != column) s->hess[column * W3 + row] += value;
        }
    }
  return e;
}
#endif

/* The step's torques and centres of mass, E, and at order 1 their derivatives: gradient to z and e_w. */
static double octo_nlp_cost(octo_nlp_scratch *s, const double *fd, const double *p, int order) {
  double e;
  for (int j = 0; j < NU; ++j) s->w[j] = fd[octo_ref_actuated[j]];
#if NCENTER > 0
  for (int t = 0; t < 2; ++t) octo_center(s, t, order);
#endif
  const double *arg[6] = {s->z[0], s->z[1], s->z[2], s->w, p, s->q};
  double *res[4] = {&e, s->gradient, s->e_w, s->second};
  if (order == 0) octo_exact0(arg, res, (void *)s->integers, s->memory, 0);
  else if (order == 1) octo_exact1(arg, res, (void *)s->integers, s->memory, 0);
  else octo_exact2(arg, res, (void *)s->integers, s->memory, 0);
  return e;
}

/* Everything but the dynamics' own curvature: gradient += Wᵀe_w, hess += the chain rule over w, contacts' terms. */
static double octo_nlp_chain(octo_nlp_scratch *s, const double *p, int order) {
  double e = 0.0;
  for (int a = 0; a < NU; ++a) memcpy(s->chain[a], s->jac + octo_ref_actuated[a] * W3, W3 * sizeof(double));
  for (int a = 0; a < NW; ++a)
    if (s->e_w[a] != 0.0) for (int j = 0; j < W3; ++j) s->gradient[j] += s->e_w[a] * s->chain[a][j];
  if (order == 2) {
    for (int z = 0; z < NZ; ++z) {
      int a = octo_exact_row[z], b = octo_exact_column[z];
      double value = s->second[z];
      if (b < W3) {
        s->hess[a * W3 + b] += value;
        if (a != b) s->hess[b * W3 + a] += value;
      } else if (a < W3) {
        const double *row = s->chain[b - W3];
        for (int j = 0; j < W3; ++j) { s->hess[a * W3 + j] += value * row[j]; s->hess[j * W3 + a] += value * row[j]; }
      } else if (value != 0.0) {
        const double *one = s->chain[a - W3], *other = s->chain[b - W3];
        for (int i = 0; i < W3; ++i) {
          double f = value * one[i], h = a == b ? 0.0 : value * other[i];
          if (f == 0.0 && h == 0.0) continue;
          for (int j = 0; j < W3; ++j) s->hess[i * W3 + j] += f * other[j] + h * one[j];
        }
      }
    }
#if NCENTER > 0
    for (int t = 0; t < 2; ++t) octo_center_curvature(s, t);
#endif
  }
#if NFC > 0
  for (int k = 0; k < NFC; ++k) e += octo_contact_cost(s, p, k, order);
#endif
  return e;
}
