/* FD of a reduced deformable body, its Jacobian and the curvature of lamᵀFD, in loops over modes and vertices.
 *
 * The formulas are those of inertia.py and contact.py. With T = [w_k R | t], w = (1, z), a force on T is F, (NSHAPE, 9) on the
 * blocks w_k R, and f (3) on t; FD = ⟨∂T, F⟩. A contact adds its own to F, and its slopes to the blocks of J and H.
 *
 * ``real`` is a number of a step: a double, or a vector with several steps in its lanes (lanes.c, which defines STEPS). The
 * text before this one defines the sizes, the tables octo_* of the body and the functions octo_turn, octo_bend, octo_gap and
 * octo_point0…2. Matrices are (3, 3), row by row. */

#define octo_look(p, order, kin, last)
#ifdef STEPS
#define KEPT(mask, value) WHERE(mask, value)
#define ABS(value) octo_fabs(value)
#define LOOKS STEPS /* lanes, each of which looks up a world alone */
#define OF_LANE(value, k) ((value)[k])
#define SET_LANE(mask, k) ((mask)[k] = -1)
#else
typedef double real;
typedef int octo_mask;
#define ZERO 0.0
#define NOT(mask) (!(mask))
#define ANY(mask) (mask)
#define ARGUMENT double
#define STAGE(name, arg, res) name(arg, res)
#define KEPT(mask, value) ((mask) ? (value) : 0.0)
#define ABS(value) fabs(value)
#define LOOKS 1
#define OF_LANE(value, k) (value)
#define SET_LANE(mask, k) ((mask) = 1)
#endif
#ifdef __CUDACC_RTC__
#define INTO static __forceinline__
#define APART static __attribute__((noinline)) /* NVRTC takes a minute for all in one */
#else
#define INTO static inline __attribute__((always_inline))
#define APART static
#endif

typedef struct { const real *x[3], *kin[3]; const double *p; const real *lam; int order; } octo_input;

#define NMODE (NSHAPE - 1)
#define FLAT (3 * NSHAPE)     /* numbers of a vertex: φ_0 = X, φ_1, … */
#define ENTRY (FLAT + 1 + NMODE) /* and of an entry of the tree: its radius, and how much that grows with each |z_k| */
#define BLOCKS 90             /* of a node, behind R, its slopes and second derivatives: Σ_k w_k S_kl, … */
#define FIRST (BLOCKS + 9 * NSHAPE) /* … and Σ_k w_k m_k */
#define FRAME (FIRST + 3)
#define SLOPE(turns, a) ((turns) + 9 + 9 * (a))
#define SECOND(turns, a, b) ((turns) + 36 + 9 * octo_twice[a][b])
static const int octo_twice[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};

typedef struct {
  real F[NSHAPE][9], f[3], weights[3][NSHAPE];         /* w of the three nodes */
  real along[90], modal[NSHAPE], of_modal[9 * NSHAPE]; /* R_λ; (0, μ) of lam = (…, μ), and Σ_k μ_k S_kl */
  real pull[3][NSHAPE][9];                             /* M λ̂ and the contacts' share, of the nodes */
  real mixed[NX * NX];
#ifdef WORLD
  const double *world; /* its numbers */
  double reach;        /* m, of the contact law */
#endif
  int entry; /* the vertex that is being evaluated, among those of the tree */
  real left[6][NX], before[3][NX], right[6][NX], delta[3]; /* J = ∂P/∂x and −∂δ; J' of now; what these are multiplied by; J λ */
} octo_work;

/* Σ_ij A_ij B_ij: of reals or of a table's numbers. */
#define INNER(A, B) ((A)[0] * (B)[0] + (A)[1] * (B)[1] + (A)[2] * (B)[2] + (A)[3] * (B)[3] + (A)[4] * (B)[4] + (A)[5] * (B)[5] \
                   + (A)[6] * (B)[6] + (A)[7] * (B)[7] + (A)[8] * (B)[8])
#define ROW(A, i, v) ((A)[3 * (i)] * (v)[0] + (A)[3 * (i) + 1] * (v)[1] + (A)[3 * (i) + 2] * (v)[2])

static inline void octo_add_product(const real *A, const real *B, real *out) { /* out += A B */
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[3 * i + j] += A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
}
static inline void octo_across(const real *A, const real *B, real *out) { /* Aᵀ B */
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
}
static inline void octo_whole(const real *weights, const real *blocks, real *out) { /* Σ_k w_k blocks_k */
  for (int e = 0; e < 9; ++e) out[e] = ZERO;
  for (int k = 0; k < NSHAPE; ++k)
    for (int e = 0; e < 9; ++e) out[e] += weights[k] * blocks[9 * k + e];
}
static inline void octo_blocks(const real *weights, real *out) { /* Σ_k w_k S_kl */
  for (int e = 0; e < 9 * NSHAPE; ++e) out[e] = ZERO;
  for (int k = 0; k < NSHAPE; ++k)
    for (int e = 0; e < 9 * NSHAPE; ++e) out[e] += weights[k] * octo_second[9 * NSHAPE * k + e];
}
static inline void octo_firsts(const real *weights, real *out) { /* Σ_k w_k m_k */
  for (int j = 0; j < 3; ++j) out[j] = ZERO;
  for (int k = 0; k < NSHAPE; ++k)
    for (int j = 0; j < 3; ++j) out[j] += weights[k] * octo_first[3 * k + j];
}
static inline void octo_weights(const real *x, real *weights) {
  weights[0] = ZERO + 1.0;
  for (int k = 0; k < NMODE; ++k) weights[1 + k] = x[6 + k];
}

APART void octo_frame(const real *x, real *kin) {
  const ARGUMENT *arg[1] = {x + 3};
  real *res[1] = {kin}, weights[NSHAPE];
  octo_weights(x, weights);
  STAGE(octo_turn, arg, res);
  octo_blocks(weights, kin + BLOCKS);
  octo_firsts(weights, kin + FIRST);
}

/* Of inertia and gravity. */
APART void octo_forces(const octo_input *in, octo_work *s) {
  const double rate = 1.0 / (in->p[DT] * in->p[DT]), factor[3] = {rate, -2.0 * rate, rate};
  real a[3];
  for (int i = 0; i < 3; ++i) {
    a[i] = rate * (in->x[0][i] - 2.0 * in->x[1][i] + in->x[2][i]) - in->p[GRAVITY + i];
    s->f[i] = octo_mass[0] * a[i];
  }
  for (int k = 0; k < NSHAPE; ++k)
    for (int e = 0; e < 9; ++e) s->F[k][e] = a[e / 3] * octo_first[3 * k + e % 3];
  for (int node = 0; node < 3; ++node) {
    const real *kin = in->kin[node];
    real R[9];
    for (int e = 0; e < 9; ++e) R[e] = factor[node] * kin[e];
    for (int k = 0; k < NSHAPE; ++k) octo_add_product(R, kin + BLOCKS + 9 * k, s->F[k]);
    for (int i = 0; i < 3; ++i) s->f[i] += ROW(R, i, kin + FIRST);
  }
}

APART void octo_write_rows(const octo_input *in, octo_work *s, real *fd) {
  const real *kin = in->kin[0];
  real G[9];
  octo_whole(s->weights[0], s->F[0], G);
  for (int i = 0; i < 3; ++i) fd[i] = s->f[i];
  for (int a = 0; a < 3; ++a) fd[3 + a] = INNER(SLOPE(kin, a), G);
  for (int k = 0; k < NMODE; ++k) fd[6 + k] = INNER(kin, s->F[1 + k]);
}

/* out += ⟨∂²(w_k R), F⟩ of R or R_λ, columns ``stride`` apart: by two angles, or an angle and a mode. */
APART void octo_add_bent(const real *turns, const real *weights, const real *F, real *out, int stride) {
  real G[9];
  octo_whole(weights, F, G);
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) out[(3 + a) * stride + 3 + b] += INNER(SECOND(turns, a, b), G);
    for (int k = 0; k < NMODE; ++k) {
      const real value = INNER(SLOPE(turns, a), F + 9 * (1 + k));
      out[(3 + a) * stride + 6 + k] += value;
      out[(6 + k) * stride + 3 + a] += value;
    }
  }
}

/* out += factor·⟨∂_i, M ∂_j T⟩: rows of angles those of w_k ``left``, whose Σ w_k S_kl and Σ w_k m_k are given, of modes those
 * of ``rotation`` or none; columns those of a node. */
APART void octo_add_coupled(const real *left, const real *weights, const real *blocks, const real *first, const real *rotation,
                             const real *kin, double factor, real *out, int stride) {
  real whole[9], both[3][9], across[9];
  octo_whole(weights, kin + BLOCKS, whole);
  for (int b = 0; b < 3; ++b) {
    for (int e = 0; e < 9; ++e) both[b][e] = ZERO;
    octo_add_product(SLOPE(kin, b), whole, both[b]);
  }
  for (int a = 0; a < 3; ++a) {
    real *row = out + (3 + a) * stride;
    for (int i = 0; i < 3; ++i) row[i] += factor * ROW(SLOPE(left, a), i, first);
    for (int b = 0; b < 3; ++b) row[3 + b] += factor * INNER(SLOPE(left, a), both[b]);
    octo_across(SLOPE(left, a), kin, across);
    for (int k = 0; k < NMODE; ++k) row[6 + k] += factor * INNER(across, blocks + 9 * (1 + k));
  }
  if (!rotation) return;
  for (int k = 0; k < NMODE; ++k)
    for (int i = 0; i < 3; ++i) out[(6 + k) * stride + i] += factor * ROW(rotation, i, octo_first + 3 * (1 + k));
  for (int b = 0; b < 3; ++b) {
    real back[9]; /* its transpose, to be multiplied element by element */
    octo_across(SLOPE(kin, b), rotation, back);
    for (int k = 0; k < NMODE; ++k) out[(6 + k) * stride + 3 + b] += factor * INNER(back, kin + BLOCKS + 9 * (1 + k));
  }
  octo_across(rotation, kin, across);
  for (int k = 0; k < NMODE; ++k)
    for (int l = 0; l < NMODE; ++l)
      out[(6 + k) * stride + 6 + l] += factor * INNER(across, octo_second + 9 * (NSHAPE * (1 + k) + 1 + l));
}

/* Their rows of t, of ⟨∂T_next, M ∂T⟩. */
APART void octo_add_moved(const real *kin, double factor, real *out, int stride) {
  for (int i = 0; i < 3; ++i) {
    out[i * stride + i] += factor * octo_mass[0];
    for (int b = 0; b < 3; ++b) out[i * stride + 3 + b] += factor * ROW(SLOPE(kin, b), i, kin + FIRST);
    for (int k = 0; k < NMODE; ++k) out[i * stride + 6 + k] += factor * ROW(kin, i, octo_first + 3 * (1 + k));
  }
}

APART void octo_write_jacobian(const octo_input *in, octo_work *s, real *jac) {
  const double rate = 1.0 / (in->p[DT] * in->p[DT]), factor[3] = {rate, -2.0 * rate, rate};
  const real *kin = in->kin[0];
  octo_add_bent(kin, s->weights[0], s->F[0], jac, 3 * NX);
  for (int node = 0; node < 3; ++node) {
    octo_add_moved(in->kin[node], factor[node], jac + node * NX, 3 * NX);
    octo_add_coupled(kin, s->weights[0], kin + BLOCKS, kin + FIRST, kin, in->kin[node], factor[node], jac + node * NX, 3 * NX);
  }
}

/* R_λ and M λ̂, before the contacts. */
APART void octo_follow(const octo_input *in, octo_work *s) {
  const double rate = 1.0 / (in->p[DT] * in->p[DT]), factor[3] = {rate, -2.0 * rate, rate};
  const ARGUMENT *arg[2] = {in->x[0] + 3, in->lam + 3};
  const real *kin = in->kin[0];
  real *res[1] = {s->along}, pull[9];
  STAGE(octo_bend, arg, res);
  s->modal[0] = ZERO;
  for (int k = 0; k < NMODE; ++k) s->modal[1 + k] = in->lam[6 + k];
  octo_blocks(s->modal, s->of_modal);
  for (int k = 0; k < NSHAPE; ++k) {
    for (int e = 0; e < 9; ++e) pull[e] = in->lam[e / 3] * octo_first[3 * k + e % 3];
    octo_add_product(s->along, kin + BLOCKS + 9 * k, pull);
    octo_add_product(kin, s->of_modal + 9 * k, pull);
    for (int node = 0; node < 3; ++node)
      for (int e = 0; e < 9; ++e) s->pull[node][k][e] = factor[node] * pull[e];
  }
}

APART void octo_write_curvature(const octo_input *in, octo_work *s, real *hess) {
  const double rate = 1.0 / (in->p[DT] * in->p[DT]), factor[3] = {rate, -2.0 * rate, rate};
  const real *kin = in->kin[0];
  real G[9], first[3];
  octo_firsts(s->modal, first);
  for (int node = 0; node < 3; ++node) {
    real *out = node == 0 ? s->mixed : hess + node * NX * NX;
    for (int e = 0; node == 0 && e < NX * NX; ++e) out[e] = ZERO;
    octo_add_coupled(s->along, s->weights[0], kin + BLOCKS, kin + FIRST, s->along, in->kin[node], factor[node], out, NX);
    octo_add_coupled(kin, s->modal, s->of_modal, first, 0, in->kin[node], factor[node], out, NX);
  }
  octo_add_bent(kin, s->weights[0], s->pull[0][0], hess, NX);
  octo_add_bent(s->along, s->weights[0], s->F[0], hess, NX);
  octo_whole(s->modal, s->F[0], G);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) hess[(3 + a) * NX + 3 + b] += INNER(SECOND(kin, a, b), G);
  octo_add_bent(in->kin[1], s->weights[1], s->pull[1][0], hess + 3 * NX * NX, NX);
  octo_add_bent(in->kin[2], s->weights[2], s->pull[2][0], hess + 4 * NX * NX, NX);
  for (int i = 0; i < NX; ++i)
    for (int j = i; j < NX; ++j) { /* the contacts have written these halves */
      const real both = hess[i * NX + j] + s->mixed[i * NX + j] + s->mixed[j * NX + i];
      hess[i * NX + j] = hess[j * NX + i] = both;
      hess[3 * NX * NX + j * NX + i] = hess[3 * NX * NX + i * NX + j];
    }
}
