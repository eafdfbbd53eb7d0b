/* Solves with the factor of elimination.c (whose text precedes this one): down the units, up again, refinement.
 * The system is [[H + diag(sigma), A'], [A, 0]] [v; lam] = [f; h]; inside, gradients are -f and row constants -h. */

typedef struct {
    _Alignas(64) double g[LD];                        /* gradient over [s | v] */
    _Alignas(64) double z[LD];
    double c[ROWS], mu[ROWS];                         /* constants, multipliers of the rows carried between units */
} sweep;

#define HELD (2 * NC)                                 /* a unit's t (r), g_B (r), w (n), kept between the two sweeps */

/* a multiple of 64 bytes, where the next right-hand side's sweeps begin */
ptrdiff_t octo_scratch_room(ptrdiff_t K) { return ROUND(K * (2 * (NC + MA) + HELD) + 2 * (ptrdiff_t)sizeof(sweep) / 8, 8); }

#if VL == 8
typedef double quad __attribute__((vector_size(32)));
static inline double total(vec a) {
    union { vec whole; quad half[2]; } u = {a};
    quad b = u.half[0] + u.half[1];
    return (b[0] + b[2]) + (b[1] + b[3]);
}
#else
static inline double total(vec a) { return (a[0] + a[2]) + (a[1] + a[3]); }
#endif

static inline double dot(const double *a, const double *b) {
    vec acc = {0};
    for (int j = 0; j < LV; j++) acc += *(const vec *)(a + j * VL) * *(const vec *)(b + j * VL);
    return total(acc);
}

/* unit k on the way down: constants into t, gradient onto s */
static void down(const unit *u, const double *numbers, sweep *s, const double *F, const double *G,
                 double *held) {
    int r = u->rank, n = NC - r;
    const double *Y = numbers, *T = Y + r * LD, *U = T + r * LD, *inverse = U + n * LD, *PBB = inverse + NC;
    const double *LU = PBB + r * r;
    double c[ROWS], *t = held, *gB = held + r, *w = gB + r, *g = s->g;
    for (int j = 0; j < NC; j++) {                    /* the window moves: v_k leaves s and becomes v */
        g[SC + j] = g[j] - F[j];
        g[j] = g[NC + j];
        g[NC + j] = 0;
    }
    for (int i = 0; i < u->rows; i++) {
        int row = u->row[i];
        c[i] = row < u->carried_in ? s->c[row] : -G[row - u->carried_in] * u->scale[row - u->carried_in];
    }
    for (int i = 0; i < u->rows; i++)
        for (int p = 0; p < (i < r ? i : r); p++) c[i] -= LU[i * r + p] * c[p];
    for (int p = r - 1; p >= 0; p--) {
        double sum = c[p];
        for (int q = p + 1; q < r; q++) sum += LU[p * r + q] * t[q];
        t[p] = -sum / LU[p * r + p];
    }
    for (int i = 0; i < u->carried_out; i++) s->c[i] = c[r + i];
    vec acc[LV];
    for (int j = 0; j < LV; j++) acc[j] = *(vec *)(g + j * VL);
    for (int a = 0; a < r; a++) {
        gB[a] = g[SC + u->column[a]];
        double q = gB[a];
        for (int b = 0; b < r; b++) q += 0.5 * PBB[a * r + b] * t[b];
        for (int j = 0; j < LV; j++)
            acc[j] += q * *(const vec *)(T + a * LD + j * VL) + t[a] * *(const vec *)(Y + a * LD + j * VL);
    }
    for (int j = 0; j < LV; j++) *(vec *)(g + j * VL) = acc[j];
    for (int p = 0; p < n; p++) {
        const double *row = U + p * LD;
        w[p] = g[SC + u->column[r + p]] * inverse[p];
        double factor = u->sign[p] * w[p];
        for (int j = 0; j < LV; j++) *(vec *)(g + j * VL) -= factor * *(const vec *)(row + j * VL);
    }
}

/* unit k on the way up: v_k from s = (one, two), NULL where there is none, then the multipliers of its rows */
static void up(const unit *u, const double *numbers, sweep *s, const double *one, const double *two, double *V,
               double *Lam, const double *held) {
    int r = u->rank, n = NC - r;
    const double *Y = numbers, *T = Y + r * LD, *U = T + r * LD, *inverse = U + n * LD, *PBB = inverse + NC;
    const double *LU = PBB + r * r, *t = held, *gB = held + r, *w = gB + r;
    double lam[ROWS], e[NC], vB[NC], *z = s->z;
    for (int j = 0; j < NC; j++) z[j] = one ? one[j] : 0;
    for (int j = 0; j < NC; j++) z[NC + j] = two ? two[j] : 0;
    for (int j = SC; j < LD; j++) z[j] = 0;
    for (int p = n - 1; p >= 0; p--)
        z[SC + u->column[r + p]] = -u->sign[p] * (w[p] + dot(U + p * LD, z)) * inverse[p];
    for (int a = 0; a < r; a++) {
        vB[a] = t[a] + dot(T + a * LD, z);
        e[a] = gB[a] + dot(Y + a * LD, z);
    }
    for (int a = 0; a < r; a++) {
        z[SC + u->column[a]] = vB[a];
        for (int b = 0; b < r; b++) e[a] += 0.5 * PBB[a * r + b] * (vB[b] + t[b]);
    }
    memcpy(V, z + SC, NC * sizeof(double));
    for (int a = 0; a < r; a++) {                     /* (L U)' lam_1 = -e - (L_2 U)' mu */
        double sum = -e[a];
        for (int b = 0; b < a; b++) sum -= LU[b * r + a] * e[b];
        e[a] = sum / LU[a * r + a];
    }
    for (int i = 0; i < u->carried_out; i++)
        for (int a = 0; a < r; a++) e[a] -= LU[(r + i) * r + a] * s->mu[i];
    for (int a = r - 1; a >= 0; a--)
        for (int b = a + 1; b < r; b++) e[a] -= LU[b * r + a] * e[b];
    for (int i = 0; i < u->rows; i++) {
        int past = i - r;
        lam[u->row[i]] = past < 0 ? e[i] : past < u->carried_out ? s->mu[past] : 0;
    }
    for (int i = 0; i < u->carried_in; i++) s->mu[i] = lam[i];
    for (int i = u->carried_in; i < u->rows; i++) Lam[i - u->carried_in] = lam[i] * u->scale[i - u->carried_in];
}

/* what one solve works on, and where: scratch is `count` rooms of [sweep of side 0 | of side 1 | F | G | V | Lam | held] */
typedef struct {
    int K, split, per_variable, count, correction;
    const double *H, *A, *sigma;
    const unit *units;
    const double *store;
    double *scratch;
} solving;

static sweep *sweep_of(const solving *s, int c, int side) {
    return (sweep *)(s->scratch + c * octo_scratch_room(s->K)) + side;
}

static double *residual_of(const solving *s, int c) { return (double *)(sweep_of(s, c, 0) + 2); }
static double *answer_of(const solving *s, int c) { return residual_of(s, c) + s->K * (NC + MA); }
static double *held_of(const solving *s, int c) { return residual_of(s, c) + 2 * s->K * (NC + MA); }

static void down_unit(const solving *s, int k, int side) {
    const unit *u = s->units + k;
    for (int c = 0; c < s->count; c++) {
        double *F = residual_of(s, c);
        down(u, s->store + u->at, sweep_of(s, c, side), F + k * NC, F + s->K * NC + u->first_row,
             held_of(s, c) + k * HELD);
    }
}

static void up_unit(const solving *s, int k, int side) {
    const unit *u = s->units + k;
    int toward = side ? 1 : -1, one = side || k > s->split, two = side || k > s->split + 1;
    for (int c = 0; c < s->count; c++) {              /* a correction overwrites the residual it corrects */
        double *to = s->correction ? residual_of(s, c) : answer_of(s, c), *v = to + k * NC;
        up(u, s->store + u->at, sweep_of(s, c, side), one ? v + toward * NC : NULL, two ? v + 2 * toward * NC : NULL, v,
           to + s->K * NC + u->first_row, held_of(s, c) + k * HELD);
    }
}

static void down_side(void *shared, int side) {
    const solving *s = shared;
    for (int c = 0; c < s->count; c++) memset(sweep_of(s, c, side), 0, sizeof(sweep));
    if (side)
        for (int k = 0; k < s->split; k++) down_unit(s, k, 1);
    else
        for (int k = s->K - 1; k >= (s->split ? s->split + 2 : 0); k--) down_unit(s, k, 0);
}

static void up_side(void *shared, int side) {
    const solving *s = shared;
    if (side)
        for (int k = s->split - 1; k >= 0; k--) up_unit(s, k, 1);
    else
        for (int k = s->split ? s->split + 2 : 0; k < s->K; k++) up_unit(s, k, 0);
}

/* units split+1 and split, with the gradient and the row constants that both sides left; back their multipliers */
static void sweep_middle(const solving *s) {
    int carried = s->units[s->split + 2].carried_out, from_other = s->units[s->split - 1].carried_out;
    for (int c = 0; c < s->count; c++) {
        sweep *back = sweep_of(s, c, 0), *forward = sweep_of(s, c, 1);
        for (int j = 0; j < NC; j++) back->g[j] += forward->g[NC + j], back->g[NC + j] += forward->g[j];
        memcpy(back->c + carried, forward->c, from_other * sizeof(double));
    }
    for (int k = s->split + 1; k >= s->split; k--) down_unit(s, k, 0);
    for (int k = s->split; k <= s->split + 1; k++) up_unit(s, k, 0);
    for (int c = 0; c < s->count; c++)
        memcpy(sweep_of(s, c, 1)->mu, sweep_of(s, c, 0)->mu + carried, from_other * sizeof(double));
}

static void sweeps(solving *s, companion *c, int correction) {
    s->correction = correction;
    both(c, down_side, s);
    if (s->split) sweep_middle(s);
    both(c, up_side, s);
}

#if NC >= VL
#define CHUNKS ((NC + VL - 1) / VL)  /* vectors of a row of H or A, unpadded in memory: the last one overlaps */
#define CHUNK(c) ((c) * VL + VL <= NC ? (c) * VL : NC - VL)

/* sums[i] += row i of the block times v, and back += the block transposed times w (where back is given) */
static inline __attribute__((always_inline)) void block_products(int rows, const double *block, const double *v,
                                                                 const double *w, vec *sums, double *back) {
    vec z[CHUNKS], turned[CHUNKS];
    for (int c = 0; c < CHUNKS; c++) z[c] = *(const loose *)(v + CHUNK(c)), turned[c] = (vec){0};
    for (int i = 0; i < CHUNKS * VL - NC; i++) z[CHUNKS - 1][i] = 0;     /* counted in the vector before */
    for (int i = 0; i < rows; i++)
        for (int c = 0; c < CHUNKS; c++) {
            vec row = *(const loose *)(block + i * NC + CHUNK(c));
            sums[i] += row * z[c];
            if (back) turned[c] += row * w[i];
        }
    if (!back) return;
    for (int c = 0; c < CHUNKS; c++)
        for (int i = c * VL - CHUNK(c); i < VL; i++) back[CHUNK(c) + i] -= turned[c][i];
}
#else
static void block_products(int rows, const double *block, const double *v, const double *w, vec *sums, double *back) {
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < NC; j++) {
            sums[i][0] += block[i * NC + j] * v[j];
            if (back) back[j] -= block[i * NC + j] * w[i];
        }
}
#endif

/* F = f - (H + sigma) V - A' Lam, G = h - A V, for one right-hand side of one unit; adds to earlier units' F */
static void unit_residual(int k, const double *H, const double *A, const double *weight, int per_variable,
                          const double *V, const double *Lam, double *F, double *G) {
    vec own[NC], rows[MA ? MA : 1];
    memset(own, 0, sizeof own), memset(rows, 0, sizeof rows);
    block_products(NC, H, V, NULL, own, NULL);
    block_products(MA, A, V, Lam, rows, F);
    for (int o = 1; o <= (k < 2 ? k : 2); o++) {
        block_products(NC, H + o * NC * NC, V - o * NC, V, own, F - o * NC);
        block_products(MA, A + o * MA * NC, V - o * NC, Lam, rows, F - o * NC);
    }
    for (int i = 0; i < NC; i++) F[i] -= total(own[i]) + (weight ? weight[per_variable ? i : 0] * V[i] : 0);
    for (int i = 0; i < MA; i++) G[i] -= total(rows[i]);
}

static void residual_unit(const solving *s, int k) {
    const double *weight = s->sigma ? s->sigma + (s->per_variable ? NC * k : k) : NULL;
    for (int c = 0; c < s->count; c++) {
        double *F = residual_of(s, c), *V = answer_of(s, c);
        unit_residual(k, s->H + (ptrdiff_t)k * 3 * NC * NC, s->A + (ptrdiff_t)k * 3 * MA * NC, weight, s->per_variable,
                      V + k * NC, V + s->K * NC + k * MA, F + k * NC, F + s->K * NC + k * MA);
    }
}

/* a unit adds to the two before it: those next to the split wait */
static void residual_side(void *shared, int side) {
    const solving *s = shared;
    if (side)
        for (int k = 0; s->split && k < s->split + 2; k++) residual_unit(s, k);
    else
        for (int k = s->split ? s->split + 4 : 0; k < s->K; k++) residual_unit(s, k);
}

/* F, G = right-hand sides; the largest entry of each into sizes */
static void load_residual(const solving *s, const double *f, const double *h, double *sizes) {
    for (int c = 0; c < s->count; c++) {
        double *F = residual_of(s, c), *G = F + s->K * NC;
        for (int i = 0; i < s->K * NC; i++) F[i] = f[(ptrdiff_t)i * s->count + c];
        for (int i = 0; i < s->K * MA; i++) G[i] = h ? h[(ptrdiff_t)i * s->count + c] : 0;
        sizes[c] = 0;
        for (int i = 0; i < s->K * (NC + MA); i++) sizes[c] = fabs(F[i]) > sizes[c] ? fabs(F[i]) : sizes[c];
    }
}

/* F, G = right-hand sides - KKT (V, Lam); sizes[c] = largest residual / largest right-hand side */
static void residuals(solving *s, companion *c, const double *f, const double *h, double *sizes) {
    load_residual(s, f, h, sizes);
    both(c, residual_side, s);
    for (int k = s->split + 2; s->split && k < s->split + 4; k++) residual_unit(s, k);
    for (int c = 0; c < s->count; c++) {
        const double *F = residual_of(s, c);
        double top = 0;
        for (int i = 0; i < s->K * (NC + MA); i++) top = fabs(F[i]) > top ? fabs(F[i]) : top;
        sizes[c] = sizes[c] > 0 ? top / sizes[c] : top;
    }
}

/* One member, count right-hand sides f (K, NC, count), h (K, MA, count) or NULL for zero.
 * At most `refine` corrections, while a relative residual exceeds `tolerance`; sizes (count): the last one computed,
 * of the answer itself where `check`. */
static void octo_solve(solving *s, companion *c, const double *f, const double *h, int refine, double tolerance,
                       int check, double *dv, double *lam, double *sizes) {
    int length = s->K * (NC + MA), rows = s->K * NC;
    load_residual(s, f, h, sizes);
    sweeps(s, c, 0);
    for (int step = 0; step <= refine && (step < refine || check); step++) {
        residuals(s, c, f, h, sizes);
        int fine = 1;
        for (int i = 0; i < s->count; i++) fine &= sizes[i] <= tolerance;
        if (fine || step == refine) break;
        sweeps(s, c, 1);
        for (int i = 0; i < s->count; i++) {
            double *F = residual_of(s, i), *V = answer_of(s, i);
            for (int j = 0; j < length; j++) V[j] += F[j];
        }
    }
    for (int i = 0; i < s->count; i++) {
        const double *V = answer_of(s, i);
        for (int j = 0; j < rows; j++) dv[(ptrdiff_t)j * s->count + i] = V[j];
        for (int j = rows; j < length; j++) lam[(ptrdiff_t)(j - rows) * s->count + i] = V[j];
    }
}

/* what one call works on: all members share it, each worker has its own windows or scratch */
typedef struct {
    int K, split, per_variable, stop, count, refine, check;
    double tolerance;
    const double *H, *A, *sigma, *f, *h;
    unit *units;
    double *store, *scratch, *dv, *lam, *sizes;
    window *windows;
    int *verdict;
} job;

static const double *member_sigma(const job *j, ptrdiff_t m) {
    return j->sigma ? j->sigma + m * j->K * (j->per_variable ? NC : 1) : NULL;
}

static void factor_member(const void *shared, ptrdiff_t m, int worker) {
    const job *j = shared;
    factoring f = {.K = j->K, .split = j->split, .per_variable = j->per_variable, .stop = j->stop,
                   .H = j->H + m * j->K * 3 * NC * NC, .A = j->A + m * j->K * 3 * MA * NC, .sigma = member_sigma(j, m),
                   .units = j->units + m * j->K, .store = j->store + m * j->K * ROOM(NC, ROWS),
                   .windows = j->windows + 2 * worker};
    companion *c = companion_start(j->split > 0);
    octo_factor(&f, c, j->verdict + 4 * m);
    companion_stop(c);
}

static void solve_member(const void *shared, ptrdiff_t m, int worker) {
    const job *j = shared;
    ptrdiff_t variables = (ptrdiff_t)j->K * NC * j->count, rows = (ptrdiff_t)j->K * MA * j->count;
    double *dv = j->dv + m * variables, *lam = j->lam + m * rows, *sizes = j->sizes + m * j->count;
    if (!j->verdict[4 * m + 3]) {                     /* a factor that cannot solve says so */
        for (ptrdiff_t i = 0; i < variables; i++) dv[i] = NAN;
        for (ptrdiff_t i = 0; i < rows; i++) lam[i] = NAN;
        for (int c = 0; c < j->count; c++) sizes[c] = NAN;
        return;
    }
    solving s = {.K = j->K, .split = j->split, .per_variable = j->per_variable, .count = j->count,
                 .H = j->H + m * j->K * 3 * NC * NC, .A = j->A + m * j->K * 3 * MA * NC, .sigma = member_sigma(j, m),
                 .units = j->units + m * j->K, .store = j->store + m * j->K * ROOM(NC, ROWS),
                 .scratch = j->scratch + worker * octo_scratch_room(j->K) * j->count};
    companion *c = companion_start(j->split > 0);
    octo_solve(&s, c, j->f + m * variables, j->h ? j->h + m * rows : NULL, j->refine, j->tolerance, j->check, dv, lam,
               sizes);
    companion_stop(c);
}

/* split: units that a companion takes from the front, 0 for none, else at most K-4; sigma: NULL, (batch, K) or
 * (batch, K, NC); windows: two a thread; verdict (batch, 4) as octo_factor's */
void octo_factor_batch(int batch, int threads, int K, int split, const double *H, const double *A, const double *sigma,
                       int per_variable, int stop, unit *units, double *store, window *windows, int *verdict) {
    job j = {.K = K, .split = split, .per_variable = per_variable, .stop = stop, .H = H, .A = A, .sigma = sigma,
             .units = units, .store = store, .windows = windows, .verdict = verdict};
    octo_parallel_for_workers(factor_member, &j, batch, threads);
}

/* f, dv (batch, K, NC, count), h, lam (batch, K, MA, count), sizes (batch, count); scratch: count rooms a thread */
void octo_solve_batch(int batch, int threads, int K, int split, const double *H, const double *A, const double *sigma,
                      int per_variable, unit *units, double *store, int *verdict, int count, const double *f,
                      const double *h, int refine, double tolerance, int check, double *scratch, double *dv,
                      double *lam, double *sizes) {
    job j = {.K = K, .split = split, .per_variable = per_variable, .count = count, .refine = refine, .check = check,
             .tolerance = tolerance, .H = H, .A = A, .sigma = sigma, .f = f, .h = h, .units = units, .store = store,
             .scratch = scratch, .dv = dv, .lam = lam, .sizes = sizes, .verdict = verdict};
    octo_parallel_for_workers(solve_member, &j, batch, threads);
}
