/* Contacts between bodies, after tree.c and pairs.c: a sphere of body A against a solid of body B (between_bodies.py).
 *
 * The wrench on each body and the blocks that its own twists see are kept as a contact's and compose down the tree. Two
 * branches are coupled by what the twists of one do to the other. With ξ_j of the next node, ξ'_j of the present one, η_j of
 * tree.c, and i on one body, j on the other:
 *   J_ij += ξ_iᵀ C ξ_j, of the present node −ξ_iᵀ B ξ'_j, with C = W − P of A's row and −P of B's,
 *   H00_ij −= ξ_jᵀ K ξ_i (i on A), H01_ij −= ξ_iᵀ T ξ'_j, H11_ij −= ξ'_jᵀ L ξ'_i (i on A), and C with η in place of ξ.
 * Common ancestors move both. */

#if NMUTUAL > 0

typedef struct { real xi[6], now[6], eta[6], right[2][2][6], bend[2][2][6], own[2][6]; int moves; } octo_mutual_reach_of;

typedef struct {
  octo_touch_blocks of[NMUTUAL];                 /* what A sees of itself */
  octo_mutual_reach_of reach[SOME(NMUTUALREACH)]; /* of the contact at hand, a degree of freedom each */
} octo_mutuals;

/* Adds to an entry of J, and to entries (i, j) of H01, and (i, j) and (j, i) of H00 (block 0) or H11 (block 3). */
static inline void octo_element_jacobian(int node, int i, int j, real value, real *jac);
static inline void octo_element_mixed(int i, int j, real value, real *hess);
static inline void octo_element_symmetric(int block, int i, int j, real value, real *hess);

/* sum += sign·(W·v), the form w·[·, v] of a wrench. */
static inline void octo_bracket(const real *w, const real *v, double sign, real *sum) {
  for (int r = 0; r < 3; ++r) {
    int a = (r + 1) % 3, b = (r + 2) % 3;
    sum[r] -= sign * (w[a] * v[b] - w[b] * v[a] + w[3 + a] * v[3 + b] - w[3 + b] * v[3 + a]);
    sum[3 + r] -= sign * (w[3 + a] * v[b] - w[3 + b] * v[a]);
  }
}

/* Entry (row, column) of W. */
static inline real octo_bracket_at(const real *w, int row, int column) {
  if ((row >= 3 && column >= 3) || row % 3 == column % 3) return ZERO;
  const real *v = row < 3 && column < 3 ? w : w + 3;
  row %= 3, column %= 3;
  return column == (row + 1) % 3 ? v[3 - row - column] : -v[3 - row - column];
}

/* What A (side 0) sees of itself, added to its link, or what B sees: −w; P − W, B; Kᵀ, T, Lᵀ. */
static inline void octo_mutual_add(const octo_touch_blocks *a, int side, int order, octo_link_blocks *to) {
  EACH(e, 6) to->W[e] += side == 0 ? a->W[e] : -a->W[e];
  if (order < 1) return;
  EACH(e, 36) {
    real own = a->B[0][e];
    if (side == 1) own -= octo_bracket_at(a->W, e / 6, e % 6);
    to->B[0][e] += own;
    to->B[1][e] += a->B[1][e];
  }
  if (order < 2) return;
  EACH(e, 36) {
    int turned = side == 0 ? e : 6 * (e % 6) + e / 6;
    to->T[0][e] += a->T[0][turned];
    to->T[1][e] += a->T[1][e];
    to->L[0][e] += a->L[turned];
  }
}

/* Lanes out of reach have no contact. */
static inline void octo_mutual_cut(octo_mask active, int order, octo_touch_blocks *k) {
#ifdef WHERE
  const int counts[3] = {order == 0 ? 6 : 78, order == 2 ? 72 : 0, order == 2 ? 36 : 0};
  real *from[3] = {k->W, k->T[0], k->L};
  for (int part = 0; part < 3; ++part)
    for (int e = 0; e < counts[part]; ++e) from[part][e] = WHERE(active, from[part][e]);
#endif
}

/* The contact m; V: of every degree of freedom, read in order 2. One that is out of reach is skipped, a NaN is not. */
static inline void octo_mutual(const octo_input *in, int m, const real (*V)[6], octo_touch_blocks *k) {
  const int *body = octo_mutual_body + 2 * m, *link = octo_mutual_link + 2 * m;
  const double *sphere = octo_mutual_sphere + 4 * m, *solid = octo_mutual_solid + 16 * m;
  const real *a = in->kin[0] + 12 * body[0], *b = in->kin[0] + 12 * body[1];
  real center[3], gap, both[12], *depth[1] = {&gap};
  octo_place(a, sphere, center);
  const ARGUMENT *place[5] = {center, b, sphere + 3, solid, in->p};
  octo_mutual_reach(octo_mutual_kind[m], place, depth);
  k->active = NOT(gap <= 0.0);
  if (!ANY(k->active)) return;
  for (int side = 0; side < 2; ++side)
    for (int c = 0; c < 6; ++c) both[6 * side + c] = in->order == 2 && link[side] >= 0 ? V[octo_link_last[link[side]]][c] : ZERO;
  const ARGUMENT *arg[8] = {a, in->kin[1] + 12 * body[0], b, in->kin[1] + 12 * body[1], sphere, solid, in->p, both};
  real *res[6] = {k->W, k->B[0], k->B[1], k->T[0], k->T[1], k->L};
  octo_mutual_stage(octo_mutual_kind[m], in->order, arg, res);
  octo_mutual_cut(k->active, in->order, k);
}

#if NMUTUALREACH > 0

/* sum −= block·v, or blockᵀ·v. */
static inline void octo_less(const real *block, const real *v, real *sum) {
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) sum[r] -= block[6 * r + c] * v[c];
}
static inline void octo_less_transposed(const real *block, const real *v, real *sum) {
  for (int c = 0; c < 6; ++c)
    for (int r = 0; r < 6; ++r) sum[r] -= block[6 * c + r] * v[c];
}

static inline real octo_six(const real *a, const real *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
}

/* The twists of degree of freedom j, and what stands on the right of those of the other body: ``[0]`` where that is A. */
static void octo_mutual_products(const octo_input *in, int j, int moves, const real (*V)[6], const octo_touch_blocks *a, octo_mutual_reach_of *q) {
  q->moves = moves;
  for (int c = 0; c < 6; ++c) {
    q->xi[c] = in->kin[0][12 * NB + 6 * j + c];
    q->now[c] = in->kin[1][12 * NB + 6 * j + c];
  }
  for (int side = 0; side < 2; ++side)
    for (int c = 0; c < 6; ++c)
      q->right[0][side][c] = q->right[1][side][c] = q->bend[0][side][c] = q->bend[1][side][c] = q->own[side][c] = ZERO;
  if (in->order == 2) octo_turned(in, V[j], j, q->eta);
  for (int side = 0; side < 2; ++side) {
    if (!(moves >> !side & 1)) continue;
    octo_less(a->B[0], q->xi, q->right[0][side]);
    if (side == 0) octo_bracket(a->W, q->xi, 1.0, q->right[0][0]);
    octo_less(a->B[1], q->now, q->right[1][side]);
    if (in->order < 2) continue;
    octo_less_transposed(a->B[0], q->eta, q->bend[0][side]);
    if (side == 0) {
      octo_less_transposed(a->T[0], q->xi, q->bend[0][0]);
      octo_less_transposed(a->L, q->now, q->own[0]);
    } else {
      octo_bracket(a->W, q->eta, -1.0, q->bend[0][1]);
      octo_less(a->T[0], q->xi, q->bend[0][1]);
      octo_less(a->L, q->now, q->own[1]);
    }
    octo_less(a->T[1], q->now, q->bend[1][side]);
  }
}

/* Σ over the bodies that move: v of the row's twist times what stands on the right. */
static inline real octo_of_moved(int moves, const real *v, const real (*right)[6]) {
  real sum = ZERO;
  for (int side = 0; side < 2; ++side)
    if (moves >> side & 1) sum += octo_six(v, right[side]);
  return sum;
}

#endif

/* Adds what couples two branches; says whether there is anything. */
static int octo_write_mutuals(const octo_input *in, octo_mutuals *s, const real (*V)[6], real *jac, real *hess) {
  int touching = 0;
#if NMUTUALREACH > 0
  for (int m = 0; m < NMUTUAL && in->order > 0; ++m) {
    const octo_touch_blocks *k = &s->of[m];
    const int start = octo_mutual_start[m], count = octo_mutual_start[m + 1] - start, *dof = octo_mutual_dof + start;
    if (!ANY(k->active)) continue;
    touching = 1;
    BARRIER;
    EACH(n, count) octo_mutual_products(in, dof[n], octo_mutual_moves[start + n], V, k, &s->reach[n]);
    BARRIER;
    GRID(n, count, l, count) {
      const octo_mutual_reach_of *a = &s->reach[n], *b = &s->reach[l];
      for (int node = 0; node < 2; ++node) octo_element_jacobian(node, dof[n], dof[l], octo_of_moved(a->moves, a->xi, b->right[node]), jac);
      if (in->order < 2) continue;
      real mixed = octo_of_moved(a->moves, a->xi, b->bend[1]) + octo_of_moved(a->moves, a->eta, b->right[1]);
      octo_element_mixed(dof[n], dof[l], mixed, hess);
      if (l < n) continue;
      real value = octo_of_moved(a->moves, a->xi, b->bend[0]) + octo_of_moved(a->moves, a->eta, b->right[0]);
      octo_element_symmetric(0, dof[n], dof[l], value, hess);
      octo_element_symmetric(3, dof[n], dof[l], octo_of_moved(a->moves, a->now, b->own), hess);
    }
  }
#endif
  return touching;
}

#endif
