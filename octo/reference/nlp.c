/* The problem behind CasADi's C interface: nlp_f, nlp_g, nlp_grad_f, nlp_jac_g, nlp_hess_l, compiled, on octo's tree pass.
 *
 * The text before this one defines NX NU MU KIN NP WORK octo_kin octo_step (the dynamics), octo_exact* and octo_touch*
 * (E of a step and of a contact with exact derivatives), NQ NTERM NCENTER NW NFC CR NZ and their tables. What depends on
 * the number of steps is handed over by octo_nlp_set. A point is evaluated once: f and g together, their derivatives
 * together; the last one is kept, for a solver asks for them one by one. One problem at a time, one thread. */

#include <stdlib.h>
#include <string.h>
#include <math.h>
#include <time.h>

typedef long long octo_int; /* casadi_int */
#define W3 (3 * NX)
enum { POINT, NUMBERS, SCALAR, ROWS, JACOBIAN, HESSIAN, NOTHING, KINDS };

typedef struct {
  int steps, local, tests, variables, rows, pairs, couples, linear, stagewise;
  const int *local_block, *pair, *test_row, *couple, *linear_row, *linear_column, *jacobian_index, *hessian_index;
  const double *weight, *test_value, *linear_value, *jacobian_constant;
  const double *carry; /* (NX, NX) of cycles: what the blocks in x_{-1} and x_0 are multiplied with; else NULL */
  const octo_int *sparsity[KINDS];
} octo_nlp_tables;

static octo_nlp_tables T;

typedef struct {
  double z[3][NX], kin[3][KIN + 1], w[NW + 1], lam[NX], e_w[NW + 1], jac[NX * W3], gradient[W3], hess[W3 * W3], curvature[CURVATURE * NX * NX];
  double chain[NW + 1][W3], second[NZ + 1], q[NQ], work[WORK + 1], memory[EXACT_W + 1], half[3 * NX * NX];
  long long integers[EXACT_IW + 1];
  int known[3];
} octo_nlp_scratch;

/* The last point: its values (order 0), then its first derivatives (order 1). */
static struct {
  double *x, *p, *fd, *g, *gradient, *jacobian, *lagrangian, *hessian, f;
  int order, numbers;
  octo_nlp_scratch *scratch;
} at;

/* Seconds, E, ‖g‖∞ of every point whose Jacobian (stagewise) or iterate (watched) was asked for. */
#define LOGGED 100000
static double octo_nlp_log[LOGGED][3];
static int octo_nlp_logged;
static double octo_nlp_began;

static double octo_now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static double octo_largest(const double *v, int count) {
  double most = 0.0;
  for (int k = 0; k < count; ++k) if (!(fabs(v[k]) <= most)) most = fabs(v[k]);
  return most;
}

static void octo_note(double f, double violation) {
  if (octo_nlp_logged >= LOGGED) return;
  double *row = octo_nlp_log[octo_nlp_logged++];
  row[0] = octo_now() - octo_nlp_began; row[1] = f; row[2] = violation;
}

int octo_nlp_set(const octo_nlp_tables *tables) {
  T = *tables;
  at.numbers = (T.steps + 2) * NX + NP + T.steps * NQ + MU;
  free(at.x); free(at.scratch);
  size_t sizes[8] = {T.variables, at.numbers, (size_t)T.steps * NX, T.rows, T.variables, (size_t)T.couples * MU * NX, T.variables, (size_t)T.pairs * NX * NX};
  double **where[8] = {&at.x, &at.p, &at.fd, &at.g, &at.gradient, &at.jacobian, &at.lagrangian, &at.hessian};
  size_t all = 0;
  for (int k = 0; k < 8; ++k) all += sizes[k] + 1;
  double *memory = malloc(all * sizeof(double));
  at.scratch = aligned_alloc(64, (sizeof(octo_nlp_scratch) + 63) / 64 * 64);
  if (!memory || !at.scratch) return 1;
  for (int k = 0; k < 8; ++k) { *where[k] = memory; memory += sizes[k] + 1; }
  at.order = -1;
  return 0;
}

/* A cycle's node of step i, without its constant, from what it is made of; nodes after x_0 are not carried. */
static void octo_carry(int i, int t, double *node) {
  double made[NX] = {0};
  if (!T.carry || i + 1 > t) return;
  for (int j = 0; j < NX; ++j)
    for (int k = 0; k < NX; ++k) made[j] += T.carry[j * NX + k] * node[k];
  memcpy(node, made, sizeof made);
}

/* Slopes (3 NX, a stride apart) with respect to the nodes of step i become those with respect to what these are made of. */
static void octo_carry_back(int i, double *slope, int stride) {
  for (int t = i + 1; T.carry && t < 3; ++t) {
    double turned[NX] = {0}, *own = slope + (size_t)t * NX * stride;
    for (int j = 0; j < NX; ++j)
      for (int k = 0; k < NX; ++k) turned[k] += own[j * stride] * T.carry[j * NX + k];
    for (int k = 0; k < NX; ++k) own[k * stride] = turned[k];
  }
}

/* The step's three nodes and their kinematics; a node that the step before had is not computed again. */
static void octo_nlp_nodes(octo_nlp_scratch *s, const double *x, const double *constant, int i) {
  double z[3][NX];
  for (int t = 0; t < 3; ++t) {
    const double *fixed = constant + (i + 2 - t) * NX;
    for (int j = 0; j < NX; ++j) z[t][j] = 0.0;
    for (int a = 0; a < T.local; ++a) {
      double weight = T.weight[(i * 3 + t) * T.local + a];
      if (weight == 0.0) continue;
      const double *block = x + (size_t)T.local_block[i * T.local + a] * NX;
      for (int j = 0; j < NX; ++j) z[t][j] += weight * block[j];
    }
    octo_carry(i, t, z[t]);
    for (int j = 0; j < NX && !T.stagewise; ++j) z[t][j] += fixed[j];
  }
  for (int t = 2; t >= 0; --t) { /* the older first: x of now is x_next of before */
    if (t > 0 && s->known[t - 1] && !memcmp(z[t], s->z[t - 1], sizeof(z[t]))) {
      memcpy(s->kin[t], s->kin[t - 1], sizeof(s->kin[t]));
    } else if (!s->known[t] || memcmp(z[t], s->z[t], sizeof(z[t]))) {
      octo_kin(z[t], s->kin[t]);
    }
    s->known[t] = 1;
    memcpy(s->z[t], z[t], sizeof(z[t]));
  }
}

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
