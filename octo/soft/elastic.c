/* Elastic forces and Rayleigh's damping of the modes, after step.c, by the formulas of elastic.py. With NPRODUCT products z_i z_j
 * the energy is ½ wᵀGw of w = (z, z_i z_j), St. Venant–Kirchhoff's; without, ½ zᵀΛz. */

#define NSTVK (NMODE + NPRODUCT)

#if NPRODUCT > 0
/* G v (NSTVK). */
static inline void octo_gram_times(const real *v, real *out) {
  for (int m = 0; m < NSTVK; ++m) out[m] = ZERO;
  for (int q = 0; q < NSTVK; ++q)
    for (int m = 0; m < NSTVK; ++m) out[m] += v[q] * octo_gram[NSTVK * q + m];
}

/* out[k] += Σ_m v_m ∂w_m/∂z_k at z; ``linear``: with the part of z itself. */
static inline void octo_stvk_pull(const real *v, const real *z, int linear, double factor, real *out) {
  for (int k = 0; linear && k < NMODE; ++k) out[k] += factor * v[k];
  for (int m = 0; m < NPRODUCT; ++m) {
    const int i = octo_first_of[m], j = octo_second_of[m];
    out[i] += factor * v[NMODE + m] * z[j];
    out[j] += factor * v[NMODE + m] * z[i];
  }
}

/* out += factor Σ_ij v_ij ∂²(z_i z_j), rows ``stride`` apart. */
static inline void octo_stvk_paired(const real *v, double factor, real *out, int stride) {
  for (int m = 0; m < NPRODUCT; ++m) {
    const int i = octo_first_of[m], j = octo_second_of[m];
    out[i * stride + j] += factor * v[NMODE + m];
    out[j * stride + i] += factor * v[NMODE + m];
  }
}

/* Column k of G ∂w/∂z. */
static inline void octo_stvk_column(const real *z, int k, real *out) {
  for (int m = 0; m < NSTVK; ++m) out[m] = ZERO + octo_gram[NSTVK * k + m];
  for (int q = 0; q < NPRODUCT; ++q) {
    const int i = octo_first_of[q], j = octo_second_of[q];
    if (i != k && j != k) continue;
    const real by = i == j ? 2.0 * z[k] : z[i == k ? j : i];
    for (int m = 0; m < NSTVK; ++m) out[m] += by * octo_gram[NSTVK * (NMODE + q) + m];
  }
}

/* Forces, tangent and curvature of the energy; lam: of the modes. */
APART void octo_add_stvk(const octo_input *in, octo_work *s, double factor, real *fd, real *jac, real *hess) {
  const real *z = in->x[0] + 6;
  real w[NSTVK], g[NSTVK], both[NMODE];
  for (int k = 0; k < NMODE; ++k) w[k] = z[k];
  for (int m = 0; m < NPRODUCT; ++m) w[NMODE + m] = z[octo_first_of[m]] * z[octo_second_of[m]];
  octo_gram_times(w, g);
  octo_stvk_pull(g, z, 1, factor, fd + 6);
  if (in->order == 0) return;
  octo_stvk_paired(g, factor, jac + 6 * 3 * NX + 6, 3 * NX);
  for (int k = 0; k < NMODE; ++k) {
    octo_stvk_column(z, k, g);
    octo_stvk_pull(g, z, 1, factor, jac + (6 + k) * 3 * NX + 6); /* the tangent is symmetric: its row */
    if (in->order < 2) continue;
    for (int l = 0; l < NMODE; ++l) both[l] = ZERO;
    octo_stvk_pull(g, in->lam + 6, 0, factor, both);
    for (int l = 0; l < NMODE; ++l) {
      hess[(6 + k) * NX + 6 + l] += both[l];
      hess[(6 + l) * NX + 6 + k] += both[l];
    }
  }
  if (in->order < 2) return;
  for (int k = 0; k < NMODE; ++k) w[k] = in->lam[6 + k];
  for (int m = 0; m < NPRODUCT; ++m) {
    const int i = octo_first_of[m], j = octo_second_of[m];
    w[NMODE + m] = in->lam[6 + i] * z[j] + in->lam[6 + j] * z[i];
  }
  octo_gram_times(w, g);
  octo_stvk_paired(g, factor, hess + 6 * NX + 6, NX);
}
#endif

/* Adds them to FD, J and, where the energy is no square, H, which are written. */
APART void octo_add_elastic(const octo_input *in, octo_work *s, real *fd, real *jac, real *hess) {
  const double dt = in->p[DT], *own = in->p + ELASTIC; /* stiffness, alpha, beta */
  for (int k = 0; k < NMODE; ++k)
    for (int l = 0; l < NMODE; ++l) {
      const double stiff = own[0] * octo_stiffness[NMODE * k + l], damping = (own[1] * octo_modal[NMODE * k + l] + own[2] * stiff) / dt;
      const real z = in->x[0][6 + l];
      fd[6 + k] += damping * (z - in->x[1][6 + l]);
#if NPRODUCT == 0
      fd[6 + k] += stiff * z;
#endif
      if (in->order == 0) continue;
      real *at = jac + (6 + k) * 3 * NX + 6 + l;
      at[0] += NPRODUCT == 0 ? stiff + damping : damping;
      at[NX] -= damping;
    }
#if NPRODUCT > 0
  octo_add_stvk(in, s, own[0], fd, jac, hess);
#endif
}
