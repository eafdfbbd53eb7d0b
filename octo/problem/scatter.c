/* Where a step's numbers go: through the basis' stencil into the blocks H (K, 3, NC, NC), A (K, 3, MA, NC), b, C.
 *
 * Index 1 of H and A is the lag between two units. Work is cut into chunks of neighbouring steps: a chunk writes the
 * units it shares with the chunk before it to a halo, which is added afterwards in order, so that threads never write
 * to the same place. Stands before assemble.c. */

#include <stdlib.h>
#include <string.h>
#include <math.h>

#define W3 (3 * NX)
#define LD (((W3 + 7) / 8) * 8)
typedef double v8 __attribute__((vector_size(64)));
typedef long long v8_integers __attribute__((vector_size(64)));
typedef double v8_anywhere __attribute__((vector_size(64), aligned(8), may_alias));

typedef struct {
  int batch, steps, units, slots, tests, nc, ma, chunks; /* nc, ma: numbers and rows of a unit, also those that no node is made of */
  const int *chunk_step, *chunk_unit, *chunk_row;             /* (chunks+1), (chunks), (chunks): first own step, unit, row */
  const int *slot_unit, *slot_part; const double *slot_value;  /* (steps+2, slots) */
  const int *test_row, *test_part; const double *test_value;   /* (steps, tests) */
  const double *nodes;   /* (batch, steps+2, NX); apart: (batch, steps, 3, NX), x_next first */
  const double *p;       /* (batch, NP) */
  const double *q;       /* (batch, steps, NQ) coefficients and references of the costs */
  const double *row_scale; /* (batch, MU) scale of the unactuated rows, 1/(mg) or 1/(mg l) */
  double *fd;            /* (batch, steps, NX) out of octo_evaluate, in to octo_linearize */
  double *terms;         /* (batch, steps, NTERM); NULL in octo_linearize without lam: fd was not evaluated, it is written */
  double *rows;          /* (batch, steps, NBOUNDED) out of octo_evaluate: values of the bounded rows; or NULL */
  const double *lam;     /* (batch, units, ma) or NULL: Gauss-Newton */
  double *h, *a, *b, *c; /* (batch, units, 3, NC, NC) or NULL: no second derivatives; (batch, units, 3, MA, NC) (batch, units, NC) (batch, units, MA) */
  double *halo;          /* (batch, chunks, HALO) */
  const double *carry;   /* (batch, NX, NX) of cycles: what the unknowns in nodes -1 and 0 are multiplied with; else NULL */
  const int *curved;     /* (batch) with lam: whether terms over contacts and exact ones have all of their curvature, or Gauss and Newton's; NULL: all do */
  double *kept;          /* (batch, steps, KEPT_ROOM) out of octo_linearize: slopes of the bounded rows (row_products.c); or NULL */
  double *pairs;         /* (batch, steps, PAIR_ROOM) what is kept of terms over two steps in a row; NULL where there are none */
  int apart;             /* each step has its own nodes, and its own h (batch, steps, W3, W3), a (batch, steps, MU, W3), b (batch, steps, W3), c */
} octo_task;

static int octo_halo_size(const octo_task *t) {
  int nc = t->nc, ma = t->ma;
  return 2 * 3 * nc * nc + 3 * ma * nc + 2 * nc + ma;
}

typedef struct { double *h, *a, *b, *c, *halo_h, *halo_a, *halo_b, *halo_c; int unit, row, nc, ma, clear_unit, clear_row; } octo_target;

static double *octo_h(const octo_target *g, int unit) {
  size_t size = 3 * (size_t)g->nc * g->nc;
  return unit < g->unit ? g->halo_h + (size_t)(unit - g->unit + 2) * size : g->h + unit * size;
}
static double *octo_b(const octo_target *g, int unit) {
  return unit < g->unit ? g->halo_b + (unit - g->unit + 2) * g->nc : g->b + (size_t)unit * g->nc;
}
static double *octo_a(const octo_target *g, int row) {
  return row < g->row ? g->halo_a : g->a + (size_t)row * 3 * g->ma * g->nc;
}
static double *octo_c(const octo_target *g, int row) { return row < g->row ? g->halo_c : g->c + (size_t)row * g->ma; }

/* Units and rows up to these become zero: just before they are written, while they are in the cache; not H with ``fresh``. */
static void octo_clear(octo_target *g, int units, int rows, int fresh) {
  size_t hs = 3 * (size_t)g->nc * g->nc, as = 3 * (size_t)g->ma * g->nc;
  for (; g->clear_unit < units; ++g->clear_unit) {
    if (!fresh && g->h) memset(g->h + g->clear_unit * hs, 0, hs * sizeof(double));
    memset(g->b + (size_t)g->clear_unit * g->nc, 0, g->nc * sizeof(double));
  }
  for (; g->clear_row < rows; ++g->clear_row) {
    memset(g->a + g->clear_row * as, 0, as * sizeof(double));
    memset(g->c + (size_t)g->clear_row * g->ma, 0, g->ma * sizeof(double));
  }
}

#define PLACES 12 /* three nodes of at most four slots */

/* The parts of units that a step's three nodes are made of, each once: part l adds value[l][k] to node[l][k], k < terms[l]. */
typedef struct { int count, unit[PLACES], part[PLACES], terms[PLACES], node[PLACES][3]; double value[PLACES][3]; } octo_places;

static void octo_find_places(const octo_task *t, int i, octo_places *s) {
  s->count = 0;
  for (int node = 0; node < 3; ++node)
    for (int k = 0; k < t->slots; ++k) {
      size_t at = (size_t)(i + 2 - node) * t->slots + k;
      if (t->slot_unit[at] < 0) continue;
      int l = 0;
      while (l < s->count && (s->unit[l] != t->slot_unit[at] || s->part[l] != t->slot_part[at])) ++l;
      if (l == s->count) { s->unit[l] = t->slot_unit[at]; s->part[l] = t->slot_part[at]; s->terms[l] = 0; s->count++; }
      s->node[l][s->terms[l]] = node;
      s->value[l][s->terms[l]++] = t->slot_value[at];
    }
}

/* out (NX) = keep·out + Σ_k value[l][k]·(in + node[l][k]·NX). */
static inline __attribute__((always_inline)) void octo_combine(const octo_places *s, int l, const double *in, int keep, double *restrict out) {
  const double *v = s->value[l], *a = in + s->node[l][0] * NX;
  if (s->terms[l] == 1) {
    for (int j = 0; j < NX; ++j) out[j] = (keep ? out[j] : 0.0) + v[0] * a[j];
    return;
  }
  const double *b = in + s->node[l][1] * NX, *c = in + s->node[l][2] * NX;
  if (s->terms[l] == 2)
    for (int j = 0; j < NX; ++j) out[j] = (keep ? out[j] : 0.0) + (v[0] * a[j] + v[1] * b[j]);
  else
    for (int j = 0; j < NX; ++j) out[j] = (keep ? out[j] : 0.0) + (v[0] * a[j] + v[1] * b[j] + v[2] * c[j]);
}

/* line (3 NX) over a step's nodes: from ``node`` on, over what the carried nodes are made of: line_node times the matrix. */
static void octo_carry_line(const double *carry, int node, double *line) {
  for (; node < 3; ++node) {
    double *own = line + node * NX, turned[NX] = {0};
    for (int j = 0; j < NX; ++j)
      for (int k = 0; k < NX; ++k) turned[k] += own[j] * carry[j * NX + k];
    memcpy(own, turned, sizeof turned);
  }
}

/* A cycle's first two steps: slopes with respect to x_{-1} and x_0 become those with respect to what these are made of. */
static void octo_carry_back(const double *carry, int i, double *hess, double *gradient, double *jac) {
  int node = 1 + i; /* step 0 sees both as nodes 1 and 2, step 1 sees x_0 as node 2 */
  octo_carry_line(carry, node, gradient);
  for (int r = 0; r < NX; ++r) octo_carry_line(carry, node, jac + r * W3);
  if (!hess) return;
  for (int r = 0; r < W3; ++r) octo_carry_line(carry, node, hess + r * LD);
  for (int c = 0; c < W3; ++c) {
    double column[W3];
    for (int r = 0; r < W3; ++r) column[r] = hess[r * LD + c];
    octo_carry_line(carry, node, column);
    for (int r = 0; r < W3; ++r) hess[r * LD + c] = column[r];
  }
}

/* b += Sᵀ gradient. */
static void octo_scatter_gradient(const octo_target *g, const octo_places *s, const double *gradient) {
  for (int a = 0; a < s->count; ++a) octo_combine(s, a, gradient, 1, octo_b(g, s->unit[a]) + s->part[a] * NX);
}

/* Nodes: a unit is a whole node. The first step that sees a unit, with both units before it, writes all of its blocks. */
static void octo_scatter_nodes(const octo_target *g, const octo_places *s, int fresh, const double *hess, const double *gradient) {
  for (int a = 0; a < s->count; ++a) {
    const double *from = hess + s->node[a][0] * NX * LD;
    double *h = octo_h(g, s->unit[a]);
    octo_combine(s, a, gradient, 1, octo_b(g, s->unit[a]));
    for (int b = a; b < s->count; ++b) {
      double *to = h + (size_t)(s->unit[a] - s->unit[b]) * NX * NX;
      for (int r = 0; r < NX; ++r)
        if (fresh && a == 0) octo_combine(s, b, from + r * LD, 0, to + r * NX);
        else octo_combine(s, b, from + r * LD, 1, to + r * NX);
    }
  }
}

/* H += Sᵀ hess S and b += Sᵀ gradient, row by row: the sums over a row's columns are shared by all parts that it adds to. */
static void octo_scatter_model(const octo_target *g, const octo_places *s, const double *hess, const double *gradient) {
  double *to[PLACES][PLACES]; /* first row of a block of H, 0 above the diagonal */
  for (int a = 0; a < s->count; ++a) {
    double *h = octo_h(g, s->unit[a]);
    octo_combine(s, a, gradient, 1, octo_b(g, s->unit[a]) + s->part[a] * NX);
    for (int b = 0; b < s->count; ++b) {
      int lag = s->unit[a] - s->unit[b];
      to[a][b] = lag < 0 ? 0 : h + ((size_t)lag * g->nc + s->part[a] * NX) * g->nc + s->part[b] * NX;
    }
  }
  for (int r = 0; r < NX; ++r)
    for (int b = 0; b < s->count; ++b) {
      double column[W3];
      for (int node = 0; node < 3; ++node) octo_combine(s, b, hess + (node * NX + r) * LD, 0, column + node * NX);
      for (int a = 0; a < s->count; ++a)
        if (to[a][b]) octo_combine(s, a, column, 1, to[a][b] + (size_t)r * g->nc);
    }
}

/* A += Sᵀ U_/J S and C += Sᵀ U_/FD, scaled. */
static void octo_scatter_constraints(const octo_task *t, const octo_target *g, const octo_places *s, int i, const double *row_scale,
                                     const double *fd, const double *jac) {
#if MU > 0
  for (int k = i * t->tests; k < (i + 1) * t->tests; ++k) {
    int row = t->test_row[k], offset = t->test_part[k] * MU;
    if (row < 0) continue;
    double *c = octo_c(g, row) + offset, *a = octo_a(g, row);
    for (int r = 0; r < MU; ++r) {
      double scale = t->test_value[k] * row_scale[r], line[W3];
      const double *in = jac + octo_unactuated[r] * W3;
      c[r] += scale * fd[octo_unactuated[r]];
      for (int j = 0; j < W3; ++j) line[j] = scale * in[j];
      for (int l = 0; l < s->count; ++l)
        octo_combine(s, l, line, 1, a + ((size_t)(row - s->unit[l]) * g->ma + offset + r) * g->nc + s->part[l] * NX);
    }
  }
#endif
}

/* Steps apart: what one makes of its own three nodes, before any stencil; of h what stands right of the nodes' diagonal blocks. */
static void octo_write_stage(const octo_task *t, int member, int i, const double *fd, const double *jac, const double *hess, const double *gradient) {
  size_t step = (size_t)member * t->steps + i;
  const double *row_scale = t->row_scale + (size_t)member * MU;
  for (int r = 0; hess && r < W3; ++r) memcpy(t->h + (step * W3 + r) * W3, hess + r * LD, W3 * sizeof(double));
  memcpy(t->b + step * W3, gradient, W3 * sizeof(double));
  for (int r = 0; r < MU; ++r) {
    t->c[step * MU + r] = row_scale[r] * fd[octo_unactuated[r]];
    for (int j = 0; j < W3; ++j) t->a[(step * MU + r) * W3 + j] = row_scale[r] * jac[octo_unactuated[r] * W3 + j];
  }
}

/* C of one member. */
static void octo_reduce(const octo_task *t, int member) {
  int ma = t->ma;
  double *c = t->c + (size_t)member * t->units * ma;
  memset(c, 0, (size_t)t->units * ma * sizeof(double));
#if MU > 0
  const double *row_scale = t->row_scale + (size_t)member * MU;
  for (int i = 0; i < t->steps; ++i) {
    const double *fd = t->fd + ((size_t)member * t->steps + i) * NX;
    for (int k = i * t->tests; k < (i + 1) * t->tests; ++k) {
      if (t->test_row[k] < 0) continue;
      double *out = c + (size_t)t->test_row[k] * ma + t->test_part[k] * MU;
      for (int r = 0; r < MU; ++r) out[r] += t->test_value[k] * row_scale[r] * fd[octo_unactuated[r]];
    }
  }
#endif
}

static void octo_add_halo(const octo_task *t, int member) {
  int nc = t->nc, ma = t->ma;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc;
  for (int chunk = 1; chunk < t->chunks; ++chunk) {
    const double *halo = t->halo + ((size_t)member * t->chunks + chunk) * octo_halo_size(t);
    for (int k = 0; k < 2; ++k) {
      int unit = t->chunk_unit[chunk] - 2 + k;
      if (unit < 0) continue;
      double *h = t->h + ((size_t)member * t->units + unit) * hs, *b = t->b + ((size_t)member * t->units + unit) * nc;
      for (size_t j = 0; t->h && j < hs; ++j) h[j] += halo[k * hs + j];
      for (int j = 0; j < nc; ++j) b[j] += halo[2 * hs + as + k * nc + j];
    }
    int row = t->chunk_row[chunk] - 1;
    if (row < 0) continue;
    double *a = t->a + ((size_t)member * t->units + row) * as, *c = t->c + ((size_t)member * t->units + row) * ma;
    for (size_t j = 0; j < as; ++j) a[j] += halo[2 * hs + j];
    for (int j = 0; j < ma; ++j) c[j] += halo[2 * hs + as + 2 * nc + j];
  }
}
