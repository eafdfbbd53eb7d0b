/* FD of one time step, its Jacobian and the curvature of lamᵀFD, by composites over the tree of links (tree.c).
 *
 * The text is a sequence of phases, loops whose items do not depend on each other, with BARRIER between phases. It is
 * serial C for a C compiler; for NVRTC a block of threads works on one time step, its work area in shared memory. */

#ifdef LANE
#define RELATED(i, j, count) /* all i ⪯ j, one by one */ \
  for (int i##j = LANE, i, j, count = 1; i##j < NRELATED && (i = octo_above[i##j], j = octo_below[i##j], 1); i##j += LANES)
#define OWNED(l, j, node) /* all j, the link l that each belongs to, the three nodes */ \
  for (int j##node = LANE, l, j, node; j##node < 3 * NX && (j = j##node / 3, node = j##node % 3, l = octo_link_of[j], 1); j##node += LANES)
#define SPAN(e, count, total) /* neighbouring numbers, up to count from e on, at a time */ \
  for (int e = LANE, count = 1; e < (total); e += LANES)
typedef double octo_wide;
#define WIDE 1
#define LOAD(at) (*(at))
#define STORE(at, value) (*(at) = (value))
#else
#define RELATED(i, j, count) /* all i ⪯ j, up to WIDE neighbouring j, from j on, at a time */ \
  for (int run_ = 0, i; run_ < NRUN && (i = octo_run[3 * run_], 1); ++run_) \
    for (int j = octo_run[3 * run_ + 1], count; (count = octo_run[3 * run_ + 2] - j) > 0; j += WIDE)
#define OWNED(l, j, node) /* the degrees of freedom of every link, up to WIDE at a time, the three nodes */ \
  for (int l = 0; l < NLINK; ++l) \
    for (int j = octo_link_first[l]; j <= octo_link_last[l]; j += WIDE) \
      for (int node = 0; node < 3; ++node)
#define SPAN(e, count, total) for (int e = 0, count = (total); e < count; e = count)
typedef double octo_wide __attribute__((vector_size(32)));
typedef double octo_wide_anywhere __attribute__((vector_size(32), aligned(8), may_alias));
#define WIDE 4
#define LOAD(at) ((octo_wide)*(const octo_wide_anywhere *)(at))
#define STORE(at, value) (*(octo_wide_anywhere *)(at) = (value))
#endif

#define PAD ((NX + WIDE - 1) / WIDE * WIDE + WIDE) /* a wide load may start at any j < NX */

/* jac is (NX, 3 NX). hess, ∇²(lamᵀFD), is (CURVATURE, NX, NX): its blocks H00, H01, H02, H11, H22 of (next, now, previous),
 * H00, H11 and H22 whole; the others follow by symmetry, H10 = H01ᵀ, H20 = H02ᵀ, and H12 is zero (custom.c has it as a sixth). */
#define JAC(i, node, j) jac[(i) * 3 * NX + (node) * NX + (j)]
#define HESS(block, i, j) hess[((block) * NX + (i)) * NX + (j)]

static inline void octo_couple_jacobian(int i, int j, double value, double *jac) {
  JAC(i, 0, j) += value;
  if (i != j) JAC(j, 0, i) += value;
}
static inline void octo_couple_curvature(int i, int j, double value, double *hess) {
  HESS(0, i, j) += value;
  if (i != j) HESS(0, j, i) += value;
}

#if NREACH > 0 || NMUTUAL > 0
static inline void octo_element_jacobian(int node, int i, int j, double value, double *jac) { JAC(i, node, j) += value; }
static inline void octo_element_mixed(int i, int j, double value, double *hess) { HESS(1, i, j) += value; }
static inline void octo_element_symmetric(int block, int i, int j, double value, double *hess) {
  HESS(block, i, j) += value;
  if (i != j) HESS(block, j, i) += value;
}
#endif

/* block·ξ_j and blockᵀ·ξ_j, what a row above and a row below j see, and the same of order 2. */
typedef struct { double down[3][6][PAD], up[3][6][PAD], bend[3][6][PAD], lift[3][6][PAD], own[3][6][PAD]; } octo_seen;

typedef struct {
  double xi[3][6][PAD];      /* twists of the nodes, by component */
  double joint[SOME(NX)][5]; /* force, its three derivatives, its second derivative to x_next */
  octo_link_blocks link[SOME(NLINK)];
  octo_loops pairs;
#if NELEMENT > 0
  octo_elements elements;
#endif
#if NMUTUAL > 0
  octo_mutuals mutuals;
#endif
  /* order 2 */
  double V[SOME(NX)][6], eta[6][PAD]; /* virtual twists V_j, and η_j = ad_{V_j} ξ_j */
  union {
    octo_touch_blocks touch[SOME(NTOUCH)]; /* until the links have them */
    octo_seen of;
  };
} octo_work;

#define WORK ((int)(sizeof(octo_work) / sizeof(double)) + 8)

/* a_i·b_j of two arrays by component, for WIDE neighbouring j. */
static inline octo_wide octo_along(const double (*a)[PAD], int i, const double (*b)[PAD], int j) {
  return a[0][i] * LOAD(&b[0][j]) + a[1][i] * LOAD(&b[1][j]) + a[2][i] * LOAD(&b[2][j]) + a[3][i] * LOAD(&b[3][j])
       + a[4][i] * LOAD(&b[4][j]) + a[5][i] * LOAD(&b[5][j]);
}

/* The first ``count`` of WIDE values, ``stride`` apart. */
static inline void octo_put(octo_wide value, int count, double *out, int stride) {
#ifdef LANE
  *out = value;
#else
  if (count >= WIDE && stride == 1) { STORE(out, value); return; }
  for (int k = 0; k < WIDE; ++k)
    if (k < count) out[k * stride] = value[k];
#endif
}

/* sum += block·v_j and += blockᵀ·v_j, for WIDE neighbouring j of vectors kept by component. */
static inline void octo_apply(const double *block, const double (*v)[PAD], int j, octo_wide *sum) {
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) sum[r] += block[6 * r + c] * LOAD(&v[c][j]);
}
static inline void octo_apply_transposed(const double *block, const double (*v)[PAD], int j, octo_wide *sum) {
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) sum[r] += block[6 * c + r] * LOAD(&v[c][j]);
}

/* sum += P2·v_j with P2 = Pᵀ − [[m×, f×], [f×, 0]]. */
static inline void octo_apply_lower(const double *P, const double *W, const double (*v)[PAD], int j, octo_wide *sum) {
  octo_apply_transposed(P, v, j, sum);
  for (int r = 0; r < 3; ++r) {
    int a = (r + 1) % 3, b = (r + 2) % 3;
    sum[r] -= W[a] * LOAD(&v[b][j]) - W[b] * LOAD(&v[a][j]) + W[3 + a] * LOAD(&v[3 + b][j]) - W[3 + b] * LOAD(&v[3 + a][j]);
    sum[3 + r] -= W[3 + a] * LOAD(&v[b][j]) - W[3 + b] * LOAD(&v[a][j]);
  }
}

/* Lanes beyond the link's own are overwritten by the links after it. */
static inline void octo_keep(const octo_wide *sum, double (*out)[PAD], int j) {
  for (int c = 0; c < 6; ++c) STORE(&out[c][j], sum[c]);
}

/* The lanes beyond NX of arrays by component are computed with and never used: zero, for denormal numbers are slow. */
static inline void octo_clear_tails(octo_work *s) {
#ifndef LANE
  double *first[3] = {(double *)s->xi, (double *)s->eta, (double *)&s->of};
  const int rows[3] = {3 * 6, 6, 5 * 3 * 6};
  for (int part = 0; part < 3; ++part)
    for (int k = 0; k < rows[part]; ++k)
      for (int j = NX; j < PAD; ++j) first[part][k * PAD + j] = 0.0;
#endif
}

/* Twists by component; virtual twists V_j = Σ_{a ⪯ j} lam_a ξ_a and η_j = ad_{V_j} ξ_j. */
static void octo_load(const octo_input *in, octo_work *s) {
  GRID(j, NX, c, 6)
    for (int node = 0; node < (in->order > 0 ? 3 : 1); ++node) s->xi[node][c][j] = in->kin[node][12 * NB + 6 * j + c];
  if (in->order < 2) return;
  BARRIER;
  EACH(c, 6)
    for (int j = 0; j < NX; ++j)
      s->V[j][c] = (octo_before[j] < 0 ? 0.0 : s->V[octo_before[j]][c]) + in->lam[j] * s->xi[0][c][j];
  BARRIER;
  EACH(j, NX) {
    double eta[6];
    octo_turned(in, s->V[j], j, eta);
    for (int r = 0; r < 6; ++r) s->eta[r][j] = eta[r];
  }
}

static inline void octo_add(int count, const double *from, double *to) {
  for (int e = 0; e < count; ++e) to[e] += from[e];
}

static inline void octo_add_where(int active, int count, const double *from, double *to) {
#ifdef LANE
  double value = *from; /* also where it is not used, without a branch */
  *to += active ? value : 0.0;
#else
  if (active) octo_add(count, from, to);
#endif
}

/* ``total`` numbers of every contact and of every end of an element, from ``from`` on, into those of its link, from ``to`` on. */
static inline void octo_add_contacts(octo_work *s, int total, int from, int to) {
#if NTOUCH > 0
  int active[NTOUCH]; /* all at once: none waits until the sums before it are written */
  for (int c = 0; c < NTOUCH; ++c) active[c] = s->touch[c].active;
  SPAN(e, count, total)
    for (int c = 0; c < NTOUCH; ++c)
      octo_add_where(active[c], count, s->touch[c].W + from + e, s->link[octo_contact_link[c]].W + to + e);
#endif
}

/* Contacts into their links, then links into their parents, leaves first: every thread keeps its own entries. */
static void octo_composites(int order, octo_work *s) {
  octo_add_contacts(s, order == 0 ? 6 : 78, 0, 0);
  if (order == 2) {
    octo_add_contacts(s, 72, 78, 114); /* T */
    octo_add_contacts(s, 36, 150, 222); /* L */
  }
#if NMUTUAL > 0
  BARRIER; /* entries of their own threads again */
  for (int m = 0; m < 2 * NMUTUAL; ++m) {
    const octo_touch_blocks *k = &s->mutuals.of[m / 2];
    if (octo_mutual_link[m] >= 0 && k->active) octo_mutual_add(k, m % 2, order, &s->link[octo_mutual_link[m]]);
  }
#endif
  BARRIER; /* the entries of W, T and L belong to other threads below */
  SPAN(e, count, order == 0 ? 6 : order == 1 ? 114 : 294)
    for (int l = NLINK - 1; l > 0; --l)
      if (octo_link_parent[l] >= 0) octo_add(count, s->link[l].W + e, s->link[octo_link_parent[l]].W + e);
}

/* Blocks times twists, one vector per degree of freedom: H00 = ξ_iᵀ(Kξ_j + P2 η_j) + η_iᵀPξ_j, H01 likewise. */
static void octo_products(int order, octo_work *s) {
  OWNED(l, j, node) {
    const octo_link_blocks *k = &s->link[l];
    octo_wide down[6] = {0}, up[6] = {0}, bend[6] = {0}, lift[6] = {0}, own[6] = {0};
    octo_apply(k->B[node], s->xi[node], j, down);
    octo_keep(down, s->of.down[node], j);
    if (node == 0) octo_apply_lower(k->B[0], k->W, s->xi[0], j, up);
    else octo_apply_transposed(k->B[node], s->xi[0], j, up);
    octo_keep(up, s->of.up[node], j);
    if (order < 2) continue;
    octo_apply(k->T[node], s->xi[node], j, bend);
    if (node == 0) octo_apply_lower(k->B[0], k->W, s->eta, j, bend);
    octo_keep(bend, s->of.bend[node], j);
    if (node == 0) continue;
    octo_apply_transposed(k->T[node], s->xi[0], j, lift);
    octo_apply_transposed(k->B[node], s->eta, j, lift);
    octo_keep(lift, s->of.lift[node], j);
    octo_apply(k->L[node - 1], s->xi[node], j, own);
    octo_keep(own, s->of.own[node], j);
  }
}

/* Entries of related degrees of freedom, i ⪯ j; all others are zero but for pairs. */
static void octo_write(int order, const octo_work *s, double *jac, double *hess) {
  RELATED(i, j, count) {
    for (int node = 0; node < 3; ++node) {
      octo_put(octo_along(s->xi[0], i, s->of.down[node], j), count, &JAC(i, node, j), 1);
      octo_put(octo_along(s->xi[node], i, s->of.up[node], j), count, &JAC(j, node, i), 3 * NX);
    }
    if (order < 2) continue;
    for (int node = 0; node < 3; ++node) {
      octo_wide value = octo_along(s->xi[0], i, s->of.bend[node], j) + octo_along(s->eta, i, s->of.down[node], j);
      octo_put(value, count, &HESS(node, i, j), 1);
      octo_put(node == 0 ? value : octo_along(s->xi[node], i, s->of.lift[node], j), count, &HESS(node, j, i), NX);
      if (node == 0) continue;
      value = octo_along(s->xi[node], i, s->of.own[node], j);
      octo_put(value, count, &HESS(2 + node, i, j), 1);
      octo_put(value, count, &HESS(2 + node, j, i), NX);
    }
  }
}

static void octo_write_joints(const octo_input *in, const octo_work *s, double *fd, double *jac, double *hess) {
  EACH(j, NX) {
    const double *W = s->link[octo_link_of[j]].W, *k = s->joint[j];
    double sum = k[0];
    for (int c = 0; c < 6; ++c) sum += s->xi[0][c][j] * W[c];
    fd[j] = sum;
    if (in->order >= 1) {
      double own[3];
      for (int node = 0; node < 3; ++node) own[node] = JAC(j, node, j) + k[1 + node];
      for (int node = 0; node < 3; ++node) JAC(j, node, j) = own[node];
    }
    if (in->order == 2) HESS(0, j, j) += in->lam[j] * k[4];
  }
}

static void octo_step(const double *x_next, const double *x, const double *x_prev, const double *kin_next, const double *kin,
                      const double *kin_prev, const double *p, const double *lam, int order, double *fd, double *jac, double *hess, double *work) {
  const octo_input in = {{x_next, x, x_prev}, {kin_next, kin, kin_prev}, p, lam, order};
  octo_work *s = (octo_work *)(work + (-(size_t)work % 64) / 8); /* no cast of a number: shared memory stays known as such */
  octo_load(&in, s);
  if (order >= 1) EACH(e, 3 * NX * NX) jac[e] = 0.0;
  if (order == 2) EACH(e, CURVATURE * NX * NX) hess[e] = 0.0;
  BARRIER;
  EACH(l, NLINK) octo_body(&in, l, s->V[octo_link_last[l]], &s->link[l]); /* a warp for each kind: their code diverges */
#if NC > 0
  EACH_FROM(32, c, NC) octo_contact(&in, c, s->V[octo_link_last[octo_contact_link[c]]], &s->touch[c]);
#endif
#if NCROWD > 0
  EACH_FROM(96, q, NCROWD) octo_crowd(&in, q, s->V[octo_link_last[octo_contact_link[NC + NEND + q]]], &s->touch[NC + NEND + q], 0, 0);
#endif
  EACH_FROM(64, j, NX) octo_joint(&in, j, s->joint[j]);
#if NELEMENT > 0
  EACH_FROM(112, e, 3 * NELEMENT) octo_element(&in, e / 3, e % 3, s->V, s->touch + NC, &s->elements.element[e / 3]);
#endif
#if NMUTUAL > 0
  EACH_FROM(128, m, NMUTUAL) octo_mutual(&in, m, s->V, &s->mutuals.of[m]);
#endif
  octo_pairs(&in, &s->pairs);
  BARRIER;
  octo_composites(order, s);
  BARRIER;
  if (order >= 1) {
    octo_clear_tails(s);
    octo_products(order, s);
    BARRIER;
    octo_write(order, s, jac, hess);
    BARRIER;
  }
  octo_write_joints(&in, s, fd, jac, hess);
  octo_write_pairs(&in, &s->pairs, fd, jac, hess);
#if NELEMENT > 0
  octo_write_elements(&in, &s->elements, s->V, jac, hess);
#endif
#if NMUTUAL > 0
  octo_write_mutuals(&in, &s->mutuals, s->V, jac, hess);
#endif
}
