/* E, C and their model (Eq. 9) over all time steps, appended to the text of the dynamics and of the costs.
 *
 * The generated text before this one defines: NX NU MU KIN NP WORK octo_kin octo_step (the dynamics);
 * NQ NTERM NR NZ CR NFC and the tables and functions of the costs (problem/codegen.py).
 * A step's rows (residuals scaled by the root of twice their coefficient) are stacked, so that the Gauss-Newton block
 * is rowsᵀ rows; the curvature of lambdaᵀFD is added by octo_step. Blocks are scattered through the basis' stencil
 * straight into H (K, 3, NC, NC), A (K, 3, MA, NC), b, C, where index 1 is the lag between two units.
 * Work is cut into chunks of neighbouring steps: a chunk writes the units it shares with the chunk before it to a halo,
 * which is added afterwards in order, so that threads never write to the same place. */

#include <stdlib.h>
#include <string.h>
#include <math.h>

#define W3 (3 * NX)
#define LD (((W3 + 7) / 8) * 8)
#define MROWS (NR + NFC * CR)
typedef double v8 __attribute__((vector_size(64)));

typedef struct {
  int batch, steps, units, slots, tests, parts, chunks;
  const int *chunk_step, *chunk_unit, *chunk_row;             /* (chunks+1), (chunks), (chunks): first own step, unit, row */
  const int *slot_unit, *slot_part; const double *slot_value;  /* (steps+2, slots) */
  const int *test_row, *test_part; const double *test_value;   /* (steps, tests) */
  const double *nodes;   /* (batch, steps+2, NX) */
  const double *p;       /* (batch, NP) */
  const double *q;       /* (batch, steps, NQ) coefficients and references of the costs */
  const double *row_scale; /* (batch, MU) scale of the unactuated rows, 1/(mg) or 1/(mg l) */
  double *fd;            /* (batch, steps, NX) out of octo_evaluate, in to octo_linearize */
  double *terms;         /* (batch, steps, NTERM) */
  const double *lam;     /* (batch, units, parts*MU) or NULL: Gauss-Newton */
  double *h, *a, *b, *c; /* (batch, units, 3, NC, NC) (batch, units, 3, MA, NC) (batch, units, NC) (batch, units, MA) */
  double *halo;          /* (batch, chunks, HALO) */
} octo_task;

static int octo_halo_size(const octo_task *t) {
  int nc = t->parts * NX, ma = t->parts * MU;
  return 2 * 3 * nc * nc + 3 * ma * nc + 2 * nc + ma;
}

/* Residuals of the costs of one step, unscaled: r (MROWS). */
static void octo_residuals(const double *x_next, const double *x, const double *x_prev, const double *u, const double *kin_next,
                           const double *kin, const double *kin_prev, const double *p, const double *q, double *r, double *w, long long *iw) {
  const double *arg[8]; double *res[4];
#if NR > 0
  arg[0] = x_next; arg[1] = x; arg[2] = x_prev; arg[3] = u; arg[4] = p; arg[5] = q; res[0] = r;
  octo_state_cost(arg, res, (void *)iw, w, 0);
#endif
#if NFC > 0
  for (int k = 0; k < NFC; ++k) {
    int body = octo_cost_contact_body[k];
    arg[0] = kin_next + 12 * body; arg[1] = kin + 12 * body; arg[2] = kin_prev + 12 * body;
    arg[3] = octo_cost_contact_data + 4 * k; arg[4] = p; arg[5] = q; res[0] = r + NR + k * CR;
    octo_contact_cost(arg, res, (void *)iw, w, 0);
  }
#endif
}

static double octo_coefficient(const double *q, int row) {
#if NFC > 0
  if (row >= NR) {
    int k = (row - NR) / CR, c = (row - NR) % CR;
    return octo_cost_contact_use[k * CR + c] ? q[octo_contact_row_term[c]] : 0.0;
  }
#endif
  return q[octo_state_row_term[row]];
}

static int octo_row_term(int row) {
#if NFC > 0
  if (row >= NR) return octo_contact_row_term[(row - NR) % CR];
#endif
  return octo_state_row_term[row];
}

void octo_evaluate(const octo_task *t, int threads) {
  int items = t->batch * t->chunks;
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
  for (int item = 0; item < items; ++item) {
    int member = item / t->chunks, chunk = item % t->chunks;
    double kin[3][KIN + 1], work[WORK + 1], w[COST_W + 1], r[MROWS + 1], u[NU + 1]; long long iw[COST_IW + 1];
    const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX, *p = t->p + (size_t)member * NP;
    int first = t->chunk_step[chunk], last = t->chunk_step[chunk + 1];
    octo_kin(nodes + first * NX, kin[first % 3]);
    octo_kin(nodes + (first + 1) * NX, kin[(first + 1) % 3]);
    for (int i = first; i < last; ++i) {
      const double *x_prev = nodes + i * NX, *x = x_prev + NX, *x_next = x + NX;
      const double *q = t->q + ((size_t)member * t->steps + i) * NQ;
      double *fd = t->fd + ((size_t)member * t->steps + i) * NX, *terms = t->terms + ((size_t)member * t->steps + i) * NTERM;
      octo_kin(x_next, kin[(i + 2) % 3]);
      octo_step(x_next, x, x_prev, kin[(i + 2) % 3], kin[(i + 1) % 3], kin[i % 3], p, 0, 0, fd, 0, 0, work);
      for (int j = 0; j < NU; ++j) u[j] = fd[octo_actuated[j]];
      octo_residuals(x_next, x, x_prev, u, kin[(i + 2) % 3], kin[(i + 1) % 3], kin[i % 3], p, q, r, w, iw);
      for (int k = 0; k < NTERM; ++k) terms[k] = 0.0;
      for (int row = 0; row < MROWS; ++row) {
        double c = octo_coefficient(q, row);
        if (c != 0.0) terms[octo_row_term(row)] += c * r[row] * r[row];
      }
    }
  }
}

/* rows (count, LD) of d residual / d (x_next, x, x_prev), scaled; value of each row; lam (NX) gets dE/du. */
typedef struct { double row[MROWS + 1][LD] __attribute__((aligned(64))); double value[MROWS + 1]; int count; } octo_rows;

typedef struct { double r[MROWS + 1], jac[NZ + 1], contact[(NFC * CR + 1) * 18]; } octo_cost_values;

static void octo_cost_derivatives(const double *x_next, const double *x, const double *x_prev, const double *u, const double *const kin[3],
                                  const double *p, const double *q, octo_cost_values *v, double *lam, double *w, long long *iw) {
  const double *arg[8]; double *res[4];
#if NR > 0
  arg[0] = x_next; arg[1] = x; arg[2] = x_prev; arg[3] = u; arg[4] = p; arg[5] = q; res[0] = v->r; res[1] = v->jac;
  octo_state_cost_jac(arg, res, (void *)iw, w, 0);
#endif
#if NFC > 0
  for (int k = 0; k < NFC; ++k) {
    int body = octo_cost_contact_body[k];
    for (int node = 0; node < 3; ++node) arg[node] = kin[node] + 12 * body;
    arg[3] = octo_cost_contact_data + 4 * k; arg[4] = p; arg[5] = q;
    res[0] = v->r + NR + k * CR; res[1] = v->contact + k * CR * 18;
    octo_contact_cost_jac(arg, res, (void *)iw, w, 0);
  }
#endif
  for (int j = 0; j < NX; ++j) lam[j] = 0.0;
#if NR > 0
  for (int z = NZ - 1; z >= 0 && octo_state_entry_column[z] >= W3; --z) { /* entries are sorted by column */
    int row = octo_state_entry_row[z];
    lam[octo_actuated[octo_state_entry_column[z] - W3]] += 2.0 * q[octo_state_row_term[row]] * v->r[row] * v->jac[z];
  }
#endif
}

static void octo_build_rows(const octo_cost_values *v, const double *jac, const double *const kin[3], const double *q, octo_rows *rows) {
  int count = 0, place[MROWS + 1]; double scale[MROWS + 1];
  for (int row = 0; row < MROWS; ++row) {
    double c = octo_coefficient(q, row);
    place[row] = -1;
    if (c == 0.0) continue;
    scale[row] = sqrt(2.0 * c);
    for (int j = 0; j < LD; ++j) rows->row[count][j] = 0.0;
    rows->value[count] = scale[row] * v->r[row];
    place[row] = count++;
  }
  rows->count = count;
#if NR > 0
  for (int z = 0; z < NZ; ++z) {
    int row = octo_state_entry_row[z], column = octo_state_entry_column[z];
    if (place[row] < 0) continue;
    double value = scale[row] * v->jac[z], *out = rows->row[place[row]];
    if (column < W3) out[column] += value;
    else {
      const double *source = jac + octo_actuated[column - W3] * W3;
      for (int j = 0; j < W3; ++j) out[j] += value * source[j];
    }
  }
#endif
#if NFC > 0
  for (int row = NR; row < MROWS; ++row) {
    if (place[row] < 0) continue;
    int body = octo_cost_contact_body[(row - NR) / CR];
    const double *d = v->contact + (row - NR) * 18;
    double *out = rows->row[place[row]];
    for (int node = 0; node < 3; ++node)
      for (int z = octo_cost_path_start[body]; z < octo_cost_path_start[body + 1]; ++z) {
        int j = octo_cost_path[z];
        const double *xi = kin[node] + 12 * NB + 6 * j, *g = d + 6 * node;
        out[node * NX + j] = scale[row] * (g[0] * xi[0] + g[1] * xi[1] + g[2] * xi[2] + g[3] * xi[3] + g[4] * xi[4] + g[5] * xi[5]);
      }
  }
#endif
}

/* hess (W3, LD) += rowsᵀ rows; gradient (LD) = rowsᵀ values. */
static void octo_gauss_newton(const octo_rows *rows, double *hess, double *gradient) {
  v8 acc[LD / 8];
  for (int j = 0; j < LD / 8; ++j) acc[j] = (v8){0};
  for (int r = 0; r < rows->count; ++r) {
    const v8 *row = (const v8 *)rows->row[r];
    for (int j = 0; j < LD / 8; ++j) acc[j] += rows->value[r] * row[j];
  }
  for (int j = 0; j < LD / 8; ++j) ((v8 *)gradient)[j] = acc[j];
  for (int i = 0; i < W3; ++i) {
    v8 *out = (v8 *)(hess + i * LD);
    for (int j = 0; j < LD / 8; ++j) acc[j] = out[j];
    for (int r = 0; r < rows->count; ++r) {
      double f = rows->row[r][i];
      if (f == 0.0) continue;
      const v8 *row = (const v8 *)rows->row[r];
      for (int j = 0; j < LD / 8; ++j) acc[j] += f * row[j];
    }
    for (int j = 0; j < LD / 8; ++j) out[j] = acc[j];
  }
}

typedef struct { double *h, *a, *b, *c, *halo_h, *halo_a, *halo_b, *halo_c; int unit, row, nc, ma; } octo_target;

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

static void octo_scatter(const octo_task *t, const octo_target *g, int i, const double *row_scale, const double *hess, const double *gradient, const double *fd, const double *jac) {
  for (int node_a = 0; node_a < 3; ++node_a) {
    size_t at_a = (size_t)(i + 2 - node_a) * t->slots;
    for (int sa = 0; sa < t->slots; ++sa) {
      int unit_a = t->slot_unit[at_a + sa];
      if (unit_a < 0) continue;
      double value_a = t->slot_value[at_a + sa];
      int offset_a = t->slot_part[at_a + sa] * NX;
      double *b = octo_b(g, unit_a) + offset_a, *h = octo_h(g, unit_a);
      for (int j = 0; j < NX; ++j) b[j] += value_a * gradient[node_a * NX + j];
      for (int node_b = 0; node_b < 3; ++node_b) {
        size_t at_b = (size_t)(i + 2 - node_b) * t->slots;
        for (int sb = 0; sb < t->slots; ++sb) {
          int unit_b = t->slot_unit[at_b + sb];
          if (unit_b < 0 || unit_b > unit_a) continue;
          double value = value_a * t->slot_value[at_b + sb];
          double *out = h + ((size_t)(unit_a - unit_b) * g->nc + offset_a) * g->nc + t->slot_part[at_b + sb] * NX;
          const double *in = hess + node_a * NX * LD + node_b * NX;
          for (int r = 0; r < NX; ++r)
            for (int j = 0; j < NX; ++j) out[r * g->nc + j] += value * in[r * LD + j];
        }
      }
    }
  }
#if MU > 0
  for (int k = 0; k < t->tests; ++k) {
    int row = t->test_row[i * t->tests + k];
    if (row < 0) continue;
    double test = t->test_value[i * t->tests + k];
    int offset = t->test_part[i * t->tests + k] * MU;
    double *c = octo_c(g, row) + offset, *a = octo_a(g, row);
    for (int r = 0; r < MU; ++r) c[r] += test * row_scale[r] * fd[octo_unactuated[r]];
    for (int node = 0; node < 3; ++node) {
      size_t at = (size_t)(i + 2 - node) * t->slots;
      for (int s = 0; s < t->slots; ++s) {
        int unit = t->slot_unit[at + s];
        if (unit < 0) continue;
        double value = test * t->slot_value[at + s];
        double *out = a + ((size_t)(row - unit) * g->ma + offset) * g->nc + t->slot_part[at + s] * NX;
        for (int r = 0; r < MU; ++r) {
          double f = value * row_scale[r];
          const double *in = jac + octo_unactuated[r] * W3 + node * NX;
          for (int j = 0; j < NX; ++j) out[r * g->nc + j] += f * in[j];
        }
      }
    }
  }
#endif
}

typedef struct {
  double hess[W3 * LD] __attribute__((aligned(64))), gradient[LD] __attribute__((aligned(64)));
  double kin[3][KIN + 1], work[WORK + 1], w[COST_W + 1], u[NU + 1], lam[NX], fd[NX], jac[NX * W3], curvature[W3 * W3];
  long long iw[COST_IW + 1];
  octo_cost_values values;
  octo_rows rows;
} octo_scratch;

static void octo_linearize_step(const octo_task *t, const octo_target *g, octo_scratch *s, int member, int i) {
  const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX, *p = t->p + (size_t)member * NP;
  const double *x_prev = nodes + i * NX, *x = x_prev + NX, *x_next = x + NX;
  const double *q = t->q + ((size_t)member * t->steps + i) * NQ, *fd = t->fd + ((size_t)member * t->steps + i) * NX;
  const double *row_scale = t->row_scale + (size_t)member * MU;
  const double *kin[3] = {s->kin[(i + 2) % 3], s->kin[(i + 1) % 3], s->kin[i % 3]};
  octo_kin(x_next, s->kin[(i + 2) % 3]);
  for (int j = 0; j < NU; ++j) s->u[j] = fd[octo_actuated[j]];
  octo_cost_derivatives(x_next, x, x_prev, s->u, kin, p, q, &s->values, s->lam, s->w, s->iw);
  if (t->lam) {
    const double *lam = t->lam + (size_t)member * t->units * g->ma;
    for (int k = 0; k < t->tests; ++k) {
      int row = t->test_row[i * t->tests + k];
      if (row < 0) continue;
      double value = t->test_value[i * t->tests + k];
      for (int r = 0; r < MU; ++r)
        s->lam[octo_unactuated[r]] += value * row_scale[r] * lam[row * g->ma + t->test_part[i * t->tests + k] * MU + r];
    }
    octo_step(x_next, x, x_prev, kin[0], kin[1], kin[2], p, s->lam, 2, s->fd, s->jac, s->curvature, s->work);
    for (int r = 0; r < W3; ++r) memcpy(s->hess + r * LD, s->curvature + r * W3, W3 * sizeof(double));
  } else {
    octo_step(x_next, x, x_prev, kin[0], kin[1], kin[2], p, 0, 1, s->fd, s->jac, 0, s->work);
    memset(s->hess, 0, sizeof(s->hess));
  }
  octo_build_rows(&s->values, s->jac, kin, q, &s->rows);
  octo_gauss_newton(&s->rows, s->hess, s->gradient);
  octo_scatter(t, g, i, row_scale, s->hess, s->gradient, fd, s->jac);
}

static void octo_add_halo(const octo_task *t, int member) {
  int nc = t->parts * NX, ma = t->parts * MU;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc;
  for (int chunk = 1; chunk < t->chunks; ++chunk) {
    const double *halo = t->halo + ((size_t)member * t->chunks + chunk) * octo_halo_size(t);
    for (int k = 0; k < 2; ++k) {
      int unit = t->chunk_unit[chunk] - 2 + k;
      if (unit < 0) continue;
      double *h = t->h + ((size_t)member * t->units + unit) * hs, *b = t->b + ((size_t)member * t->units + unit) * nc;
      for (size_t j = 0; j < hs; ++j) h[j] += halo[k * hs + j];
      for (int j = 0; j < nc; ++j) b[j] += halo[2 * hs + as + k * nc + j];
    }
    int row = t->chunk_row[chunk] - 1;
    if (row < 0) continue;
    double *a = t->a + ((size_t)member * t->units + row) * as, *c = t->c + ((size_t)member * t->units + row) * ma;
    for (size_t j = 0; j < as; ++j) a[j] += halo[2 * hs + j];
    for (int j = 0; j < ma; ++j) c[j] += halo[2 * hs + as + 2 * nc + j];
  }
}

int octo_linearize(const octo_task *t, int threads) {
  int items = t->batch * t->chunks, failed = 0;
  int nc = t->parts * NX, ma = t->parts * MU;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc, halo_size = octo_halo_size(t);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
  for (int item = 0; item < items; ++item) {
    int member = item / t->chunks, chunk = item % t->chunks;
    size_t unit0 = (size_t)member * t->units;
    octo_scratch *s = aligned_alloc(64, (sizeof(octo_scratch) + 63) / 64 * 64);
    if (!s) { failed = 1; continue; }
    double *halo = t->halo + ((size_t)member * t->chunks + chunk) * halo_size;
    octo_target g = {t->h + unit0 * hs, t->a + unit0 * as, t->b + unit0 * nc, t->c + unit0 * ma,
                     halo, halo + 2 * hs, halo + 2 * hs + as, halo + 2 * hs + as + 2 * nc,
                     t->chunk_unit[chunk], t->chunk_row[chunk], nc, ma};
    int unit_last = chunk + 1 < t->chunks ? t->chunk_unit[chunk + 1] : t->units, row_last = chunk + 1 < t->chunks ? t->chunk_row[chunk + 1] : t->units;
    memset(halo, 0, halo_size * sizeof(double));
    memset(g.h + g.unit * hs, 0, (unit_last - g.unit) * hs * sizeof(double));
    memset(g.b + g.unit * nc, 0, (size_t)(unit_last - g.unit) * nc * sizeof(double));
    memset(g.a + g.row * as, 0, (row_last - g.row) * as * sizeof(double));
    memset(g.c + g.row * ma, 0, (size_t)(row_last - g.row) * ma * sizeof(double));
    int first = t->chunk_step[chunk], last = t->chunk_step[chunk + 1];
    const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX;
    octo_kin(nodes + first * NX, s->kin[first % 3]);
    octo_kin(nodes + (first + 1) * NX, s->kin[(first + 1) % 3]);
    for (int i = first; i < last; ++i) octo_linearize_step(t, &g, s, member, i);
    free(s);
  }
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
  for (int member = 0; member < t->batch; ++member) octo_add_halo(t, member);
  return failed;
}
