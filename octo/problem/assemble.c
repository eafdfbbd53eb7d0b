/* E, C and their model (Eq. 9) over all time steps, appended to the text of the dynamics, of the costs and of scatter.c,
 * sparse_rows.c and contacts.c.
 *
 * The generated text before this one defines: NX NU MU KIN NP CURVATURE and octo_lanes_* (the dynamics, lanes_group.c);
 * NQ NTERM NR NZ CR NFC and the tables and functions of the costs (problem/codegen.py).
 * A step's block is rowsᵀ rows of its rows over the state (sparse_rows.c); to it comes the curvature of lambdaᵀFD, of the terms
 * over contacts (contacts.c) and of exact ones over the state (curvature.c). Dynamics and costs go STEPS steps at a time, all else
 * step by step. */

/* Steps first … last of a member, STEPS at a time: dynamics and costs, unscaled, in the lanes of vectors. */
typedef struct {
  octo_lanes lanes;
  real q[NQ], u[NU + 1], r[NR + 1], slopes[NZ + 1];
#if NFC > 0
  octo_rests rests;
#endif
#if NS > 0
  real second[NS];
#endif
} octo_group;

static void octo_group_begin(octo_group *g, const octo_task *t, int member, int first, int last) {
  octo_lanes_clear(&g->lanes);
  if (t->apart) octo_lanes_begin_apart(&g->lanes, t->nodes + (size_t)member * t->steps * 3 * NX, first, last - 1);
  else octo_lanes_begin(&g->lanes, t->nodes + (size_t)member * (t->steps + 2) * NX, first, last + 1);
#if NFC > 0
  octo_rests_begin(&g->rests, t->apart);
#endif
}

static void octo_group_arguments(octo_group *g, const octo_task *t, int member, int i, int count) {
  const double *q[STEPS];
  for (int k = 0; k < STEPS; ++k) q[k] = t->q + ((size_t)member * t->steps + i + (k < count ? k : 0)) * NQ;
  octo_gather(q, NQ, g->q);
  for (int j = 0; j < NU; ++j) g->u[j] = g->lanes.fd[octo_actuated[j]];
}

/* Residuals r over the state, with ``derive`` their slopes too; the lanes have their FD. */
static void octo_group_states(octo_group *g, const octo_input *in, int derive) {
#if NR > 0
  const void *state[6] = {in->x[0], in->x[1], in->x[2], g->u, in->p, g->q};
  real *made[2] = {g->r, g->slopes};
  if (derive) octo_state_cost_jac(state, made);
  else octo_state_cost(state, made);
#endif
}

#if NS > 0
/* Second derivatives of the terms over the state. */
static void octo_group_second(octo_group *g, const octo_input *in, double (*second)[NS]) {
  const void *state[6] = {in->x[0], in->x[1], in->x[2], g->u, in->p, g->q};
  real *made[1] = {g->second};
  double *steps[STEPS];
  octo_state_curvature(state, made);
  for (int k = 0; k < STEPS; ++k) steps[k] = second[k];
  octo_spread(g->second, NS, steps, STEPS);
}
#endif

static int octo_group_count(int i, int last) { return last - i < STEPS ? last - i : STEPS; }

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
    size_t step = (size_t)member * t->steps + i;
    real shares[NTERM + 1];
    double *fd[STEPS], *terms[STEPS];
    octo_input in = octo_lanes_turn(&g->lanes, t->p + (size_t)member * NP, 0);
    octo_lanes_run(&g->lanes, &in);
    octo_group_arguments(g, t, member, i, count);
    octo_group_states(g, &in, 0);
    octo_sum_rows(g->q, g->r, shares);
#if NFC > 0
    octo_sum_contacts(&g->rests, &g->lanes.work, &in, g->q, shares);
#endif
    for (int k = 0; k < count; ++k) { fd[k] = t->fd + (step + k) * NX; terms[k] = t->terms + (step + k) * NTERM; }
    octo_spread(g->lanes.fd, NX, fd, count);
    octo_spread(shares, NTERM, terms, count);
#if NBOUNDED > 0
    double *bounded[STEPS];
    for (int k = 0; k < count; ++k) bounded[k] = t->rows + (step + k) * NBOUNDED;
    if (t->rows) octo_spread(g->r + SQUARES, NBOUNDED, bounded, count);
#endif
  }
  free(g);
}

int octo_evaluate(octo_task *t, int threads) {
  octo_sweep sweep = {t, 0};
  octo_parallel_for(octo_evaluate_chunk, &sweep, t->batch * t->chunks, threads);
#ifdef PAIR_ROWS
  sweep.failed |= octo_pair_terms(t, threads, 0);
#endif
  for (int member = 0; member < t->batch; ++member) octo_reduce(t, member);
  return sweep.failed;
}

/* What of the curvature (HESS in phases.c) stands in the rows of hess (W3, LD), from the nodes' diagonal blocks on. */
static octo_slot octo_line_slot[W3 * LD];
static char octo_line_use[W3 * LD / STEPS];

__attribute__((constructor)) static void octo_find_lines(void) {
  static const int block[3][3] = {{0, 1, 2}, {0, 3, 5}, {0, 0, 4}};
  for (int node = 0; node < 3; ++node)
    for (int other = node; other < 3; ++other)
      for (int e = 0; e < NX * NX && block[node][other] < (NFC > 0 ? 6 : CURVATURE); ++e)
        octo_line_slot[(node * NX + e / NX) * LD + other * NX + e % NX] = octo_hess_slot[block[node][other] * NX * NX + e];
  octo_find_use(octo_line_slot, W3 * LD, HESS_SLOTS - NCOUPLED, octo_line_use);
}

/* A node's rows of hess = curvature (or 0) + rowsᵀ rows, from its diagonal block on and two at a time; what stands left of
 * that block is written with other numbers, and so may be one row more. */
static inline __attribute__((always_inline)) void octo_square(const octo_rows *rows, const double *curvature, const int node, double *hess) {
  const int first = node * NX / 8; /* a constant: the sums stay in registers */
  for (int r = 0; r < NX; r += 2) {
    int i = node * NX + r;
    v8 one[LD / 8], two[LD / 8];
    for (int j = first; j < LD / 8; ++j) {
      one[j] = curvature ? *(const v8 *)(curvature + i * LD + 8 * j) : (v8){0};
      two[j] = curvature ? *(const v8 *)(curvature + (i + 1) * LD + 8 * j) : (v8){0};
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

/* hess (W3, LD), or 0, and gradient (LD) = rowsᵀ values, to which ``slope`` (LD) is added, or 0; nothing of use stands left of the
 * nodes' diagonal blocks. */
static void octo_gauss_newton(const octo_rows *rows, const octo_step_sums *sums, const double *curvature, const double *slope,
                              double *hess, double *gradient) {
  v8 sum[LD / 8];
  for (int j = 0; j < LD / 8; ++j) sum[j] = slope ? ((const v8 *)slope)[j] : (v8){0};
  for (int r = 0; r < rows->count; ++r)
    for (int j = 0; j < LD / 8; ++j) sum[j] += rows->value[r] * *(const v8 *)(rows->row[r] + 8 * j);
  for (int j = 0; j < LD / 8; ++j) ((v8 *)gradient)[j] = sum[j];
  if (!hess) return;
  octo_square(rows, curvature, 0, hess);
  octo_square(rows, curvature, 1, hess);
  octo_square(rows, curvature, 2, hess);
  octo_add_squares(sums, hess);
}

/* What stands left of the nodes' diagonal blocks. */
static void octo_mirror(double *hess) {
  for (int node = 1; node < 3; ++node)
    for (int i = 0; i < node * NX; ++i)
      for (int j = node * NX; j < (node + 1) * NX; ++j) hess[j * LD + i] = hess[i * LD + j];
}

typedef struct {
  octo_group group;
  double hess[(W3 + 1) * LD] __attribute__((aligned(64))), gradient[LD] __attribute__((aligned(64)));
  double jac[STEPS][(NX * W3 + 7) / 8 * 8] __attribute__((aligned(64)));
  double curvature[STEPS][(W3 + 1) * LD] __attribute__((aligned(64)));
  double lam[STEPS][NX];
#if NFC > 0
  octo_touched touched;
#endif
#if SLOPED
  double slope[STEPS][LD] __attribute__((aligned(64))); /* of E but for the rows written out */
#endif
#if NS > 0
  double second[STEPS][NS]; /* of terms over the state */
#endif
  octo_row_sums sums;
  real pull[NU + 1], gradient_sum[W3]; /* ∂E/∂u; of E but for the rows written out */
  octo_step_sums step_sums[STEPS];
  octo_rows rows;
  octo_places places;
  int zeros; /* what jac and curvature hold where a group writes nothing: 0 zeros, 1 what pairs wrote before, 2 anything */
} octo_scratch;

/* The multipliers of the FD of step i on the rows that are no torques: lam of C; on the others ∂E/∂u of terms over two steps. */
static void octo_pull(const octo_task *t, int ma, int member, int i, double *lam) {
  for (int j = 0; j < NX; ++j) lam[j] = 0.0;
#ifdef PAIR_ROWS
  octo_pair_pull(t, member, i, lam);
#endif
  const double *multipliers = t->lam + (size_t)member * t->units * ma, *row_scale = t->row_scale + (size_t)member * MU;
  for (int test = i * t->tests; test < (i + 1) * t->tests; ++test) {
    if (t->test_row[test] < 0) continue;
    const double *rows = multipliers + t->test_row[test] * ma + t->test_part[test] * MU;
    for (int r = 0; r < MU; ++r) lam[octo_unactuated[r]] += t->test_value[test] * row_scale[r] * rows[r];
  }
}

/* Costs of ``count`` steps from i on, and FD where it is not known yet. */
static octo_input octo_derive_costs(const octo_task *t, octo_scratch *s, int member, int i, int count) {
  octo_lanes *lanes = &s->group.lanes;
  double *fd[STEPS], *sums[STEPS];
  octo_input in = octo_lanes_turn(lanes, t->p + (size_t)member * NP, t->lam ? 2 : 1);
  for (int k = 0; k < STEPS; ++k) {
    fd[k] = t->fd + ((size_t)member * t->steps + i + (k < count ? k : 0)) * NX;
    sums[k] = (double *)&s->step_sums[k];
  }
  if (t->lam) octo_gather((const double *const *)fd, NX, lanes->fd);
  else octo_lanes_run(lanes, &in);
  if (!t->lam && !t->terms) octo_spread(lanes->fd, NX, fd, count);
  octo_group_arguments(&s->group, t, member, i, count);
  octo_group_states(&s->group, &in, 1);
  octo_derive_rows(s->group.q, s->group.r, s->group.slopes, &s->sums, s->pull, s->gradient_sum);
  octo_spread((const real *)&s->sums, sizeof s->sums / sizeof(real), sums, count);
  return in;
}

/* Whether a member's terms have all of their curvature. */
static int octo_is_curved(const octo_task *t, int member) { return t->lam && (!t->curved || t->curved[member]); }

/* jac and curvature of ``count`` steps from i on. */
static void octo_derive_group(const octo_task *t, octo_scratch *s, int ma, int member, int i, int count) {
  octo_lanes *lanes = &s->group.lanes;
  const double *lam[STEPS];
  double *jac[STEPS], *curvature[STEPS];
  octo_input in = octo_derive_costs(t, s, member, i, count);
#if NS > 0
  if (octo_is_curved(t, member)) octo_group_second(&s->group, &in, s->second);
#endif
  for (int k = 0; k < STEPS; ++k) {
    if (t->lam && k < count) octo_pull(t, ma, member, i + k, s->lam[k]);
    lam[k] = s->lam[k < count ? k : 0];
    jac[k] = s->jac[k];
    curvature[k] = s->curvature[k];
  }
#if NFC > 0
  octo_touch_begin(&s->touched, &s->group.rests, lanes, s->group.q, octo_is_curved(t, member), s->gradient_sum);
#endif
  if (t->lam) {
    octo_gather(lam, NX, lanes->lam);
    for (int j = 0; j < NU; ++j) lanes->lam[octo_actuated[j]] += s->pull[j];
    octo_lanes_run(lanes, &in);
  }
  int kept = s->zeros > lanes->touching ? s->zeros : lanes->touching;
#if NFC > 0
  if (!t->h) s->touched.hess = 0;
  if (!t->lam) octo_touch_alone(&s->touched, &in);
#endif
#if SLOPED
  double *slope[STEPS];
  for (int k = 0; k < STEPS; ++k) slope[k] = s->slope[k];
  octo_spread(s->gradient_sum, W3, slope, STEPS);
#endif
  octo_scatter(lanes->jac, octo_jac_slot, NX * W3, octo_jac_use, lanes->touching, kept, jac, STEPS);
  if (t->h && (t->lam || NFC > 0)) octo_scatter(lanes->hess, octo_line_slot, W3 * LD, octo_line_use, lanes->touching, kept, curvature, STEPS);
#if NBOUNDED > 0
  octo_keep_rows(t, member, i, count, s->group.slopes, lanes);
#endif
  s->zeros = lanes->touching;
}

static void octo_linearize_step(const octo_task *t, octo_target *g, octo_scratch *s, int member, int i, int k) {
  const double *fd = t->fd + ((size_t)member * t->steps + i) * NX;
#if SLOPED
  const double *slope = s->slope[k];
#else
  const double *slope = 0;
#endif
#ifdef PAIR_ROWS
  octo_pair_keep(t, member, i, s->jac[k]);
#endif
  double *hess = t->h ? s->hess : 0;
  octo_build_rows(&s->step_sums[k], s->jac[k], &s->rows);
  octo_gauss_newton(&s->rows, &s->step_sums[k], t->lam || NFC > 0 ? s->curvature[k] : 0, slope, hess, s->gradient);
#if NS > 0
  if (hess && octo_is_curved(t, member)) octo_bend(s->second[k], s->jac[k], hess);
#endif
  if (t->apart) {
    octo_write_stage(t, member, i, fd, s->jac[k], hess, s->gradient);
    return;
  }
  if (hess && t->nc > NX) octo_mirror(hess);
  if (t->carry && i < 2) {
    octo_carry_back(t->carry + (size_t)member * NX * NX, i, hess, s->gradient, s->jac[k]);
    s->zeros = 2;
  }
  octo_find_places(t, i, &s->places);
  int units = g->clear_unit, rows = g->clear_row;
  for (int l = 0; l < s->places.count; ++l) units = s->places.unit[l] >= units ? s->places.unit[l] + 1 : units;
  for (int test = i * t->tests; test < (i + 1) * t->tests; ++test) rows = t->test_row[test] >= rows ? t->test_row[test] + 1 : rows;
  int fresh = t->nc == NX && s->places.count == 3 && units > g->clear_unit;
  octo_clear(g, units, rows, fresh);
  if (!hess) octo_scatter_gradient(g, &s->places, s->gradient);
  else if (t->nc == NX) octo_scatter_nodes(g, &s->places, fresh, s->hess, s->gradient);
  else octo_scatter_model(g, &s->places, s->hess, s->gradient);
  octo_scatter_constraints(t, g, &s->places, i, t->row_scale + (size_t)member * MU, fd, s->jac[k]);
}

static void octo_linearize_chunk(void *shared, int item) {
  octo_sweep *sweep = shared;
  const octo_task *t = sweep->task;
  int nc = t->nc, ma = t->ma;
  size_t hs = 3 * (size_t)nc * nc, as = 3 * (size_t)ma * nc, halo_size = octo_halo_size(t);
  int member = item / t->chunks, chunk = item % t->chunks;
  size_t unit0 = (size_t)member * t->units;
  octo_scratch *s = aligned_alloc(64, (sizeof(octo_scratch) + 63) / 64 * 64);
  if (!s) { sweep->failed = 1; return; }
  double *halo = t->halo + ((size_t)member * t->chunks + chunk) * halo_size;
  octo_target g = {t->h ? t->h + unit0 * hs : 0, t->a + unit0 * as, t->b + unit0 * nc, t->c + unit0 * ma,
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
  if (!t->apart) octo_clear(&g, unit_last, row_last, 0); /* what no step touched */
  free(s);
}

static void octo_add_halo_of(void *shared, int member) { octo_add_halo(shared, member); }

int octo_linearize(octo_task *t, int threads) {
  octo_sweep sweep = {t, 0};
#ifdef PAIR_ROWS
  if (t->lam) sweep.failed |= octo_pair_terms(t, threads, 1);
#endif
  octo_parallel_for(octo_linearize_chunk, &sweep, t->batch * t->chunks, threads);
  octo_parallel_for(octo_add_halo_of, t, t->batch, t->chunks > 1 ? threads : 1);
#ifdef PAIR_ROWS
  if (!t->lam) sweep.failed |= octo_pair_terms(t, threads, 1); /* FD was not known before */
  sweep.failed |= octo_pair_add_all(t, threads);
#endif
  return sweep.failed;
}

/* One chunk of a single problem, for a caller that has some steps' numbers before those of the others. */
int octo_linearize_part(octo_task *t, int chunk) {
  octo_sweep sweep = {t, 0};
  octo_linearize_chunk(&sweep, chunk);
  return sweep.failed;
}

void octo_join_parts(octo_task *t) { octo_add_halo(t, 0); }
