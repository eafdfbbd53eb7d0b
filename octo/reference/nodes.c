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
