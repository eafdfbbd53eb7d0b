/* The dynamics of a character over its tree of links: what phases.c (one time step) and lanes_step.c (several) share.
 *
 * A link is a set of bodies welded together; its composite is the sum of the stages' wrenches w and blocks (stages.py)
 * over the links it carries. With the world twists ξ_j of the nodes next (0), now (1) and previous (2), and i an ancestor
 * of j or j itself (i ⪯ j), FD_j = ξ_j·W, J_ij = ξ_iᵀ P ξ_j and, the row being deeper, J_ji = ξ_iᵀ P2 ξ_j, where
 * P = A + G, P2 = Aᵀ + G = Pᵀ − [[m×, f×], [f×, 0]] of the composite wrench W = (m, f): friction makes A unsymmetric.
 *
 * ``real`` is a number of a step: a double, or a vector with several steps in its lanes (lanes.c, which defines STEPS). The
 * text before this one defines the sizes, the tables octo_* of the character and the stage functions. */

#ifndef STEPS
typedef double real;
typedef int octo_mask;
#define ZERO 0.0
#define NOT(mask) (!(mask))
#define ANY(mask) (mask)
#define ARGUMENT double
#define STAGE(name, arg, res) name(arg, res)
#ifdef __CUDACC_RTC__
#define octo_sincos sincos
#else
static inline void octo_sincos(double angle, double *s, double *c) { *s = sin(angle); *c = cos(angle); }
#endif
#endif

#ifdef __CUDACC_RTC__
#define LANE ((int)threadIdx.x)
#define LANES ((int)blockDim.x)
#define BARRIER __syncthreads()
#endif

/* Loops whose items do not depend on each other, for a block of threads: one time step, its work area in shared memory. */
#ifdef LANE
#define EACH(e, count) for (int e = LANE; e < (count); e += LANES)
#define EACH_FROM(lane, e, count) /* from that thread on, where there is one: loops without a barrier between run side by side */ \
  for (int e = (lane) >= LANES ? LANE : LANE - (lane) + (LANE < (lane) ? LANES : 0); e < (count); e += LANES)
#define GRID(a, rows, b, columns) \
  for (int a##b = LANE, a, b; a##b < (rows) * (columns) && (a = a##b / (columns), b = a##b % (columns), 1); a##b += LANES)
#else
#define BARRIER
#define EACH(e, count) for (int e = 0; e < (count); ++e)
#define EACH_FROM(lane, e, count) EACH(e, count)
#define GRID(a, rows, b, columns) for (int a = 0; a < (rows); ++a) for (int b = 0; b < (columns); ++b)
#endif

#define SOME(count) ((count) > 0 ? (count) : 1)
#ifndef NCROWD
#define NCROWD 0
#define NMEMBER 0
#endif
#define NTOUCH (NC + NEND + NCROWD) /* contacts, then the ends of elements, then crowds */

typedef struct { real W[6], B[3][36], T[3][36], L[2][36]; } octo_link_blocks;      /* P, B1, B2; K, T1, T2; L1, L2 */
typedef struct { real W[6], B[2][36], T[2][36], L[36]; octo_mask active; } octo_touch_blocks; /* of a contact: no x_prev */

static inline void octo_cross(const real *a, const real *b, real *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

#define octo_dot(a, b) ((a)[0] * (b)[0] + (a)[1] * (b)[1] + (a)[2] * (b)[2]) /* of reals or of a table's numbers */

/* R v + t of a pose of kin. */
static inline void octo_place(const real *pose, const double *v, real *out) {
  for (int r = 0; r < 3; ++r) out[r] = octo_dot(pose + 3 * r, v) + pose[9 + r];
}

static inline real octo_displacement(int j, const real *x) { return x[j] - octo_joint_reference[j]; }

/* Sine and cosine of a joint that turns. */
static inline void octo_turn(int j, const real *x, real *turn) {
  if (!octo_joint_slides[j]) octo_sincos(octo_displacement(j, x), turn, turn + 1);
}

/* Pose of one joint's displacement, right-multiplied to (R, t): the joint's world twist is written on the way. */
static inline void octo_move(int j, const real *x, const real *sine, real *R, real *t, real *xi) {
  real axis[3], anchor[3], arm[3];
  for (int r = 0; r < 3; ++r) axis[r] = octo_dot(R + 3 * r, octo_joint_axis + 3 * j);
  if (octo_joint_slides[j]) {
    for (int r = 0; r < 3; ++r) { xi[r] = ZERO; xi[3 + r] = axis[r]; t[r] += axis[r] * octo_displacement(j, x); }
    return;
  }
  const real s = sine[0], c = sine[1];
  for (int r = 0; r < 3; ++r) anchor[r] = octo_dot(R + 3 * r, octo_joint_anchor + 3 * j) + t[r];
  for (int r = 0; r < 3; ++r) xi[r] = axis[r];
  octo_cross(anchor, axis, xi + 3); /* velocity of the point at the world's origin */
  real turn[9] = {c + (1 - c) * axis[0] * axis[0], (1 - c) * axis[0] * axis[1] - s * axis[2], (1 - c) * axis[0] * axis[2] + s * axis[1],
                    (1 - c) * axis[0] * axis[1] + s * axis[2], c + (1 - c) * axis[1] * axis[1], (1 - c) * axis[1] * axis[2] - s * axis[0],
                    (1 - c) * axis[0] * axis[2] - s * axis[1], (1 - c) * axis[1] * axis[2] + s * axis[0], c + (1 - c) * axis[2] * axis[2]};
  real old[9];
  for (int k = 0; k < 9; ++k) old[k] = R[k];
  for (int r = 0; r < 3; ++r)
    for (int k = 0; k < 3; ++k) R[3 * r + k] = turn[3 * r] * old[k] + turn[3 * r + 1] * old[3 + k] + turn[3 * r + 2] * old[6 + k];
  for (int r = 0; r < 3; ++r) arm[r] = t[r] - anchor[r];
  for (int r = 0; r < 3; ++r) t[r] = anchor[r] + octo_dot(turn + 3 * r, arm);
}

/* Pose of body b after its parent's, and the world twists of its joints, in kin; turn (NX, 2) of octo_turn. */
static inline void octo_pose(int b, const real *x, const real *turn, real *kin) {
  const double *fixed = octo_body_pose + 12 * b;
  real R[9], t[3];
  if (octo_body_parent[b] < 0) {
    for (int k = 0; k < 9; ++k) R[k] = ZERO + fixed[k];
    for (int k = 0; k < 3; ++k) t[k] = ZERO + fixed[9 + k];
  } else {
    const real *parent = kin + 12 * octo_body_parent[b];
    for (int r = 0; r < 3; ++r)
      for (int k = 0; k < 3; ++k) R[3 * r + k] = parent[3 * r] * fixed[k] + parent[3 * r + 1] * fixed[3 + k] + parent[3 * r + 2] * fixed[6 + k];
    octo_place(parent, fixed + 9, t);
  }
  for (int j = octo_body_first[b]; j < octo_body_first[b + 1]; ++j) octo_move(j, x, turn + 2 * j, R, t, kin + 12 * NB + 6 * j);
  for (int k = 0; k < 9; ++k) kin[12 * b + k] = R[k];
  for (int k = 0; k < 3; ++k) kin[12 * b + 9 + k] = t[k];
}

/* Poses of the bodies and world twists of the degrees of freedom at one node: kin (12 NB + 6 NX). */
static void octo_kin(const real *x, real *kin) {
  real turn[2 * NX];
  for (int j = 0; j < NX; ++j) octo_turn(j, x, turn + 2 * j);
  for (int b = 0; b < NB; ++b) octo_pose(b, x, turn, kin);
}

#ifndef NG
#define NG 0 /* contacts that a world is asked about at each node: all but those of crowds */
#endif
#ifndef JET
#define JET 1
#endif

#ifdef WORLD
/* What the world says at the centres of the contact spheres stands behind the poses and twists of kin. */
#define LOOKED(kin, g) ((kin) + 12 * NB + 6 * NX + JET * (g))

/* The jet of contact sphere g where it stands; of a member of a crowd, g < 0, in ``own``, for it stands nowhere. */
static inline const real *octo_looked(const double *p, const real *kin, int g, int body, const double *sphere, int order, real *own) {
#if NCROWD > 0
  if (g >= 0) return LOOKED(kin, g);
  const double *world = (const double *)(size_t)p[WORLD];
  real center[3];
  octo_place(kin + 12 * body, sphere, center);
#ifdef STEPS
  for (int k = 0; k < STEPS; ++k) {
    double at[3] = {center[0][k], center[1][k], center[2][k]}, jet[JET];
    octo_world(world, at, order, jet);
    for (int e = 0; e < octo_world_size(order); ++e) own[e][k] = jet[e];
  }
#else
  octo_world(world, center, order, own);
#endif
  return own;
#else
  return LOOKED(kin, g);
#endif
}
#endif

#if NG > 0
#ifndef ASKED_OF_WORLD
#define ASKED_OF_WORLD {0} /* of each contact, whether terms ask about it where it is far from everything, too */
#endif
static const char octo_asked_of_world[NG] = ASKED_OF_WORLD;

/* Of each contact sphere where it was when it was looked up last, and φ there, m: NaN, never. */
typedef struct { double from[NG][3], phi[NG]; } octo_last_looks;

static inline void octo_last_begin(octo_last_looks *last) {
  for (int g = 0; g < NG; ++g) {
    for (int c = 0; c < 3; ++c) last->from[g][c] = 0.0;
    last->phi[g] = NAN;
  }
}

/* φ and its derivatives up to ``order`` at the centre of contact sphere g, or that nothing is within its reach. ``last``: of
 * the lanes before. */
static inline void octo_look_at(const double *p, int g, int order, real *kin, octo_last_looks *last) {
  const double *world = (const double *)(size_t)p[WORLD], *sphere = octo_ground_sphere + 4 * g, *arg[1] = {p};
  double reach, *res[1] = {&reach};
  octo_reach(arg, res);
  const double beyond = octo_asked_of_world[g] ? INFINITY : sphere[3] + reach;
  real center[3], *jet = LOOKED(kin, g);
  octo_place(kin + 12 * octo_ground_body[g], sphere, center);
#ifdef STEPS
  /* Nodes in a row are near each other: where φ cannot have come down to ``beyond`` since the last look, nobody looks. */
  double own[JET], *from = last->from[g];
  const int size = octo_world_size(order);
  for (int e = 1; e < size; ++e) jet[e] = ZERO + (double)(e == 3); /* level, as octo_world_within has it */
  for (int k = 0; k < STEPS; ++k) {
    const double at[3] = {center[0][k], center[1][k], center[2][k]};
    const double moved[3] = {at[0] - from[0], at[1] - from[1], at[2] - from[2]};
    const double least = last->phi[g] - world[OCTO_WORLD_STEEPEST] * sqrt(octo_dot(moved, moved));
    if (least >= beyond) { jet[0][k] = least; continue; }
    octo_world_within(world, at, last->phi[g] < beyond ? INFINITY : beyond, order, own); /* one that was within is so again */
    for (int e = 0; e < size; ++e) jet[e][k] = own[e];
    for (int c = 0; c < 3; ++c) from[c] = at[c];
    last->phi[g] = own[0];
  }
#else
  octo_world_within(world, center, beyond, order, jet);
#endif
}

static void octo_look(const double *p, int order, real *kin, octo_last_looks *last) {
  for (int g = 0; g < NG; ++g) octo_look_at(p, g, order, kin, last);
}
#else
typedef struct { char none; } octo_last_looks;
#define octo_last_begin(last)
#define octo_look(p, order, kin, last)
#endif

typedef struct { const real *x[3], *kin[3]; const double *p; const real *lam; int order; } octo_input;

/* η = ad_V ξ_j at the next node. */
static inline void octo_turned(const octo_input *in, const real *V, int j, real *eta) {
  const real *xi = in->kin[0] + 12 * NB + 6 * j;
  real carried[3];
  octo_cross(V, xi, eta);
  octo_cross(V, xi + 3, eta + 3);
  octo_cross(V + 3, xi, carried);
  for (int r = 0; r < 3; ++r) eta[3 + r] += carried[r];
}

/* Inertia and gravity of a link, with its virtual twist V: the stage writes into the link's composite. */
static inline void octo_body(const octo_input *in, int l, const real *V, octo_link_blocks *k) {
  int at = 12 * octo_link_body[l];
  const ARGUMENT *arg[6] = {in->kin[0] + at, in->kin[1] + at, in->kin[2] + at, octo_link_inertia + 10 * l, in->p, V};
  real *res[9] = {k->W, k->B[0], k->B[1], k->B[2], k->T[0], k->T[1], k->T[2], k->L[0], k->L[1]};
  if (in->order == 0) STAGE(octo_body0, arg, res);
  else if (in->order == 1) STAGE(octo_body1, arg, res);
  else STAGE(octo_body2, arg, res);
}

#if NC + NCROWD > 0
/* A contact sphere on a body whose link has virtual twist V, and of a world the jet at its centre; one that is out of reach is
 * skipped, a NaN is not. */
static inline void octo_contact_at(const octo_input *in, int body, const double *sphere, const real *jet, const real *V, octo_touch_blocks *k) {
  int at = 12 * body;
  real center[3], gap;
  octo_place(in->kin[0] + at, sphere, center);
#ifdef WORLD
  const ARGUMENT *place[4] = {center, sphere + 3, in->p, jet};
#else
  const ARGUMENT *place[3] = {center, sphere + 3, in->p};
#endif
  real *depth[1] = {&gap};
  STAGE(octo_gap, place, depth);
  k->active = NOT(gap <= 0.0);
  if (!ANY(k->active)) return;
#ifdef WORLD
  const ARGUMENT *arg[6] = {in->kin[0] + at, in->kin[1] + at, sphere, in->p, V, jet};
#else
  const ARGUMENT *arg[5] = {in->kin[0] + at, in->kin[1] + at, sphere, in->p, V};
#endif
  real *res[6] = {k->W, k->B[0], k->B[1], k->T[0], k->T[1], k->L};
  if (in->order == 0) STAGE(octo_contact0, arg, res);
  else if (in->order == 1) STAGE(octo_contact1, arg, res);
  else STAGE(octo_contact2, arg, res);
}
#endif

#if NC > 0
/* Single terrain contact c. */
static inline void octo_contact(const octo_input *in, int c, const real *V, octo_touch_blocks *k) {
#ifdef WORLD
  const real *jet = LOOKED(in->kin[0], octo_contact_ground[c]);
#else
  const real *jet = 0;
#endif
  octo_contact_at(in, octo_contact_body[c], octo_contact_sphere + 4 * c, jet, V, k);
}
#endif

/* Force, its three derivatives, its second derivative to x_next of joint j: k (5). */
static inline void octo_joint(const octo_input *in, int j, real *k) {
  const ARGUMENT *arg[5] = {in->x[0] + j, in->x[1] + j, in->x[2] + j, octo_joint_table + 6 * j, in->p};
  real *res[5] = {k, k + 1, k + 2, k + 3, k + 4};
  if (in->order == 0) STAGE(octo_joint0, arg, res);
  else if (in->order == 1) STAGE(octo_joint1, arg, res);
  else STAGE(octo_joint2, arg, res);
}
