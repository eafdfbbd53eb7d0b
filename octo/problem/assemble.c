/* E, C and their model (Eq. 9) over all time steps, appended to the text of the dynamics, of the costs and of scatter.c.
 *
 * The generated text before this one defines: NX NU MU KIN NP CURVATURE and octo_lanes_* (the dynamics, lanes_group.c);
 * NQ NTERM NR NZ CR NFC and the tables and functions of the costs (problem/codegen.py).
 * A step's rows (residuals scaled by the root of twice their coefficient) are stacked, so that the Gauss-Newton block
 * is rowsᵀ rows; to it comes the curvature of lambdaᵀFD. The dynamics go STEPS steps at a time, all else step by step. */

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

/* Steps first … last of a member, STEPS at a time, and the kinematics of their nodes one by one for costs over contacts. */
typedef struct {
  octo_lanes lanes;
  double kin[STEPS + 2][NFC > 0 ? KIN : 1]; /* of the previous node of the first step, and the nodes after it */
} octo_group;

static void octo_group_begin(octo_group *g, const octo_task *t, int member, int first, int last) {
  octo_lanes_clear(&g->lanes);
  octo_lanes_begin(&g->lanes, t->nodes + (size_t)member * (t->steps + 2) * NX, first, last + 1);
}

static octo_input octo_group_turn(octo_group *g, const double *p, int order) {
  octo_input in = octo_lanes_turn(&g->lanes, p, order);
#if NFC > 0
  double *previous[STEPS], *next[STEPS];
  for (int k = 0; k < STEPS; ++k) { previous[k] = g->kin[k]; next[k] = g->kin[k + 2]; }
  octo_spread(in.kin[2], KIN, previous, STEPS < 2 ? STEPS : 2);
  octo_spread(in.kin[0], KIN, next, STEPS);
#endif
  return in;
}

static int octo_group_count(int i, int last) { return last - i < STEPS ? last - i : STEPS; }

static void octo_evaluate_step(const octo_task *t, int member, int i, const double (*kin)[NFC > 0 ? KIN : 1]) {
  double w[COST_W + 1], r[MROWS + 1], u[NU + 1]; long long iw[COST_IW + 1];
  const double *x_prev = t->nodes + ((size_t)member * (t->steps + 2) + i) * NX, *p = t->p + (size_t)member * NP;
  const double *q = t->q + ((size_t)member * t->steps + i) * NQ, *fd = t->fd + ((size_t)member * t->steps + i) * NX;
  double *terms = t->terms + ((size_t)member * t->steps + i) * NTERM;
  for (int j = 0; j < NU; ++j) u[j] = fd[octo_actuated[j]];
  octo_residuals(x_prev + 2 * NX, x_prev + NX, x_prev, u, kin[2], kin[1], kin[0], p, q, r, w, iw);
  for (int k = 0; k < NTERM; ++k) terms[k] = 0.0;
  for (int row = 0; row < MROWS; ++row) {
    double c = octo_coefficient(q, row);
    if (c != 0.0) terms[octo_row_term(row)] += c * r[row] * r[row];
  }
}

typedef struct { const octo_task *task; int failed; } octo_sweep;

static void octo_evaluate_chunk(void *shared, int item) {
  octo_sweep *sweep = shared;
  const octo_task *t = sweep->task;
  int member = item / t->chunks, first = t->chunk_step[item % t->chunks], last = t->chunk_step[item % t->chunks + 1];
  octo_group *g = aligned_alloc(64, (sizeof(octo_group) + 63) / 64 * 64);
  if (!g) { sweep->failed = 1; return; }
  octo_group_begin(g, t, member, first, last);
  for (int i = first; i < last; i += STEPS) {
    int count = octo_group_count(i, last);
    double *fd[STEPS];
    octo_input in = octo_group_turn(g, t->p + (size_t)member * NP, 0);
    octo_lanes_run(&g->lanes, &in);
    for (int k = 0; k < count; ++k) fd[k] = t->fd + ((size_t)member * t->steps + i + k) * NX;
    octo_spread(g->lanes.fd, NX, fd, count);
    for (int k = 0; k < count; ++k) octo_evaluate_step(t, member, i + k, (const void *)(g->kin + k));
  }
  free(g);
}

int octo_evaluate(octo_task *t, int threads) {
  octo_sweep sweep = {t, 0};
  octo_share(octo_evaluate_chunk, &sweep, t->batch * t->chunks, threads);
  for (int member = 0; member < t->batch; ++member) octo_reduce(t, member);
  return sweep.failed;
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
  octo_group group;
  double hess[(W3 + 1) * LD] __attribute__((aligned(64))), gradient[LD] __attribute__((aligned(64)));
  double jac[STEPS][(NX * W3 + 7) / 8 * 8] __attribute__((aligned(64)));
  double curvature[STEPS][((CURVATURE * NX + 1) * NX + 15) / 8 * 8] __attribute__((aligned(64)));
  double w[COST_W + 1], u[NU + 1], lam[STEPS][NX];
  long long iw[COST_IW + 1];
  octo_cost_values values[STEPS];
  octo_rows rows;
  octo_places places;
  int zeros; /* what jac and curvature hold where a group writes nothing: 0 zeros, 1 what pairs wrote before, 2 anything */
} octo_scratch;

/* Costs of step i, and lam (NX): the multipliers of its FD, ∂E/∂u on the rows of torques. */
static void octo_derive_costs(const octo_task *t, octo_scratch *s, int ma, int member, int i, int k) {
  const double *x_prev = t->nodes + ((size_t)member * (t->steps + 2) + i) * NX, *p = t->p + (size_t)member * NP;
  const double *q = t->q + ((size_t)member * t->steps + i) * NQ, *fd = t->fd + ((size_t)member * t->steps + i) * NX;
  const double *kin[3] = {s->group.kin[k + 2], s->group.kin[k + 1], s->group.kin[k]};
  double *lam = s->lam[k];
  for (int j = 0; j < NU; ++j) s->u[j] = fd[octo_actuated[j]];
  octo_cost_derivatives(x_prev + 2 * NX, x_prev + NX, x_prev, s->u, kin, p, q, &s->values[k], lam, s->w, s->iw);
  if (!t->lam) return;
  const double *multipliers = t->lam + (size_t)member * t->units * ma, *row_scale = t->row_scale + (size_t)member * MU;
  for (int test = i * t->tests; test < (i + 1) * t->tests; ++test) {
    if (t->test_row[test] < 0) continue;
    const double *rows = multipliers + t->test_row[test] * ma + t->test_part[test] * MU;
    for (int r = 0; r < MU; ++r) lam[octo_unactuated[r]] += t->test_value[test] * row_scale[r] * rows[r];
  }
}

/* jac and curvature of ``count`` steps from i on. */
static void octo_derive_group(const octo_task *t, octo_scratch *s, int ma, int member, int i, int count) {
  octo_lanes *lanes = &s->group.lanes;
  const double *lam[STEPS];
  double *fd[STEPS], *jac[STEPS], *curvature[STEPS];
  octo_input in = octo_group_turn(&s->group, t->p + (size_t)member * NP, t->lam ? 2 : 1);
  for (int k = 0; k < count; ++k) fd[k] = t->fd + ((size_t)member * t->steps + i + k) * NX;
  if (!t->lam) octo_lanes_run(lanes, &in);
  if (!t->lam && !t->terms) octo_spread(lanes->fd, NX, fd, count);
  for (int k = 0; k < STEPS; ++k) {
    if (k < count) octo_derive_costs(t, s, ma, member, i + k, k);
    lam[k] = s->lam[k < count ? k : 0];
    jac[k] = s->jac[k];
    curvature[k] = s->curvature[k];
  }
  if (t->lam) {
    octo_gather(lam, NX, lanes->lam);
    octo_lanes_run(lanes, &in);
  }
  int kept = s->zeros > lanes->touching ? s->zeros : lanes->touching;
  octo_scatter(lanes->jac, octo_jac_slot, NX * W3, octo_jac_use, lanes->touching, kept, jac, STEPS);
  if (t->lam) octo_scatter(lanes->hess, octo_hess_slot, CURVATURE * NX * NX, octo_hess_use, lanes->touching, kept, curvature, STEPS);
  s->zeros = lanes->touching;
}

static void octo_linearize_step(const octo_task *t, octo_target *g, octo_scratch *s, int member, int i, int k) {
  const double *q = t->q + ((size_t)member * t->steps + i) * NQ, *fd = t->fd + ((size_t)member * t->steps + i) * NX;
  const double *kin[3] = {s->group.kin[k + 2], s->group.kin[k + 1], s->group.kin[k]};
  octo_build_rows(&s->values[k], s->jac[k], kin, q, &s->rows);
  octo_gauss_newton(&s->rows, t->lam ? s->curvature[k] : 0, t->slots == 1, s->hess, s->gradient);
  octo_find_places(t, i, &s->places);
  int units = g->clear_unit, rows = g->clear_row;
  for (int l = 0; l < s->places.count; ++l) units = s->places.unit[l] >= units ? s->places.unit[l] + 1 : units;
  for (int test = i * t->tests; test < (i + 1) * t->tests; ++test) rows = t->test_row[test] >= rows ? t->test_row[test] + 1 : rows;
  int fresh = t->slots == 1 && s->places.count == 3 && units > g->clear_unit;
  octo_clear(g, units, rows, fresh);
  if (t->slots == 1) octo_scatter_nodes(g, &s->places, fresh, s->hess, s->gradient);
  else octo_scatter_model(g, &s->places, s->hess, s->gradient);
  octo_scatter_constraints(t, g, &s->places, i, t->row_scale + (size_t)member * MU, fd, s->jac[k]);
}

static void octo_linearize_chunk(void *shared, int item) {
  octo_sweep *sweep = shared;
  const octo_task *t = sweep->task;
  int nc = t->parts * NX, ma = t->parts * MU;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc, halo_size = octo_halo_size(t);
  int member = item / t->chunks, chunk = item % t->chunks;
  size_t unit0 = (size_t)member * t->units;
  octo_scratch *s = aligned_alloc(64, (sizeof(octo_scratch) + 63) / 64 * 64);
  if (!s) { sweep->failed = 1; return; }
  double *halo = t->halo + ((size_t)member * t->chunks + chunk) * halo_size;
  octo_target g = {t->h + unit0 * hs, t->a + unit0 * as, t->b + unit0 * nc, t->c + unit0 * ma,
                   halo, halo + 2 * hs, halo + 2 * hs + as, halo + 2 * hs + as + 2 * nc,
                   t->chunk_unit[chunk], t->chunk_row[chunk], nc, ma, t->chunk_unit[chunk], t->chunk_row[chunk]};
  int unit_last = chunk + 1 < t->chunks ? t->chunk_unit[chunk + 1] : t->units, row_last = chunk + 1 < t->chunks ? t->chunk_row[chunk + 1] : t->units;
  memset(halo, 0, halo_size * sizeof(double));
  int first = t->chunk_step[chunk], last = t->chunk_step[chunk + 1];
  octo_group_begin(&s->group, t, member, first, last);
  s->zeros = 2;
  for (int i = first; i < last; i += STEPS) {
    int count = octo_group_count(i, last);
    octo_derive_group(t, s, ma, member, i, count);
    for (int k = 0; k < count; ++k) octo_linearize_step(t, &g, s, member, i + k, k);
  }
  octo_clear(&g, unit_last, row_last, 0); /* what no step touched */
  free(s);
}

static void octo_add_halo_of(void *shared, int member) { octo_add_halo(shared, member); }

int octo_linearize(octo_task *t, int threads) {
  octo_sweep sweep = {t, 0};
  octo_share(octo_linearize_chunk, &sweep, t->batch * t->chunks, threads);
  octo_share(octo_add_halo_of, t, t->batch, t->chunks > 1 ? threads : 1);
  return sweep.failed;
}

/* One chunk of a single problem, for a caller that has some steps' numbers before those of the others. */
int octo_linearize_part(octo_task *t, int chunk) {
  octo_sweep sweep = {t, 0};
  octo_linearize_chunk(&sweep, chunk);
  return sweep.failed;
}

void octo_join_parts(octo_task *t) { octo_add_halo(t, 0); }
