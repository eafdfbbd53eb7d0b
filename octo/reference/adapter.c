/* octo's own evaluate and linearize (problem/assemble.c) as f, g and their derivatives over one vector x.
 *
 * Nothing here knows a robot: tasks, functions, tables and the memory of everything are handed over by octo_adapter_set
 * (library.py). A point is evaluated once: f and g together, their first derivatives together; the last one is kept, for
 * a solver asks for them one by one. One problem at a time, one thread. Stands before interface.c. */

#include <math.h>
#include <string.h>
#include <time.h>

typedef long long octo_int; /* casadi_int */
enum { POINT, NUMBERS, SCALAR, ROWS, JACOBIAN, HESSIAN, NOTHING, KINDS };

typedef struct {
  int variables, rows, numbers, n, nodes, slots, steps, terms, references, first_q, linear, segment, tested, bounded, first_slope,
      slopes, products;
  const int *node_variable, *place, *row_place;    /* (nodes, slots) first of x; (variables) in b; (rows) in C; -1: none */
  const int *jacobian_index, *hessian_index;       /* of each nonzero, in A (-1: constant) and in H */
  const int *linear_row, *linear_column, *fixed;   /* of the constant part of g; (units) that nothing moves */
  const int *target, *one, *other;                 /* (products) of slopes of bounded rows: which, of what numbers in kept */
  const double *node_value, *jacobian_constant, *linear_value;
  const double *carry;                             /* (n, n) of cycles: what x in nodes -1 and 0 is multiplied with; else NULL */
  const double *product_value, *lower, *upper;     /* (products); (rows) bounds of g */
  double *x, *p, *q, *trajectory, *energies, *g, *controls; /* p: constant nodes (steps+2, n), parameters, q (steps, references), scales */
  double *C, *A, *b, *H, *lam, *gradient, *lagrangian, *kept; /* behind C (tested) bounded rows (steps, bounded), behind lam their
                                                               * multipliers, behind A their slopes; kept ends with a 1 */
  void *value, *slope, *curvature;                 /* tasks over this memory: of values, first derivatives, all of them */
  int (*evaluate)(void *, int), (*linearize)(void *, int);
  void (*between_values)(void *, double *, int), (*between_model)(void *, double *, const int *, int);
  const octo_int *sparsity[KINDS];
} octo_adapter;

static octo_adapter T;
static struct { double f, sign; int order; } at; /* order: -1: nothing is known of x, 0: f and g, 1: first derivatives */

void octo_adapter_set(const octo_adapter *tables) { T = *tables; at.order = -1; }

/* Set by a signal handler's caller: every evaluation fails from then on, so that a solver without a call-back ends too. */
static volatile int octo_stopped;
void octo_stop(int stopped) { octo_stopped = stopped; }

/* Seconds, E, violation of every point whose Jacobian (stagewise) or iterate (watched) was asked for. */
#define LOGGED 100000
static double octo_log[LOGGED][3];
static int octo_logged;
static double octo_began;

static double octo_now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* How far g is off its bounds; of C, whose bounds are 0, ‖C‖∞. */
static double octo_violation(const double *g) {
  double most = 0.0;
  for (int r = 0; r < T.rows; ++r) {
    double off = fmax(T.lower[r] - g[r], g[r] - T.upper[r]);
    if (!(off <= most)) most = off;
  }
  return most;
}

/* The largest multiplier of an inequality times the room to its bound. */
static double octo_gap(const double *g, const double *lam) {
  double most = 0.0;
  for (int r = 0; r < T.rows; ++r) {
    if (T.lower[r] == T.upper[r]) continue;
    double room = lam[r] > 0.0 ? T.upper[r] - g[r] : g[r] - T.lower[r], gap = fabs(lam[r] * room);
    if (isfinite(room) && gap > most) most = gap;
  }
  return most;
}

static void octo_note(double f, double violation) {
  if (octo_logged >= LOGGED) return;
  double *row = octo_log[octo_logged++];
  row[0] = octo_now() - octo_began; row[1] = f; row[2] = violation;
}

/* The nodes of x; of a cycle the first two are carried back. */
static void octo_make_nodes(void) {
  for (int node = 0; node < T.nodes; ++node) {
    double made[T.n], *out = T.trajectory + (size_t)node * T.n;
    for (int j = 0; j < T.n; ++j) made[j] = 0.0;
    for (int s = node * T.slots; s < (node + 1) * T.slots; ++s)
      for (int j = 0; T.node_variable[s] >= 0 && j < T.n; ++j) made[j] += T.node_value[s] * T.x[T.node_variable[s] + j];
    for (int j = 0; j < T.n; ++j) {
      out[j] = made[j];
      if (T.carry && node < 2) {
        out[j] = 0.0;
        for (int k = 0; k < T.n; ++k) out[j] += T.carry[j * T.n + k] * made[k];
      }
#ifndef STAGEWISE
      out[j] += T.p[node * T.n + j];
#endif
    }
  }
}

/* c_0, of x_{-1} and x_0, and what x is of the others; pinned ones stay. */
static void octo_make_controls(void) {
  const double *before = T.p, *now = T.p + T.n;
  for (int j = 0; j < T.n; ++j) { T.controls[j] = now[j]; T.controls[T.n + j] = T.segment * (now[j] - before[j]); }
  for (int k = 0; k < T.variables; ++k) T.controls[2 * T.n + T.place[k]] = T.x[k];
}

static int octo_make_values(void) {
  octo_make_nodes();
  if (T.evaluate(T.value, 1)) return 1;
  if (T.between_values) { octo_make_controls(); T.between_values(T.value, T.controls, 1); }
  at.f = 0.0;
  for (int k = 0; k < T.steps * T.terms; ++k) at.f += T.energies[k];
  for (int r = 0; r < T.rows; ++r) T.g[r] = T.row_place[r] < 0 ? 0.0 : T.C[T.row_place[r]];
  for (int k = 0; k < T.linear; ++k) T.g[T.linear_row[k]] += T.linear_value[k] * T.x[T.linear_column[k]];
  return 0;
}

static int octo_make_slopes(void) {
  if (T.linearize(T.slope, 1)) return 1;
  if (T.between_model) T.between_model(T.slope, T.controls, T.fixed, 1);
  for (int k = 0; k < T.variables; ++k) T.gradient[k] = T.b[T.place[k]];
  double *slopes = T.A + T.first_slope;
  for (int k = 0; k < T.slopes; ++k) slopes[k] = 0.0;
  for (int k = 0; k < T.products; ++k) slopes[T.target[k]] += T.product_value[k] * T.kept[T.one[k]] * T.kept[T.other[k]];
  return 0;
}

/* Make f and g of x known, with ``order`` 1 the gradient and the Jacobian; 0, or 1 where that fails. */
static int octo_point(const double *x, const double *p, int order) {
  if (octo_stopped) return 1;
  if (at.order < 0 || memcmp(x, T.x, T.variables * sizeof(double)) || memcmp(p, T.p, T.numbers * sizeof(double))) {
    memcpy(T.x, x, T.variables * sizeof(double));
    memcpy(T.p, p, T.numbers * sizeof(double));
    at.order = -1;
    if (octo_make_values()) return 1;
    at.order = 0;
  }
  if (order > at.order) {
    if (octo_make_slopes()) return 1;
    at.order = 1;
  }
  return 0;
}

static double octo_jacobian(int k) { return T.jacobian_index[k] < 0 ? T.jacobian_constant[k] : T.A[T.jacobian_index[k]]; }
static double octo_hessian(int k) { return at.sign * T.H[T.hessian_index[k]]; }

/* Make H of sigma f + lamᵀg known: E's coefficients are multiplied by |sigma|, which any sigma allows. */
static int octo_point_hessian(const double *x, const double *p, double sigma, const double *lam) {
  if (octo_point(x, p, 0)) return 1;
  at.sign = sigma < 0.0 ? -1.0 : 1.0;
  memcpy(T.q, T.p + T.first_q, (size_t)T.steps * T.references * sizeof(double));
  for (int i = 0; i < T.steps; ++i)
    for (int k = 0; k < T.terms; ++k) T.q[(size_t)i * T.references + k] *= fabs(sigma);
  for (int r = 0; r < T.rows; ++r)
    if (T.row_place[r] >= 0) T.lam[T.row_place[r]] = lam ? at.sign * lam[r] : 0.0;
  for (int i = 0; i < T.steps; ++i) /* q ends with the multipliers of the bounded rows */
    for (int k = 0; k < T.bounded; ++k) T.q[(i + 1) * T.references - T.bounded + k] = T.lam[T.tested + i * T.bounded + k];
  if (T.linearize(T.curvature, 1)) return 1;
  if (T.between_model) T.between_model(T.curvature, T.controls, T.fixed, 1);
  return 0;
}

/* The gradient of sigma f + lamᵀg. */
static int octo_point_lagrangian(const double *x, const double *p, double sigma, const double *lam) {
  if (octo_point(x, p, 1)) return 1;
  const octo_int *start = T.sparsity[JACOBIAN] + 2, *row = start + T.variables + 1;
  for (int c = 0; c < T.variables; ++c) {
    double sum = sigma * T.gradient[c];
    for (octo_int k = start[c]; lam && k < start[c + 1]; ++k) sum += octo_jacobian(k) * lam[row[k]];
    T.lagrangian[c] = sum;
  }
  return 0;
}
