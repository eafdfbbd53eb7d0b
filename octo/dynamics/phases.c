/* FD of one time step, its Jacobian and the curvature of lamᵀFD, by composites over the tree of links.
 *
 * A link is a set of bodies welded together; its composite is the sum of the stages' wrenches w and blocks (stages.py)
 * over the links it carries. With the world twists ξ_j of the nodes next (0), now (1) and previous (2), and i an ancestor
 * of j or j itself (i ⪯ j), FD_j = ξ_j·W, J_ij = ξ_iᵀ P ξ_j and, the row being deeper, J_ji = ξ_iᵀ P2 ξ_j, where
 * P = A + G, P2 = Aᵀ + G = Pᵀ − [[m×, f×], [f×, 0]] of the composite wrench W = (m, f): friction makes A unsymmetric.
 *
 * The text is a sequence of phases, loops whose items do not depend on each other, with BARRIER between phases. It is
 * serial C for a C compiler; for NVRTC a block of threads works on one time step, its work area in shared memory.
 * The text before this one defines the sizes, the tables octo_* of the character and the stage functions. */

#ifdef __CUDACC_RTC__
#define LANE ((int)threadIdx.x)
#define LANES ((int)blockDim.x)
#define BARRIER __syncthreads()
#endif

#ifdef LANE
#define EACH(e, count) for (int e = LANE; e < (count); e += LANES)
#define GRID(a, rows, b, columns) \
  for (int a##b = LANE, a, b; a##b < (rows) * (columns) && (a = a##b / (columns), b = a##b % (columns), 1); a##b += LANES)
#define RELATED(i, j, count) /* all i ⪯ j, one by one */ \
  for (int i##j = LANE, i, j, count = 1; i##j < NRELATED && (i = octo_above[i##j], j = octo_below[i##j], 1); i##j += LANES)
#define OWNED(l, j, node) /* all j, the link l that each belongs to, the three nodes */ \
  for (int j##node = LANE, l, j, node; j##node < 3 * NX && (j = j##node / 3, node = j##node % 3, l = octo_link_of[j], 1); j##node += LANES)
typedef double octo_wide;
#define WIDE 1
#define LOAD(at) (*(at))
#define STORE(at, value) (*(at) = (value))
#else
#define BARRIER
#define EACH(e, count) for (int e = 0; e < (count); ++e)
#define GRID(a, rows, b, columns) for (int a = 0; a < (rows); ++a) for (int b = 0; b < (columns); ++b)
#define RELATED(i, j, count) /* all i ⪯ j, up to WIDE neighbouring j, from j on, at a time */ \
  for (int run_ = 0, i; run_ < NRUN && (i = octo_run[3 * run_], 1); ++run_) \
    for (int j = octo_run[3 * run_ + 1], count; (count = octo_run[3 * run_ + 2] - j) > 0; j += WIDE)
#define OWNED(l, j, node) /* the degrees of freedom of every link, up to WIDE at a time, the three nodes */ \
  for (int l = 0; l < NLINK; ++l) \
    for (int j = octo_link_first[l]; j <= octo_link_last[l]; j += WIDE) \
      for (int node = 0; node < 3; ++node)
typedef double octo_wide __attribute__((vector_size(32)));
typedef double octo_wide_anywhere __attribute__((vector_size(32), aligned(8), may_alias));
#define WIDE 4
#define LOAD(at) ((octo_wide)*(const octo_wide_anywhere *)(at))
#define STORE(at, value) (*(octo_wide_anywhere *)(at) = (value))
#endif

#define PAD ((NX + WIDE - 1) / WIDE * WIDE + WIDE) /* a wide load may start at any j < NX */
#define SOME(count) ((count) > 0 ? (count) : 1)

typedef struct { double W[6], B[3][36], T[3][36], L[2][36]; } octo_link_blocks;      /* P, B1, B2; K, T1, T2; L1, L2 */
typedef struct { double W[6], B[2][36], T[2][36], L[36]; int active; } octo_touch_blocks; /* of a contact: no x_prev */
typedef struct { double phi[3], direction[3]; } octo_pair_state;                      /* Φ', Φ'', Φ'''; c_a − c_b, m */

typedef struct {
  double xi[3][6][PAD];                       /* twists of the nodes, by component */
  double down[3][6][PAD], up[3][6][PAD];      /* block·ξ_j and blockᵀ·ξ_j, what a row above and a row below j see */
  double joint[SOME(NX)][5];                  /* force, its three derivatives, its second derivative to x_next */
  octo_link_blocks link[SOME(NLINK)];
  octo_touch_blocks touch[SOME(NC)];
  octo_pair_state pair[SOME(NPAIR)];
  double loop_motion[SOME(NLOOP)][3], loop_slope[SOME(NLOOP)];  /* ∂d/∂q_a, ∂ρ/∂q_a of the pair at hand */
  /* order 2 */
  double V[SOME(NX)][6], eta[6][PAD];         /* virtual twists V_j, and η_j = ad_{V_j} ξ_j */
  double bend[3][6][PAD], lift[3][6][PAD], own[3][6][PAD];
  double loop_change[SOME(NLOOP)][3], loop_turn[SOME(NLOOP)][3], loop_bend[SOME(NLOOP)];  /* along lam */
} octo_work;

#define WORK ((int)(sizeof(octo_work) / sizeof(double)) + 8)

static inline void octo_cross(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double octo_dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* R v + t of a pose of kin. */
static inline void octo_place(const double *pose, const double *v, double *out) {
  for (int r = 0; r < 3; ++r) out[r] = octo_dot(pose + 3 * r, v) + pose[9 + r];
}

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

/* Pose of one joint's displacement, right-multiplied to (R, t): the joint's world twist is written on the way. */
static inline void octo_move(int j, double displacement, double *R, double *t, double *xi) {
  double axis[3], anchor[3], arm[3];
  for (int r = 0; r < 3; ++r) axis[r] = octo_dot(R + 3 * r, octo_joint_axis + 3 * j);
  if (octo_joint_slides[j]) {
    for (int r = 0; r < 3; ++r) { xi[r] = 0.0; xi[3 + r] = axis[r]; t[r] += axis[r] * displacement; }
    return;
  }
  double s = sin(displacement), c = cos(displacement);
  for (int r = 0; r < 3; ++r) anchor[r] = octo_dot(R + 3 * r, octo_joint_anchor + 3 * j) + t[r];
  for (int r = 0; r < 3; ++r) xi[r] = axis[r];
  octo_cross(anchor, axis, xi + 3); /* velocity of the point at the world's origin */
  double turn[9] = {c + (1 - c) * axis[0] * axis[0], (1 - c) * axis[0] * axis[1] - s * axis[2], (1 - c) * axis[0] * axis[2] + s * axis[1],
                    (1 - c) * axis[0] * axis[1] + s * axis[2], c + (1 - c) * axis[1] * axis[1], (1 - c) * axis[1] * axis[2] - s * axis[0],
                    (1 - c) * axis[0] * axis[2] - s * axis[1], (1 - c) * axis[1] * axis[2] + s * axis[0], c + (1 - c) * axis[2] * axis[2]};
  double old[9];
  for (int k = 0; k < 9; ++k) old[k] = R[k];
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k) R[3 * r + k] = turn[3 * r] * old[k] + turn[3 * r + 1] * old[3 + k] + turn[3 * r + 2] * old[6 + k];
  for (int r = 0; r < 3; ++r) arm[r] = t[r] - anchor[r];
  for (int r = 0; r < 3; ++r) t[r] = anchor[r] + octo_dot(turn + 3 * r, arm);
}

/* Poses of the bodies and world twists of the degrees of freedom at one node: kin (12 NB + 6 NX). */
void octo_kin(const double *x, double *kin) {
  for (int b = 0; b < NB; ++b) {
    double *R = kin + 12 * b, *t = R + 9;
    const double *fixed = octo_body_pose + 12 * b;
    if (octo_body_parent[b] < 0) {
      for (int k = 0; k < 12; ++k) R[k] = fixed[k];
    } else {
      const double *parent = kin + 12 * octo_body_parent[b];
      for (int r = 0; r < 3; ++r)
        for (int k = 0; k < 3; ++k) R[3 * r + k] = parent[3 * r] * fixed[k] + parent[3 * r + 1] * fixed[3 + k] + parent[3 * r + 2] * fixed[6 + k];
      octo_place(parent, fixed + 9, t);
    }
    for (int j = octo_body_first[b]; j < octo_body_first[b + 1]; ++j)
      octo_move(j, x[j] - octo_joint_reference[j], R, t, kin + 12 * NB + 6 * j);
  }
}

/* ---- phases of a step ---- */

typedef struct { const double *x[3], *kin[3], *p, *lam; int order; } octo_input;

static void octo_pairs(const octo_input *in, octo_work *s); /* pairs.c */
static void octo_write_pairs(const octo_input *in, octo_work *s, double *fd, double *jac, double *hess);

/* The lanes beyond NX of arrays by component are computed with and never used: zero, for denormal numbers are slow. */
static inline void octo_clear_tails(int order, octo_work *s) {
#ifndef LANE
  const size_t start[2] = {offsetof(octo_work, xi), offsetof(octo_work, eta)};
  const int rows[2] = {3 * 3 * 6, order == 2 ? (1 + 3 * 3) * 6 : 0}; /* xi, down, up; eta, bend, lift, own */
  for (int part = 0; part < 2; ++part)
    for (int k = 0; k < rows[part]; ++k)
      for (int j = NX; j < PAD; ++j) ((double *)((char *)s + start[part]))[k * PAD + j] = 0.0;
#endif
}

/* Twists by component; virtual twists V_j = Σ_{a ⪯ j} lam_a ξ_a and η_j = ad_{V_j} ξ_j. */
static void octo_load(const octo_input *in, octo_work *s) {
  for (int node = 0; node < (in->order > 0 ? 3 : 1); ++node)
    GRID(j, NX, c, 6) s->xi[node][c][j] = in->kin[node][12 * NB + 6 * j + c];
  if (in->order >= 1) octo_clear_tails(in->order, s);
  if (in->order < 2) return;
  EACH(c, 6)
    for (int j = 0; j < NX; ++j)
      s->V[j][c] = (octo_before[j] < 0 ? 0.0 : s->V[octo_before[j]][c]) + in->lam[j] * in->kin[0][12 * NB + 6 * j + c];
  BARRIER;
  EACH(j, NX) {
    const double *xi = in->kin[0] + 12 * NB + 6 * j, *V = s->V[j];
    double turn[3], moved[3], carried[3];
    octo_cross(V, xi, turn);
    octo_cross(V, xi + 3, moved);
    octo_cross(V + 3, xi, carried);
    for (int r = 0; r < 3; ++r) { s->eta[r][j] = turn[r]; s->eta[3 + r][j] = moved[r] + carried[r]; }
  }
}

/* Inertia and gravity: the stage writes into the link's composite. */
static void octo_bodies(const octo_input *in, octo_work *s) {
  EACH(l, NLINK) {
    octo_link_blocks *k = &s->link[l];
    int at = 12 * octo_link_body[l];
    const double *arg[6] = {in->kin[0] + at, in->kin[1] + at, in->kin[2] + at, octo_link_inertia + 10 * l, in->p, s->V[octo_link_last[l]]};
    double *res[9] = {k->W, k->B[0], k->B[1], k->B[2], k->T[0], k->T[1], k->T[2], k->L[0], k->L[1]};
    if (in->order == 0) octo_body0(arg, res, 0, 0, 0);
    else if (in->order == 1) octo_body1(arg, res, 0, 0, 0);
    else octo_body2(arg, res, 0, 0, 0);
  }
}

/* Terrain contacts; those out of reach are skipped, a NaN is not. */
static void octo_contacts(const octo_input *in, octo_work *s) {
#if NC > 0
  EACH(c, NC) {
    octo_touch_blocks *k = &s->touch[c];
    int at = 12 * octo_contact_body[c];
    const double *sphere = octo_contact_sphere + 4 * c;
    double center[3], gap;
    octo_place(in->kin[0] + at, sphere, center);
    const double *place[3] = {center, sphere + 3, in->p};
    double *depth[1] = {&gap};
    octo_gap(place, depth, 0, 0, 0);
    k->active = !(gap <= 0.0);
    if (!k->active) continue;
    const double *arg[5] = {in->kin[0] + at, in->kin[1] + at, sphere, in->p, s->V[octo_link_last[octo_contact_link[c]]]};
    double *res[6] = {k->W, k->B[0], k->B[1], k->T[0], k->T[1], k->L};
    if (in->order == 0) octo_contact0(arg, res, 0, 0, 0);
    else if (in->order == 1) octo_contact1(arg, res, 0, 0, 0);
    else octo_contact2(arg, res, 0, 0, 0);
  }
#endif
}

static void octo_joints(const octo_input *in, octo_work *s) {
  EACH(j, NX) {
    const double *arg[5] = {in->x[0] + j, in->x[1] + j, in->x[2] + j, octo_joint_table + 6 * j, in->p};
    double *k = s->joint[j], *res[5] = {k, k + 1, k + 2, k + 3, k + 4};
    if (in->order == 0) octo_joint0(arg, res, 0, 0, 0);
    else if (in->order == 1) octo_joint1(arg, res, 0, 0, 0);
    else octo_joint2(arg, res, 0, 0, 0);
  }
}

static inline void octo_add(int count, const double *from, double *to) { EACH(e, count) to[e] += from[e]; }

/* Contacts into their links, then links into their parents, leaves first: every thread keeps its own entries. */
static void octo_composites(int order, octo_work *s) {
#if NC > 0
  for (int c = 0; c < NC; ++c) {
    const octo_touch_blocks *k = &s->touch[c];
    octo_link_blocks *to = &s->link[octo_contact_link[c]];
    if (!k->active) continue;
    octo_add(order == 0 ? 6 : 78, k->W, to->W);
    if (order == 2) { octo_add(72, k->T[0], to->T[0]); octo_add(36, k->L, to->L[0]); }
  }
#endif
  BARRIER; /* the entries of W, T and L belong to other threads below */
  for (int l = NLINK - 1; l > 0; --l)
    if (octo_link_parent[l] >= 0)
      octo_add(order == 0 ? 6 : order == 1 ? 114 : 294, s->link[l].W, s->link[octo_link_parent[l]].W);
}

/* Blocks times twists, one vector per degree of freedom: H00 = ξ_iᵀ(Kξ_j + P2 η_j) + η_iᵀPξ_j, H01 likewise. */
static void octo_products(int order, octo_work *s) {
  OWNED(l, j, node) {
    const octo_link_blocks *k = &s->link[l];
    octo_wide down[6] = {0}, up[6] = {0}, bend[6] = {0}, lift[6] = {0}, own[6] = {0};
    octo_apply(k->B[node], s->xi[node], j, down);
    octo_keep(down, s->down[node], j);
    if (node == 0) octo_apply_lower(k->B[0], k->W, s->xi[0], j, up);
    else octo_apply_transposed(k->B[node], s->xi[0], j, up);
    octo_keep(up, s->up[node], j);
    if (order < 2) continue;
    octo_apply(k->T[node], s->xi[node], j, bend);
    if (node == 0) octo_apply_lower(k->B[0], k->W, s->eta, j, bend);
    octo_keep(bend, s->bend[node], j);
    if (node == 0) continue;
    octo_apply_transposed(k->T[node], s->xi[0], j, lift);
    octo_apply_transposed(k->B[node], s->eta, j, lift);
    octo_keep(lift, s->lift[node], j);
    octo_apply(k->L[node - 1], s->xi[node], j, own);
    octo_keep(own, s->own[node], j);
  }
}

/* jac is (NX, 3 NX). hess, ∇²(lamᵀFD), is (CURVATURE, NX, NX): its blocks H00, H01, H02, H11, H22 of (next, now, previous),
 * H00, H11 and H22 whole; the others follow by symmetry, H10 = H01ᵀ, H20 = H02ᵀ, and H12 is zero (custom.c has it as a sixth). */
#define JAC(i, node, j) jac[(i) * 3 * NX + (node) * NX + (j)]
#define HESS(block, i, j) hess[((block) * NX + (i)) * NX + (j)]

/* Entries of related degrees of freedom, i ⪯ j; all others are zero but for pairs. */
static void octo_write(int order, const octo_work *s, double *jac, double *hess) {
  RELATED(i, j, count) {
    for (int node = 0; node < 3; ++node) {
      octo_put(octo_along(s->xi[0], i, s->down[node], j), count, &JAC(i, node, j), 1);
      octo_put(octo_along(s->xi[node], i, s->up[node], j), count, &JAC(j, node, i), 3 * NX);
    }
    if (order < 2) continue;
    for (int node = 0; node < 3; ++node) {
      octo_wide value = octo_along(s->xi[0], i, s->bend[node], j) + octo_along(s->eta, i, s->down[node], j);
      octo_put(value, count, &HESS(node, i, j), 1);
      octo_put(node == 0 ? value : octo_along(s->xi[node], i, s->lift[node], j), count, &HESS(node, j, i), NX);
      if (node == 0) continue;
      value = octo_along(s->xi[node], i, s->own[node], j);
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
    if (in->order >= 1)
      for (int node = 0; node < 3; ++node) JAC(j, node, j) += k[1 + node];
    if (in->order == 2) HESS(0, j, j) += in->lam[j] * k[4];
  }
}

void octo_step(const double *x_next, const double *x, const double *x_prev, const double *kin_next, const double *kin,
               const double *kin_prev, const double *p, const double *lam, int order, double *fd, double *jac, double *hess, double *work) {
  const octo_input in = {{x_next, x, x_prev}, {kin_next, kin, kin_prev}, p, lam, order};
  octo_work *s = (octo_work *)(((size_t)work + 63) & ~(size_t)63);
  octo_load(&in, s);
  if (order >= 1) EACH(e, 3 * NX * NX) jac[e] = 0.0;
  if (order == 2) EACH(e, CURVATURE * NX * NX) hess[e] = 0.0;
  BARRIER;
  octo_bodies(&in, s);
  octo_contacts(&in, s);
  octo_joints(&in, s);
  octo_pairs(&in, s);
  BARRIER;
  octo_composites(order, s);
  BARRIER;
  if (order >= 1) {
    octo_products(order, s);
    BARRIER;
    octo_write(order, s, jac, hess);
    BARRIER;
  }
  octo_write_joints(&in, s, fd, jac, hess);
  octo_write_pairs(&in, s, fd, jac, hess);
}
