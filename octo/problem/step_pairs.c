/* Terms over two steps in a row r(x_{i+1}, x_i, x_{i−1}, x_{i−2}, u_i, u_{i−1}, p, q), i = 1 … N−1, of a cycle 0 … N−1, after their
 * functions and tables (step_pairs.py) and scatter.c, before assemble.c. They pass over the steps on their own: residuals and slopes before the dynamics
 * are derived, whose multipliers need dE/du of a step and of the one after it; rows, which need the slopes of the FD of two steps,
 * after that. */

#define W4 (4 * NX)
#define PAIR_ROOM (PAIR_ROWS + PAIR_ENTRIES + PAIR_BENDS + NU * W3)
int octo_pair_room(void) { return PAIR_ROOM; }
#define PAIR_PLACES 16 /* four nodes of at most four slots */

/* What is kept of a step: r, slopes, second derivatives, and the rows of J of its torques. */
static double *octo_pair_kept(const octo_task *t, int member, int i) { return t->pairs + ((size_t)member * t->steps + i) * PAIR_ROOM; }
static double *octo_pair_torques(const octo_task *t, int member, int i) { return octo_pair_kept(t, member, i) + PAIR_ROOM - NU * W3; }
/* The first step with one before it: of a cycle all have, and what comes before the first is the last one carried back. */
static int octo_pair_first(const octo_task *t, int first) { return first > 0 || t->carry ? first : 1; }
static const double *octo_pair_carry(const octo_task *t, int member) { return t->carry + (size_t)member * NX * NX; }

/* x_{−2} of a cycle: carried back, as x_{−1} = carry x_{N−1} + constant is. */
static void octo_pair_oldest(const octo_task *t, int member, double *out) {
  const double *nodes = t->nodes + (size_t)member * (t->steps + 2) * NX, *last = nodes + (t->steps - 1) * NX, *carry = octo_pair_carry(t, member);
  for (int j = 0; j < NX; ++j) {
    out[j] = nodes[j];
    for (int k = 0; k < NX; ++k) out[j] += carry[j * NX + k] * (last[k] - last[NX + k]);
  }
}

/* The torques of step i (NU); of a cycle's step −1 those of the last one, carried back. */
static void octo_pair_torque(const octo_task *t, int member, int i, double *out) {
  const double *fd = t->fd + ((size_t)member * t->steps + (i < 0 ? t->steps - 1 : i)) * NX;
  for (int j = 0; j < NU; ++j) {
    out[j] = i < 0 ? 0.0 : fd[octo_actuated[j]];
    for (int k = 0; i < 0 && k < NU; ++k) out[j] += octo_pair_carry(t, member)[octo_actuated[j] * NX + octo_actuated[k]] * fd[octo_actuated[k]];
  }
}
static const double *octo_pair_q(const octo_task *t, int member, int i) { return t->q + ((size_t)member * t->steps + i) * NQ; }

/* Whether a member's exact terms have all of their curvature. */
static int octo_pair_curved(const octo_task *t, int member) { return t->lam && (!t->curved || t->curved[member]); }

typedef struct { real x[4][NX], u[2][NU + 1], q[NQ], r[PAIR_ROWS], slopes[PAIR_ENTRIES + 1], bends[PAIR_BENDS + 1]; } octo_pair_group;

/* r of ``count`` steps from i on and, with ``derive``, their slopes and second derivatives, in the lanes of vectors. */
static void octo_pair_evaluate(octo_pair_group *g, const octo_task *t, int member, int i, int count, int derive) {
  const double *x[4][STEPS], *u[2][STEPS], *q[STEPS];
  double torque[2][STEPS][NU + 1], oldest[NX];
  if (i == 0) octo_pair_oldest(t, member, oldest);
  for (int k = 0; k < STEPS; ++k) {
    int step = i + (k < count ? k : 0);
    for (int node = 0; node < 4; ++node)
      x[node][k] = step + 2 < node ? oldest : t->nodes + ((size_t)member * (t->steps + 2) + step + 2 - node) * NX;
    for (int back = 0; back < 2; ++back) {
      octo_pair_torque(t, member, step - back, torque[back][k]);
      u[back][k] = torque[back][k];
    }
    q[k] = octo_pair_q(t, member, step);
  }
  for (int node = 0; node < 4; ++node) octo_gather(x[node], NX, g->x[node]);
  for (int back = 0; back < 2; ++back) octo_gather(u[back], NU, g->u[back]);
  octo_gather(q, NQ, g->q);
  const void *arg[8] = {g->x[0], g->x[1], g->x[2], g->x[3], g->u[0], g->u[1], t->p + (size_t)member * NP, g->q};
  real *res[2] = {g->r, g->slopes};
  if (derive) octo_step_pair_jac(arg, res);
  else octo_step_pair(arg, res);
#if PAIR_BENDS > 0
  res[0] = g->bends;
  if (derive && octo_pair_curved(t, member)) octo_step_pair_bend(arg, res);
#endif
}

typedef struct { const octo_task *task; int derive, colour, failed; } octo_pair_sweep;

/* Steps of a chunk: their share of each term or, with ``derive``, what is kept of them. */
static void octo_pair_chunk(void *shared, int item) {
  octo_pair_sweep *sweep = shared;
  const octo_task *t = sweep->task;
  int member = item / t->chunks, first = t->chunk_step[item % t->chunks], last = t->chunk_step[item % t->chunks + 1];
  octo_pair_group *g = aligned_alloc(64, (sizeof(octo_pair_group) + 63) / 64 * 64);
  if (!g) { sweep->failed = 1; return; }
  for (int i = octo_pair_first(t, first); i < last; i += STEPS) {
    int count = last - i < STEPS ? last - i : STEPS;
    double *r[STEPS], *slopes[STEPS], *bends[STEPS], value[STEPS][PAIR_ROWS];
    octo_pair_evaluate(g, t, member, i, count, sweep->derive);
    for (int k = 0; k < count; ++k) {
      r[k] = sweep->derive ? octo_pair_kept(t, member, i + k) : value[k];
      slopes[k] = r[k] + PAIR_ROWS;
      bends[k] = slopes[k] + PAIR_ENTRIES;
    }
    octo_spread(g->r, PAIR_ROWS, r, count);
    if (sweep->derive) {
      octo_spread(g->slopes, PAIR_ENTRIES, slopes, count);
      if (octo_pair_curved(t, member)) octo_spread(g->bends, PAIR_BENDS, bends, count);
      continue;
    }
    for (int k = 0; k < count; ++k)
      for (int row = 0; row < PAIR_ROWS; ++row) {
        double c = octo_pair_q(t, member, i + k)[octo_pair_row_term[row]];
        if (c != 0.0) t->terms[((size_t)member * t->steps + i + k) * NTERM + octo_pair_row_term[row]] += c * value[k][row] * value[k][row];
      }
  }
  free(g);
}

static int octo_pair_terms(const octo_task *t, int threads, int derive) {
  octo_pair_sweep sweep = {t, derive, 0, 0};
  octo_parallel_for(octo_pair_chunk, &sweep, t->batch * t->chunks, threads);
  return sweep.failed;
}

/* lam (NX) += dE/du of step i: of its own residual, and of that of the step after it. */
static void octo_pair_pull(const octo_task *t, int member, int i, double *lam) {
  for (int after = 0; after < 2; ++after) {
    int step = (i + after) % t->steps, first = W4 + after * NU;
    if (step == 0 && !t->carry) continue;
    const double *r = octo_pair_kept(t, member, step), *slopes = r + PAIR_ROWS, *q = octo_pair_q(t, member, step);
    for (int z = PAIR_ENTRIES - 1; z >= 0 && octo_pair_entry_column[z] >= first; --z) { /* entries are sorted by column */
      int row = octo_pair_entry_row[z], j = octo_pair_entry_column[z] - first;
      double c = q[octo_pair_row_term[row]];
      if (j >= NU || c == 0.0) continue;
      double pull = 2.0 * c * r[row] * slopes[z];
      if (step >= after) lam[octo_actuated[j]] += pull;
      else for (int k = 0; k < NU; ++k) lam[octo_actuated[k]] += octo_pair_carry(t, member)[octo_actuated[j] * NX + octo_actuated[k]] * pull;
    }
  }
}

/* Keeps the rows of J (NX, W3) of the torques of step i. */
static void octo_pair_keep(const octo_task *t, int member, int i, const double *jac) {
  double *to = octo_pair_torques(t, member, i);
  for (int j = 0; j < NU; ++j) memcpy(to + j * W3, jac + octo_actuated[j] * W3, W3 * sizeof(double));
}

/* Slopes (W4) with respect to the nodes of a cycle's first three steps become those with respect to what these are made of. */
static void octo_pair_carry_line(const octo_task *t, int member, int i, double *line) {
  for (int node = i + 1; t->carry && node < 4; ++node) {
    double turned[NX] = {0};
    for (int j = 0; j < NX; ++j)
      for (int k = 0; k < NX; ++k) turned[k] += line[node * NX + j] * octo_pair_carry(t, member)[j * NX + k];
    memcpy(line + node * NX, turned, sizeof turned);
  }
}

/* d torques / d window (NU, W4) of step i and, with ``back``, of the one before it, with respect to what the nodes are made of. */
static void octo_pair_torque_lines(const octo_task *t, int member, int i, int back, double (*lines)[W4]) {
  int seam = i < back;
  const double *own = octo_pair_torques(t, member, seam ? t->steps - 1 : i - back);
  for (int j = 0; j < NU; ++j) {
    memset(lines[j], 0, W4 * sizeof(double));
    for (int k = 0; k < NU; ++k) {
      double part = seam ? octo_pair_carry(t, member)[octo_actuated[j] * NX + octo_actuated[k]] : j == k;
      for (int c = 0; part != 0.0 && c < W3; ++c) lines[j][back * NX + c] += part * own[k * W3 + c];
    }
    if (!seam) octo_pair_carry_line(t, member, i, lines[j]); /* those of the seam are of the last nodes themselves */
  }
}

/* d residual / d window (count, W4) of step i and its values, scaled by the root of twice the coefficient; rows of terms that leave
 * the step out are not there. */
static int octo_pair_rows(const octo_task *t, int member, int i, double (*rows)[W4], double *value) {
  const double *r = octo_pair_kept(t, member, i), *slopes = r + PAIR_ROWS, *q = octo_pair_q(t, member, i);
  int count = 0, place[PAIR_ROWS];
  double scale[PAIR_ROWS];
  for (int row = 0; row < PAIR_ROWS; ++row) {
    double c = q[octo_pair_row_term[row]];
    place[row] = -1;
    if (c == 0.0) continue;
    scale[row] = sqrt(2.0 * c);
    memset(rows[count], 0, W4 * sizeof(double));
    value[count] = scale[row] * r[row];
    place[row] = count++;
  }
  int z = 0; /* entries are sorted by column: those to the window come first */
  for (; z < PAIR_ENTRIES && octo_pair_entry_column[z] < W4; ++z) {
    int row = octo_pair_entry_row[z];
    if (place[row] >= 0) rows[place[row]][octo_pair_entry_column[z]] += scale[row] * slopes[z];
  }
  for (int row = 0; row < count; ++row) octo_pair_carry_line(t, member, i, rows[row]);
  double lines[2][NU + 1][W4];
  for (int back = 0; back < 2; ++back) octo_pair_torque_lines(t, member, i, back, lines[back]);
  for (; z < PAIR_ENTRIES; ++z) {
    int row = octo_pair_entry_row[z], of = octo_pair_entry_column[z] - W4, back = of >= NU;
    if (place[row] < 0) continue;
    const double *line = lines[back][of - back * NU];
    double slope = scale[row] * slopes[z], *restrict to = rows[place[row]];
    for (int j = back * NX; j < W3 + back * NX; ++j) to[j] += slope * line[j];
  }
  return count;
}

#define PAIR_LD ((NX + 7) / 8 * 8)
typedef double octo_pair_line[PAIR_LD] __attribute__((aligned(64)));

/* Where the unknowns of a node of step i stand in the stencil: of x_{−2} those of x_{N−2}. */
static int octo_pair_node(const octo_task *t, int i, int node) { return i + 2 < node ? t->steps - 1 : i + 2 - node; }

/* The parts of units that the four nodes of step i are made of, each once, and the rows over them. */
typedef struct {
  octo_pair_line rows[PAIR_PLACES][PAIR_ROWS];
  int count, unit[PAIR_PLACES], part[PAIR_PLACES];
  double hess[PAIR_BENDS ? W4 : 1][W4]; /* what exact terms have beside rowsᵀ rows */
} octo_pair_places;

static void octo_pair_combine(const octo_task *t, int i, double (*rows)[W4], int count, octo_pair_places *s) {
  s->count = 0;
  for (int node = 0; node < 4; ++node)
    for (int k = 0; k < t->slots; ++k) {
      size_t at = (size_t)octo_pair_node(t, i, node) * t->slots + k;
      if (t->slot_unit[at] < 0) continue;
      int l = 0;
      while (l < s->count && (s->unit[l] != t->slot_unit[at] || s->part[l] != t->slot_part[at])) ++l;
      if (l == s->count) {
        s->unit[l] = t->slot_unit[at], s->part[l] = t->slot_part[at], s->count++;
        memset(s->rows[l], 0, sizeof s->rows[l]);
      }
      double part = t->slot_value[at];
      for (int row = 0; row < count; ++row) {
        const double *from = rows[row] + node * NX;
        double *restrict to = s->rows[l][row];
        for (int j = 0; j < NX; ++j) to[j] += part * from[j];
      }
    }
}

/* to (NX) += line (PAIR_LD). */
static inline __attribute__((always_inline)) void octo_pair_put(const v8 *line, double *to) {
  for (int j = 0; j < NX / 8; ++j) *(v8_anywhere *)(to + 8 * j) += line[j];
  for (int j = NX / 8 * 8; j < NX; ++j) to[j] += line[NX / 8][j % 8];
}

/* to (NX, nc) += leftᵀ right, two of its rows at a time. */
static void octo_pair_product(const octo_pair_line *left, const octo_pair_line *right, int count, int nc, double *to) {
  for (int r = 0; r < NX; r += 2) {
    v8 one[PAIR_LD / 8] = {0}, two[PAIR_LD / 8] = {0};
    for (int row = 0; row < count; ++row) {
      double f = left[row][r], g = left[row][r + 1]; /* of an odd NX the last one is the first zero after the row */
      for (int j = 0; j < PAIR_LD / 8; ++j) {
        v8 line = *(const v8 *)(right[row] + 8 * j);
        one[j] += f * line;
        two[j] += g * line;
      }
    }
    octo_pair_put(one, to + r * nc);
    if (r + 1 < NX) octo_pair_put(two, to + (r + 1) * nc);
  }
}

/* H += rowsᵀ rows and b += rowsᵀ values of step i. */
static void octo_pair_add(const octo_task *t, int member, int i, octo_pair_places *s) {
  double rows[PAIR_ROWS][W4], value[PAIR_ROWS];
  int nc = t->nc, count = octo_pair_rows(t, member, i, rows, value);
  octo_pair_combine(t, i, rows, count, s);
  for (int a = 0; a < s->count; ++a) {
    size_t unit = (size_t)member * t->units + s->unit[a];
    v8 slope[PAIR_LD / 8] = {0};
    for (int row = 0; row < count; ++row)
      for (int j = 0; j < PAIR_LD / 8; ++j) slope[j] += value[row] * *(const v8 *)(s->rows[a][row] + 8 * j);
    octo_pair_put(slope, t->b + unit * nc + s->part[a] * NX);
    for (int other = 0; t->h && other < s->count; ++other) {
      int lag = s->unit[a] - s->unit[other];
      if (lag < 0) continue;
      double *to = t->h + ((unit * 3 + lag) * nc + s->part[a] * NX) * nc + s->part[other] * NX;
      octo_pair_product(s->rows[a], s->rows[other], count, nc, to);
    }
  }
}

#if PAIR_BENDS > 0
/* hess (W4, W4) = [I; U_i; U_{i−1}]ᵀ S [I; U_i; U_{i−1}], S the second derivatives to the window and the two torques. */
static void octo_pair_chain(const octo_task *t, int member, int i, double (*hess)[W4]) {
  const double *second = octo_pair_kept(t, member, i) + PAIR_ROWS + PAIR_ENTRIES;
  double torques[2 * NU + 1][W4], pulled[2 * NU + 1][W4]; /* of each torque: its slopes, and what stands beside them */
  memset(pulled, 0, sizeof pulled);
  memset(hess, 0, W4 * sizeof *hess);
  for (int back = 0; back < 2; ++back) octo_pair_torque_lines(t, member, i, back, torques + back * NU);
  for (int z = 0; z < PAIR_BENDS; ++z) {
    int a = octo_pair_bend_row[z], b = octo_pair_bend_column[z];
    if (b < W4) hess[a][b] = hess[b][a] = second[z];
    else if (a < W4) pulled[b - W4][a] += second[z];
  }
  for (int r = 0; r < W4; ++r) octo_pair_carry_line(t, member, i, hess[r]);
  for (int c = 0; t->carry && c < W4; ++c) {
    double column[W4];
    for (int r = 0; r < W4; ++r) column[r] = hess[r][c];
    octo_pair_carry_line(t, member, i, column);
    for (int r = 0; r < W4; ++r) hess[r][c] = column[r];
  }
  for (int u = 0; u < 2 * NU; ++u) octo_pair_carry_line(t, member, i, pulled[u]);
  for (int z = 0; z < PAIR_BENDS; ++z) {
    int a = octo_pair_bend_row[z] - W4, b = octo_pair_bend_column[z] - W4;
    double value = a == b ? 0.5 * second[z] : second[z]; /* both halves are added */
    for (int j = 0; a >= 0 && j < W4; ++j) pulled[b][j] += value * torques[a][j];
  }
  for (int u = 0; u < 2 * NU; ++u)
    for (int r = 0; r < W4; ++r) {
      double one = torques[u][r], other = pulled[u][r];
      if (one == 0.0 && other == 0.0) continue;
      for (int j = 0; j < W4; ++j) hess[r][j] += one * pulled[u][j] + other * torques[u][j];
    }
}

/* H += Sᵀ hess S of step i. */
static void octo_pair_bend(const octo_task *t, int member, int i, octo_pair_places *s) {
  int nc = t->nc, places = 4 * t->slots;
  octo_pair_chain(t, member, i, s->hess);
  for (int pair = 0; pair < places * places; ++pair) {
    int node = pair / places / t->slots, other = pair % places / t->slots;
    size_t at = (size_t)octo_pair_node(t, i, node) * t->slots + pair / places % t->slots;
    size_t to = (size_t)octo_pair_node(t, i, other) * t->slots + pair % t->slots;
    int lag = t->slot_unit[at] - t->slot_unit[to];
    if (t->slot_unit[at] < 0 || t->slot_unit[to] < 0 || lag < 0) continue;
    double value = t->slot_value[at] * t->slot_value[to];
    double *h = t->h + ((((size_t)member * t->units + t->slot_unit[at]) * 3 + lag) * nc + t->slot_part[at] * NX) * nc + t->slot_part[to] * NX;
    for (int r = 0; r < NX; ++r)
      for (int j = 0; j < NX; ++j) h[(size_t)r * nc + j] += value * s->hess[node * NX + r][other * NX + j];
  }
}
#endif

/* Chunks of one colour, every other one, share no unit. */
static void octo_pair_add_chunk(void *shared, int item) {
  octo_pair_sweep *sweep = shared;
  const octo_task *t = sweep->task;
  int own = (t->chunks + 1 - sweep->colour) / 2, chunk = 2 * (item % own) + sweep->colour, first = t->chunk_step[chunk];
  octo_pair_places *s = aligned_alloc(64, (sizeof *s + 63) / 64 * 64);
  if (!s) { sweep->failed = 1; return; }
  for (int i = octo_pair_first(t, first); i < t->chunk_step[chunk + 1]; ++i) {
    octo_pair_add(t, item / own, i, s);
#if PAIR_BENDS > 0
    if (t->h && octo_pair_curved(t, item / own)) octo_pair_bend(t, item / own, i, s);
#endif
  }
  free(s);
}

static int octo_pair_add_all(const octo_task *t, int threads) {
  octo_pair_sweep sweep = {t, 1, 0, 0};
  for (; sweep.colour < 2; ++sweep.colour)
    octo_parallel_for(octo_pair_add_chunk, &sweep, t->batch * ((t->chunks + 1 - sweep.colour) / 2), threads);
  return sweep.failed;
}
