/* Elements, after tree.c and pairs.c: forces between points of two bodies (elements.py).
 *
 * What a force does to its own body is kept as a contact's and composes down the tree. Two branches are coupled by the
 * derivatives C of the force on one point with respect to the other one. With D_j = ∂P/∂q_j of the two points at the next node,
 * D'_j at the present one, and E_j = ∂δ/∂q_j of δ = Σ lam_i D_i, which is ω_j × δ and the velocity by η_j:
 *   J_ij += D_iᵀ C D_j, of the present node D_iᵀ C' D'_j,   H00_ij += D_iᵀ (S D_j + Cᵀ E_j) + E_iᵀ C D_j,
 *   H01_ij += D_iᵀ S1 D'_j + E_iᵀ C' D'_j,   H11_ij += D'_iᵀ S2 D'_j,
 * where C, S, S1 and S2 couple different points only. Common ancestors move both. */

#if NELEMENT > 0

typedef struct {
  real point[12];                      /* m, a and b of the next node, then of the present one */
  real C[2][2][9], S[9], S1[2][9], S2[9]; /* C of each node, of each point */
} octo_element_state;

typedef struct { real D[2][3], now[2][3], E[2][3], right[2][2][3], bend[2][2][3], own[2][3]; } octo_element_reach;

typedef struct {
  octo_element_state element[NELEMENT];
  octo_element_reach reach[SOME(NREACH)]; /* of the element at hand, a degree of freedom each */
} octo_elements;

/* Adds to an entry of J, and to entries (i, j) of H01, and (i, j) and (j, i) of H00 (block 0) or H11 (block 3). */
static inline void octo_element_jacobian(int node, int i, int j, real value, real *jac);
static inline void octo_element_mixed(int i, int j, real value, real *hess);
static inline void octo_element_symmetric(int block, int i, int j, real value, real *hess);

/* Part 0, 1 or 2 of the stage of element e: what the links of a and of b get, and what couples them. V: of every degree of
 * freedom, read in order 2. */
static inline void octo_element(const octo_input *in, int e, int part, const real (*V)[6], octo_touch_blocks *ends, octo_element_state *k) {
  const int *link = octo_element_link + 2 * e;
  if (part < 2 ? link[part] < 0 : link[0] < 0 || link[1] < 0 || in->order == 0) return;
  const double *places = octo_element_points + 6 * e;
  real points[12], both[12], zero = ZERO, *res[8];
  for (int side = 0; side < 2; ++side) {
    int body = octo_element_body[2 * e + side];
    for (int node = 0; node < 2; ++node) {
      real *point = points + 6 * node + 3 * side;
      for (int r = 0; r < 3; ++r) point[r] = ZERO + places[3 * side + r];
      if (body >= 0) octo_place(in->kin[node] + 12 * body, places + 3 * side, point);
    }
    for (int c = 0; c < 6; ++c) both[6 * side + c] = in->order == 2 && link[side] >= 0 ? V[octo_link_last[link[side]]][c] : ZERO;
  }
  if (part < 2) {
    octo_touch_blocks *end = ends + octo_element_end[2 * e + part];
    end->active = NOT(zero > 0.0);
    res[0] = end->W, res[1] = end->B[0], res[2] = end->B[1], res[3] = end->T[0], res[4] = end->T[1], res[5] = end->L;
  } else {
    for (int c = 0; c < 12; ++c) k->point[c] = points[c];
    for (int c = 0; c < 4; ++c) res[c] = k->C[c / 2][c % 2];
    res[4] = k->S, res[5] = k->S1[0], res[6] = k->S1[1], res[7] = k->S2;
  }
  const ARGUMENT *arg[4] = {points, in->p + octo_element_parameter[e], in->p, both};
  octo_element_stage(3 * octo_element_kind[e] + part, in->order, arg, res);
}

#if NREACH > 0
/* Velocity of a point by a twist. */
static inline void octo_point_velocity(const real *twist, const real *point, real *out) {
  octo_cross(twist, point, out);
  for (int r = 0; r < 3; ++r) out[r] += twist[3 + r];
}

/* sum += block·v, or blockᵀ·v. */
static inline void octo_couple(const real *block, const real *v, real *sum) {
  for (int r = 0; r < 3; ++r) sum[r] += octo_dot(block + 3 * r, v);
}
static inline void octo_couple_transposed(const real *block, const real *v, real *sum) {
  for (int r = 0; r < 3; ++r) sum[r] += block[r] * v[0] + block[3 + r] * v[1] + block[6 + r] * v[2];
}

/* D, D' and E of degree of freedom j, zero of a point that it does not move. */
static void octo_reach_motion(const octo_input *in, int e, int j, int moves, const real (*V)[6], const octo_element_state *k, octo_element_reach *q) {
  const real *next = in->kin[0] + 12 * NB + 6 * j, *now = in->kin[1] + 12 * NB + 6 * j;
  real eta[6];
  if (in->order == 2) octo_turned(in, V[j], j, eta);
  for (int side = 0; side < 2; ++side) {
    const real *point = k->point + 3 * side;
    for (int r = 0; r < 3; ++r) q->D[side][r] = q->now[side][r] = q->E[side][r] = ZERO;
    if (!(moves >> side & 1)) continue;
    octo_point_velocity(next, point, q->D[side]);
    octo_point_velocity(now, point + 6, q->now[side]);
    if (in->order < 2) continue;
    real delta[3], turned[3];
    octo_point_velocity(V[octo_link_last[octo_element_link[2 * e + side]]], point, delta);
    octo_cross(next, delta, turned);
    octo_point_velocity(eta, point, q->E[side]);
    for (int r = 0; r < 3; ++r) q->E[side][r] += turned[r];
  }
}

/* What stands on the right of D_i, E_i and D'_i. */
static void octo_reach_products(const octo_element_state *k, int order, octo_element_reach *q) {
  for (int side = 0; side < 2; ++side) {
    const int other = !side;
    for (int node = 0; node < 2; ++node)
      for (int r = 0; r < 3; ++r) q->right[node][side][r] = q->bend[node][side][r] = q->own[side][r] = ZERO;
    octo_couple(k->C[0][side], q->D[other], q->right[0][side]);
    octo_couple(k->C[1][side], q->now[other], q->right[1][side]);
    if (order < 2) continue;
    octo_couple_transposed(k->C[0][other], q->E[other], q->bend[0][side]);
    octo_couple(k->S1[side], q->now[other], q->bend[1][side]);
    if (side == 0) { octo_couple(k->S, q->D[1], q->bend[0][0]); octo_couple(k->S2, q->now[1], q->own[0]); }
    else { octo_couple_transposed(k->S, q->D[0], q->bend[0][1]); octo_couple_transposed(k->S2, q->now[0], q->own[1]); }
  }
}

static inline real octo_of_both(const real (*a)[3], const real (*b)[3]) { return octo_dot(a[0], b[0]) + octo_dot(a[1], b[1]); }
#endif

/* Adds what couples two branches. */
static void octo_write_elements(const octo_input *in, octo_elements *s, const real (*V)[6], real *jac, real *hess) {
#if NREACH > 0
  for (int e = 0; e < NELEMENT && in->order > 0; ++e) {
    const int start = octo_element_start[e], count = octo_element_start[e + 1] - start, *dof = octo_element_dof + start;
    const octo_element_state *k = &s->element[e];
    BARRIER;
    EACH(m, count) {
      octo_reach_motion(in, e, dof[m], octo_element_moves[start + m], V, k, &s->reach[m]);
      octo_reach_products(k, in->order, &s->reach[m]);
    }
    BARRIER;
    GRID(m, count, n, count) {
      const octo_element_reach *a = &s->reach[m], *b = &s->reach[n];
      for (int node = 0; node < 2; ++node) octo_element_jacobian(node, dof[m], dof[n], octo_of_both(a->D, b->right[node]), jac);
      if (in->order < 2) continue;
      octo_element_mixed(dof[m], dof[n], octo_of_both(a->D, b->bend[1]) + octo_of_both(a->E, b->right[1]), hess);
      if (n < m) continue;
      octo_element_symmetric(0, dof[m], dof[n], octo_of_both(a->D, b->bend[0]) + octo_of_both(a->E, b->right[0]), hess);
      octo_element_symmetric(3, dof[m], dof[n], octo_of_both(a->now, b->own), hess);
    }
  }
#endif
}

#endif
