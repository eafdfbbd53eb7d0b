/* E, C and their model (Eq. 9) over all time steps, appended to the text of the dynamics, of the costs and of scatter.c.
 *
 * The generated text before this one defines: NX NU MU KIN NP WORK octo_kin octo_step (the dynamics);
 * NQ NTERM NR NZ CR NFC and the tables and functions of the costs (problem/codegen.py).
 * A step's rows (residuals scaled by the root of twice their coefficient) are stacked, so that the Gauss-Newton block
 * is rowsᵀ rows; the curvature of lambdaᵀFD is added by octo_step. */

#define MROWS (NR + NFC * CR)
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

static void octo_evaluate_chunk(void *shared, int item) {
  const octo_task *t = shared;
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

void octo_evaluate(octo_task *t, int threads) {
  octo_share(octo_evaluate_chunk, t, t->batch * t->chunks, threads);
  for (int member = 0; member < t->batch; ++member) octo_reduce(t, member);
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
    if (q[octo_state_row_term[row]] == 0.0) continue; /* a step that a term leaves out may have no finite residual */
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

/* Columns 8j … 8j+7 of row r of a node's row of blocks of the curvature (HESS in phases.c), from its diagonal block on. */
static inline __attribute__((always_inline)) v8 octo_curved(const double *curvature, const int node, int r, int j) {
  v8 line = {0};
  for (int other = node; other < 3; ++other) {
    int block = node == 0 ? other : node == other ? 2 + node : 5, column = 8 * j - other * NX;
    if (block >= CURVATURE || column <= -8 || column >= NX) continue;
    v8_integers at = column + (v8_integers){0, 1, 2, 3, 4, 5, 6, 7};
    v8 part = *(const v8_anywhere *)(curvature + (block * NX + r) * NX + column);
    line = (v8)((v8_integers)line | ((v8_integers)part & (at >= 0) & (at < NX)));
  }
  return line;
}

/* A node's rows of hess = curvature (or 0) + rowsᵀ rows, from its diagonal block on and two at a time; what stands left of
 * that block is written with other numbers, and so may be one row more. */
static inline __attribute__((always_inline)) void octo_square(const octo_rows *rows, const double *curvature, const int node, double *hess) {
  const int first = node * NX / 8; /* a constant: the sums stay in registers */
  for (int r = 0; r < NX; r += 2) {
    int i = node * NX + r;
    v8 one[LD / 8], two[LD / 8];
    for (int j = first; j < LD / 8; ++j) {
      one[j] = curvature ? octo_curved(curvature, node, r, j) : (v8){0};
      two[j] = curvature ? octo_curved(curvature, node, r + 1, j) : (v8){0};
    }
    for (int k = 0; k < rows->count; ++k) {
      const double *row = rows->row[k], f = row[i], g = row[i + 1];
      if (!((f != 0.0) | (g != 0.0))) continue;
      for (int j = first; j < LD / 8; ++j) {
        v8 line = *(const v8 *)(row + 8 * j);
        one[j] += f * line;
        two[j] += g * line;
      }
    }
    for (int j = first; j < LD / 8; ++j) {
      *(v8 *)(hess + i * LD + 8 * j) = one[j];
      *(v8 *)(hess + (i + 1) * LD + 8 * j) = two[j];
    }
  }
}

/* hess (W3, LD) and gradient (LD) = rowsᵀ values; with ``half`` nothing of use stands left of the nodes' diagonal blocks. */
static void octo_gauss_newton(const octo_rows *rows, const double *curvature, int half, double *hess, double *gradient) {
  v8 sum[LD / 8];
  for (int j = 0; j < LD / 8; ++j) sum[j] = (v8){0};
  for (int r = 0; r < rows->count; ++r)
    for (int j = 0; j < LD / 8; ++j) sum[j] += rows->value[r] * *(const v8 *)(rows->row[r] + 8 * j);
  for (int j = 0; j < LD / 8; ++j) ((v8 *)gradient)[j] = sum[j];
  octo_square(rows, curvature, 0, hess);
  octo_square(rows, curvature, 1, hess);
  octo_square(rows, curvature, 2, hess);
  if (half) return;
  for (int node = 1; node < 3; ++node)
    for (int i = 0; i < node * NX; ++i)
      for (int j = node * NX; j < (node + 1) * NX; ++j) hess[j * LD + i] = hess[i * LD + j];
}

typedef struct {
  double hess[(W3 + 1) * LD] __attribute__((aligned(64))), gradient[LD] __attribute__((aligned(64)));
  double kin[3][KIN + 1], work[WORK + 1], w[COST_W + 1], u[NU + 1], lam[NX], fd[NX], jac[NX * W3], curvature[(CURVATURE * NX + 1) * NX + 8];
  long long iw[COST_IW + 1];
  octo_cost_values values;
  octo_rows rows;
  octo_places places;
} octo_scratch;

static void octo_linearize_step(const octo_task *t, octo_target *g, octo_scratch *s, int member, int i) {
  const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX, *p = t->p + (size_t)member * NP;
  const double *x_prev = nodes + i * NX, *x = x_prev + NX, *x_next = x + NX;
  const double *q = t->q + ((size_t)member * t->steps + i) * NQ, *fd = t->fd + ((size_t)member * t->steps + i) * NX;
  const double *row_scale = t->row_scale + (size_t)member * MU;
  const double *kin[3] = {s->kin[(i + 2) % 3], s->kin[(i + 1) % 3], s->kin[i % 3]};
  octo_kin(x_next, s->kin[(i + 2) % 3]);
  if (!t->lam) octo_step(x_next, x, x_prev, kin[0], kin[1], kin[2], p, 0, 1, s->fd, s->jac, 0, s->work);
  if (!t->lam && !t->terms) memcpy(t->fd + ((size_t)member * t->steps + i) * NX, s->fd, NX * sizeof(double));
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
  }
  octo_build_rows(&s->values, s->jac, kin, q, &s->rows);
  octo_gauss_newton(&s->rows, t->lam ? s->curvature : 0, t->slots == 1, s->hess, s->gradient);
  octo_find_places(t, i, &s->places);
  int units = g->clear_unit, rows = g->clear_row;
  for (int l = 0; l < s->places.count; ++l) units = s->places.unit[l] >= units ? s->places.unit[l] + 1 : units;
  for (int k = i * t->tests; k < (i + 1) * t->tests; ++k) rows = t->test_row[k] >= rows ? t->test_row[k] + 1 : rows;
  int fresh = t->slots == 1 && s->places.count == 3 && units > g->clear_unit;
  octo_clear(g, units, rows, fresh);
  if (t->slots == 1) octo_scatter_nodes(g, &s->places, fresh, s->hess, s->gradient);
  else octo_scatter_model(g, &s->places, s->hess, s->gradient);
  octo_scatter_constraints(t, g, &s->places, i, row_scale, fd, s->jac);
}

typedef struct { const octo_task *task; int failed; } octo_linearization;

static void octo_linearize_chunk(void *shared, int item) {
  octo_linearization *l = shared;
  const octo_task *t = l->task;
  int nc = t->parts * NX, ma = t->parts * MU;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc, halo_size = octo_halo_size(t);
  int member = item / t->chunks, chunk = item % t->chunks;
  size_t unit0 = (size_t)member * t->units;
  octo_scratch *s = aligned_alloc(64, (sizeof(octo_scratch) + 63) / 64 * 64);
  if (!s) { l->failed = 1; return; }
  double *halo = t->halo + ((size_t)member * t->chunks + chunk) * halo_size;
  octo_target g = {t->h + unit0 * hs, t->a + unit0 * as, t->b + unit0 * nc, t->c + unit0 * ma,
                   halo, halo + 2 * hs, halo + 2 * hs + as, halo + 2 * hs + as + 2 * nc,
                   t->chunk_unit[chunk], t->chunk_row[chunk], nc, ma, t->chunk_unit[chunk], t->chunk_row[chunk]};
  int unit_last = chunk + 1 < t->chunks ? t->chunk_unit[chunk + 1] : t->units, row_last = chunk + 1 < t->chunks ? t->chunk_row[chunk + 1] : t->units;
  memset(halo, 0, halo_size * sizeof(double));
  int first = t->chunk_step[chunk], last = t->chunk_step[chunk + 1];
  const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX;
  octo_kin(nodes + first * NX, s->kin[first % 3]);
  octo_kin(nodes + (first + 1) * NX, s->kin[(first + 1) % 3]);
  for (int i = first; i < last; ++i) octo_linearize_step(t, &g, s, member, i);
  octo_clear(&g, unit_last, row_last, 0); /* what no step touched */
  free(s);
}

static void octo_add_halo_of(void *shared, int member) { octo_add_halo(shared, member); }

int octo_linearize(octo_task *t, int threads) {
  octo_linearization l = {t, 0};
  octo_share(octo_linearize_chunk, &l, t->batch * t->chunks, threads);
  octo_share(octo_add_halo_of, t, t->batch, t->chunks > 1 ? threads : 1);
  return l.failed;
}

/* One chunk of a single problem, for a caller that has some steps' numbers before those of the others. */
int octo_linearize_part(octo_task *t, int chunk) {
  octo_linearization l = {t, 0};
  octo_linearize_chunk(&l, chunk);
  return l.failed;
}

void octo_join_parts(octo_task *t) { octo_add_halo(t, 0); }
