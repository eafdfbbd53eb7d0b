/* STEPS time steps, after tree.c and pairs.c: link by link, leaves first, so that a link's blocks are still near.
 *
 * What stands for jac and hess is kept by slots (codegen.py says which number of the layout of phases.c is in which): slot 0
 * is zero; then, a run of NRELATED for every kind of entry, those of j and its ancestors i, from j = 0 on and up from each j;
 * then what the pairs alone couple. */

#define JAC_SLOTS (1 + 6 * NRELATED + NCOUPLED)
#define HESS_SLOTS (1 + 9 * NRELATED + NCOUPLED) /* the last two runs are of block 12, which is not written here */

/* Adds more to a link's composite: to the blocks of its curvature, order 2. */
typedef void octo_adder(void *from, const octo_input *in, int link, octo_link_blocks *to);

typedef struct {
  octo_link_blocks link[SOME(NSLOT)];
  octo_touch_blocks touch;
  octo_mask active[SOME(NC)]; /* of each contact, in the step that was evaluated last */
#if NCROWD > 0
  unsigned char members[NMEMBER]; /* of each member of a crowd the same, a bit for each lane */
  int evaluated; /* steps */
  octo_crowd_fronts fronts; /* of the groups before, x_next */
#endif
  octo_adder *adder; void *adds; /* or NULL, and what it gets as ``from`` */
  octo_loops pairs;
#if NELEMENT > 0
  octo_elements elements;
  octo_touch_blocks end[SOME(NEND)];
#endif
#if NMUTUAL > 0
  octo_mutuals mutuals;
#endif
  real V[SOME(NX)][6], eta[SOME(NX)][6]; /* order 2: virtual twists V_j = Σ_{a ⪯ j} lam_a ξ_a, and η_j = ad_{V_j} ξ_j */
} octo_work;

static inline void octo_work_begin(octo_work *s) {
  s->adder = 0;
#if NCROWD > 0
  s->evaluated = 0;
  octo_crowd_forget(&s->fronts);
#endif
}

static inline real octo_along(const real *a, const real *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
}

/* sum += block·v and += blockᵀ·v. */
static inline void octo_apply(const real *block, const real *v, real *sum) {
  for (int r = 0; r < 6; ++r) sum[r] += octo_along(block + 6 * r, v);
}
static inline void octo_apply_transposed(const real *block, const real *v, real *sum) {
  for (int r = 0; r < 6; ++r)
    sum[r] += block[r] * v[0] + block[6 + r] * v[1] + block[12 + r] * v[2] + block[18 + r] * v[3] + block[24 + r] * v[4] + block[30 + r] * v[5];
}

/* sum += P2·v with P2 = Pᵀ − [[m×, f×], [f×, 0]]. */
static inline void octo_apply_lower(const real *P, const real *W, const real *v, real *sum) {
  octo_apply_transposed(P, v, sum);
  for (int r = 0; r < 3; ++r) {
    int a = (r + 1) % 3, b = (r + 2) % 3;
    sum[r] -= W[a] * v[b] - W[b] * v[a] + W[3 + a] * v[3 + b] - W[3 + b] * v[3 + a];
    sum[3 + r] -= W[3 + a] * v[b] - W[3 + b] * v[a];
  }
}

static inline void octo_add(int count, const real *from, real *to) {
  for (int e = 0; e < count; ++e) to[e] += from[e];
}
static inline void octo_add_where(octo_mask active, int count, const real *from, real *to) {
  for (int e = 0; e < count; ++e) to[e] += WHERE(active, from[e]);
}

/* A link's composite: its own stage, its contacts, the ends of elements on it, the links that it carries. */
static void octo_composite(const octo_input *in, octo_work *s, int l) {
  const int order = in->order;
  octo_link_blocks *to = &s->link[octo_link_slot[l]];
  const real *V = s->V[octo_link_last[l]];
  octo_body(in, l, V, to);
#if NC > 0
  for (int c = 0; c < NC; ++c) {
    octo_touch_blocks *k = &s->touch;
    if (octo_contact_link[c] != l) continue;
    octo_contact(in, c, V, k);
    s->active[c] = k->active;
    if (!ANY(k->active)) continue;
    octo_add_where(k->active, order == 0 ? 6 : 78, k->W, to->W);
    if (order == 2) { octo_add_where(k->active, 72, k->T[0], to->T[0]); octo_add_where(k->active, 36, k->L, to->L[0]); }
  }
#endif
#if NCROWD > 0
  for (int q = 0; q < NCROWD; ++q) {
    octo_touch_blocks *k = &s->touch;
    if (octo_contact_link[NC + NEND + q] != l) continue;
    octo_crowd(in, q, V, k, s->members, &s->fronts);
    if (!ANY(k->active)) continue;
    octo_add(order == 0 ? 6 : 78, k->W, to->W);
    if (order == 2) { octo_add(72, k->T[0], to->T[0]); octo_add(36, k->L, to->L[0]); }
  }
#endif
#if NEND > 0
  for (int c = 0; c < NEND; ++c) {
    const octo_touch_blocks *k = &s->end[c];
    if (octo_contact_link[NC + c] != l) continue;
    octo_add(order == 0 ? 6 : 78, k->W, to->W);
    if (order == 2) { octo_add(72, k->T[0], to->T[0]); octo_add(36, k->L, to->L[0]); }
  }
#endif
#if NMUTUAL > 0
  for (int m = 0; m < 2 * NMUTUAL; ++m) {
    const octo_touch_blocks *k = &s->mutuals.of[m / 2];
    if (octo_mutual_link[m] == l && ANY(k->active)) octo_mutual_add(k, m % 2, order, to);
  }
#endif
  for (int child = NLINK - 1; child > l; --child)
    if (octo_link_parent[child] == l) octo_add(order == 0 ? 6 : order == 1 ? 114 : 294, s->link[octo_link_slot[child]].W, to->W);
  if (order == 2 && s->adder) s->adder(s->adds, in, l, to);
}

#define UP(at, kind) at[(kind) * NRELATED] /* the kind of entry, of the slots that ``at`` stands in */

/* J of j and its ancestors: of each node the row above and the row below. */
static inline void octo_write_jacobian(const octo_input *in, const octo_link_blocks *k, int j, real (*down)[6], const real *own, real *at) {
  const real *next = in->kin[0] + 12 * NB, *now = in->kin[1] + 12 * NB, *previous = in->kin[2] + 12 * NB;
  real up[3][6] = {{ZERO}}, *first = at;
  for (int node = 0; node < 3; ++node) octo_apply(k->B[node], in->kin[node] + 12 * NB + 6 * j, down[node]);
  octo_apply_lower(k->B[0], k->W, next + 6 * j, up[0]);
  octo_apply_transposed(k->B[1], next + 6 * j, up[1]);
  octo_apply_transposed(k->B[2], next + 6 * j, up[2]);
  for (int i = j; i >= 0; i = octo_before[i], ++at) {
    real xi[6];
    for (int c = 0; c < 6; ++c) xi[c] = next[6 * i + c];
    for (int node = 0; node < 3; ++node) UP(at, node) = octo_along(xi, down[node]);
    UP(at, 3) = octo_along(xi, up[0]);
  }
  at = first;
  for (int i = j; i >= 0; i = octo_before[i], ++at) {
    UP(at, 4) = octo_along(now + 6 * i, up[1]);
    UP(at, 5) = octo_along(previous + 6 * i, up[2]);
  }
  for (int node = 0; node < 3; ++node) UP(first, node) += own[1 + node];
}

/* H00(i,j), H01(i,j), H02(i,j), H01(j,i), H02(j,i), H11(i,j), H22(i,j). */
static inline void octo_write_curvature(const octo_input *in, const octo_work *s, const octo_link_blocks *k, int j, real (*down)[6],
                                        const real *own, real *at) {
  const real *next = in->kin[0] + 12 * NB;
  real bend[3][6] = {{ZERO}}, *first = at;
  for (int node = 0; node < 3; ++node) octo_apply(k->T[node], in->kin[node] + 12 * NB + 6 * j, bend[node]);
  octo_apply_lower(k->B[0], k->W, s->eta[j], bend[0]);
  for (int i = j; i >= 0; i = octo_before[i], ++at)
    for (int node = 0; node < 3; ++node) UP(at, node) = octo_along(next + 6 * i, bend[node]) + octo_along(s->eta[i], down[node]);
  UP(first, 0) += in->lam[j] * own[4];
  for (int node = 1; node < 3; ++node) {
    const real *twists = in->kin[node] + 12 * NB;
    real lift[6] = {ZERO}, same[6] = {ZERO};
    octo_apply_transposed(k->T[node], next + 6 * j, lift);
    octo_apply_transposed(k->B[node], s->eta[j], lift);
    octo_apply(k->L[node - 1], twists + 6 * j, same);
    at = first;
    for (int i = j; i >= 0; i = octo_before[i], ++at) {
      UP(at, 2 + node) = octo_along(twists + 6 * i, lift);
      UP(at, 4 + node) = octo_along(twists + 6 * i, same);
    }
  }
}

#if NREACH > 0 || NMUTUALREACH > 0
/* Elements and contacts between bodies make J unsymmetric, also where pairs couple: every entry has a slot, but those that are equal in H00 and H11. */
static inline void octo_element_jacobian(int node, int i, int j, real value, real *jac) {
  jac[octo_jac_slot[(3 * i + node) * NX + j]] += value;
}
static inline void octo_element_mixed(int i, int j, real value, real *hess) { hess[octo_hess_slot[(NX + i) * NX + j]] += value; }
static inline void octo_element_symmetric(int block, int i, int j, real value, real *hess) {
  hess[octo_hess_slot[(block * NX + i) * NX + j]] += value;
}
static inline void octo_couple_jacobian(int i, int j, real value, real *jac) {
  octo_element_jacobian(0, i, j, value, jac);
  if (i != j) octo_element_jacobian(0, j, i, value, jac);
}
static inline void octo_couple_curvature(int i, int j, real value, real *hess) { octo_element_symmetric(0, i, j, value, hess); }
#else
static inline void octo_couple_jacobian(int i, int j, real value, real *jac) {
  int at = octo_coupled[i * NX + j];
  if (at < NRELATED) { UP((jac + 1 + at), 0) += value; UP((jac + 1 + at), 3) += value; }
  else jac[1 + 5 * NRELATED + at] += value;
}
static inline void octo_couple_curvature(int i, int j, real value, real *hess) {
  int at = octo_coupled[i * NX + j];
  hess[1 + (at < NRELATED ? 0 : 8 * NRELATED) + at] += value;
}
#endif

/* One step in every lane. jac and hess have their slots 0 and those of the pairs at zero; says whether the pairs or elements changed that. */
static int octo_step(const octo_input *in, real *fd, real *jac, real *hess, octo_work *s) {
  for (int j = 0; in->order == 2 && j < NX; ++j) {
    const real *above = s->V[octo_before[j] < 0 ? 0 : octo_before[j]], *xi = in->kin[0] + 12 * NB + 6 * j;
    for (int c = 0; c < 6; ++c) s->V[j][c] = (octo_before[j] < 0 ? ZERO : above[c]) + in->lam[j] * xi[c];
    octo_turned(in, s->V[j], j, s->eta[j]);
  }
#if NELEMENT > 0
  for (int e = 0; e < 3 * NELEMENT; ++e) octo_element(in, e / 3, e % 3, s->V, s->end, &s->elements.element[e / 3]);
#endif
#if NCROWD > 0
  ++s->evaluated;
#endif
#if NMUTUAL > 0
  for (int m = 0; m < NMUTUAL; ++m) octo_mutual(in, m, s->V, &s->mutuals.of[m]);
#endif
  for (int l = NLINK - 1; l >= 0; --l) {
    octo_composite(in, s, l);
    const octo_link_blocks *k = &s->link[octo_link_slot[l]];
    for (int j = octo_link_first[l]; j <= octo_link_last[l]; ++j) {
      real own[5], down[3][6] = {{ZERO}};
      octo_joint(in, j, own);
      fd[j] = own[0] + octo_along(in->kin[0] + 12 * NB + 6 * j, k->W);
      if (in->order >= 1) octo_write_jacobian(in, k, j, down, own, jac + 1 + octo_path_start[j]);
      if (in->order == 2) octo_write_curvature(in, s, k, j, down, own, hess + 1 + octo_path_start[j]);
    }
  }
  octo_pairs(in, &s->pairs);
  octo_write_pairs(in, &s->pairs, fd, jac, hess);
  int touching = NREACH > 0;
#if NREACH > 0
  octo_write_elements(in, &s->elements, s->V, jac, hess);
#endif
#if NMUTUAL > 0
  touching |= octo_write_mutuals(in, &s->mutuals, s->V, jac, hess);
#endif
#if NPAIR > 0
  for (int k = 0; k < NPAIR; ++k) touching |= ANY(s->pairs.pair[k].phi[0] != 0.0);
#endif
  return touching;
}
