/* Solves with the factor of elimination.c (whose text precedes this one): down the units, up again, refinement.
 * The system is [[H + diag(sigma), A'], [A, 0]] [v; lam] = [f; h]; inside, gradients are -f and row constants -h. */
#include <pthread.h>

typedef struct {
    _Alignas(64) double g[LD];                        /* gradient over [s | v] */
    _Alignas(64) double z[LD];
    double c[ROWS], mu[ROWS];                         /* constants, multipliers of the rows carried between units */
} sweep;

#define HELD (2 * NC)                                 /* a unit's t (r), g_B (r), w (n), kept between the two sweeps */

ptrdiff_t octo_scratch_room(ptrdiff_t K) { return ROUND(K * (2 * (NC + MA) + HELD) + (ptrdiff_t)sizeof(sweep) / 8, VL); }

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

/* unit k on the way up: v_k from s = (v_{k-1}, v_{k-2}), then the multipliers of its rows */
static void up(int k, const unit *u, const double *numbers, sweep *s, double *V, double *Lam, const double *held) {
    int r = u->rank, n = NC - r;
    const double *Y = numbers, *T = Y + r * LD, *U = T + r * LD, *inverse = U + n * LD, *PBB = inverse + NC;
    const double *LU = PBB + r * r, *t = held, *gB = held + r, *w = gB + r;
    double lam[ROWS], e[NC], vB[NC], *z = s->z;
    for (int j = 0; j < NC; j++) z[j] = k > 0 ? V[j - NC] : 0;
    for (int j = 0; j < NC; j++) z[NC + j] = k > 1 ? V[j - 2 * NC] : 0;
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
        lam[u->row[i]] = past < 0 ? e[i] : past < u->carried_out && k > 0 ? s->mu[past] : 0;
    }
    for (int i = 0; i < u->carried_in; i++) s->mu[i] = lam[i];
    for (int i = 0; i < MA; i++) Lam[i] = lam[u->carried_in + i] * u->scale[i];
}

static void sweeps(int K, int count, const unit *units, const double *store, double *scratch, ptrdiff_t room,
                   int correction) {
    for (int c = 0; c < count; c++) memset(scratch + c * room, 0, sizeof(sweep));
    for (int k = K - 1; k >= 0; k--)
        for (int c = 0; c < count; c++) {
            sweep *s = (sweep *)(scratch + c * room);
            double *F = (double *)(s + 1), *G = F + K * NC, *held = G + K * (2 * MA + NC);
            down(units + k, store + units[k].at, s, F + k * NC, G + k * MA, held + k * HELD);
        }
    for (int k = 0; k < K; k++)
        for (int c = 0; c < count; c++) {
            sweep *s = (sweep *)(scratch + c * room);
            double *F = (double *)(s + 1), *G = F + K * NC, *V = G + K * MA, *held = V + K * (NC + MA);
            double *to = correction ? F : V;          /* a correction overwrites the residual it corrects */
            up(k, units + k, store + units[k].at, s, to + k * NC, to + K * NC + k * MA, held + k * HELD);
        }
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

/* F, G = right-hand sides - KKT (V, Lam); sizes[c] = largest residual / largest right-hand side */
static void residuals(int K, int count, const double *H, const double *A, const double *sigma, int per_variable,
                      const double *f, const double *h, double *scratch, ptrdiff_t room, double *sizes) {
    for (int c = 0; c < count; c++) {
        double *F = (double *)((sweep *)(scratch + c * room) + 1), *G = F + K * NC;
        for (int i = 0; i < K * NC; i++) F[i] = f[(ptrdiff_t)i * count + c];
        for (int i = 0; i < K * MA; i++) G[i] = h ? h[(ptrdiff_t)i * count + c] : 0;
        double top = 0;
        for (int i = 0; i < K * (NC + MA); i++) top = fabs(F[i]) > top ? fabs(F[i]) : top;
        sizes[c] = top;
    }
    for (int k = 0; k < K; k++)
        for (int c = 0; c < count; c++) {
            double *F = (double *)((sweep *)(scratch + c * room) + 1), *G = F + K * NC, *V = G + K * MA;
            const double *weight = sigma ? sigma + (per_variable ? NC * k : k) : NULL;
            unit_residual(k, H + (ptrdiff_t)k * 3 * NC * NC, A + (ptrdiff_t)k * 3 * MA * NC, weight, per_variable,
                          V + k * NC, V + K * NC + k * MA, F + k * NC, G + k * MA);
        }
    for (int c = 0; c < count; c++) {
        const double *F = (double *)((sweep *)(scratch + c * room) + 1);
        double top = 0;
        for (int i = 0; i < K * (NC + MA); i++) top = fabs(F[i]) > top ? fabs(F[i]) : top;
        sizes[c] = sizes[c] > 0 ? top / sizes[c] : top;
    }
}

/* One member, count right-hand sides f (K, NC, count), h (K, MA, count) or NULL for zero; scratch holds count rooms.
 * At most `refine` corrections, while a relative residual exceeds `tolerance`; sizes (count): the last one computed,
 * of the answer itself where `check`. */
void octo_solve(int K, int count, const double *H, const double *A, const double *sigma, int per_variable,
                const unit *units, const double *store, const double *f, const double *h, int refine,
                double tolerance, int check, double *scratch, double *dv, double *lam, double *sizes) {
    ptrdiff_t room = octo_scratch_room(K);
    for (int c = 0; c < count; c++) {
        double *F = (double *)((sweep *)(scratch + c * room) + 1), *G = F + K * NC;
        for (int i = 0; i < K * NC; i++) F[i] = f[(ptrdiff_t)i * count + c];
        for (int i = 0; i < K * MA; i++) G[i] = h ? h[(ptrdiff_t)i * count + c] : 0;
    }
    sweeps(K, count, units, store, scratch, room, 0);
    for (int step = 0; step <= refine && (step < refine || check); step++) {
        residuals(K, count, H, A, sigma, per_variable, f, h, scratch, room, sizes);
        int fine = 1;
        for (int c = 0; c < count; c++) fine &= sizes[c] <= tolerance;
        if (fine || step == refine) break;
        sweeps(K, count, units, store, scratch, room, 1);
        for (int c = 0; c < count; c++) {
            double *F = (double *)((sweep *)(scratch + c * room) + 1), *V = F + K * (NC + MA);
            for (int i = 0; i < K * (NC + MA); i++) V[i] += F[i];
        }
    }
    for (int c = 0; c < count; c++) {
        const double *V = (double *)((sweep *)(scratch + c * room) + 1) + K * (NC + MA);
        for (int i = 0; i < K * NC; i++) dv[(ptrdiff_t)i * count + c] = V[i];
        for (int i = 0; i < K * MA; i++) lam[(ptrdiff_t)i * count + c] = V[K * NC + i];
    }
}

/* what one call works on: all members share it, each worker has its own window or scratch */
typedef struct {
    int K, per_variable, stop, count, refine, check;
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
    octo_factor(j->K, j->H + m * j->K * 3 * NC * NC, j->A + m * j->K * 3 * MA * NC, member_sigma(j, m),
                j->per_variable, j->stop, j->units + m * j->K, j->store + m * j->K * ROOM(NC, ROWS),
                j->windows + worker, j->verdict + 4 * m);
}

static void solve_member(const void *shared, ptrdiff_t m, int worker) {
    const job *j = shared;
    ptrdiff_t variables = (ptrdiff_t)j->K * NC * j->count, rows = (ptrdiff_t)j->K * MA * j->count;
    double *dv = j->dv + m * variables, *lam = j->lam + m * rows, *sizes = j->sizes + m * j->count;
    if (j->verdict[4 * m + 3]) {
        octo_solve(j->K, j->count, j->H + m * j->K * 3 * NC * NC, j->A + m * j->K * 3 * MA * NC, member_sigma(j, m),
                   j->per_variable, j->units + m * j->K, j->store + m * j->K * ROOM(NC, ROWS), j->f + m * variables,
                   j->h ? j->h + m * rows : NULL, j->refine, j->tolerance, j->check,
                   j->scratch + worker * octo_scratch_room(j->K) * j->count, dv, lam, sizes);
        return;
    }
    for (ptrdiff_t i = 0; i < variables; i++) dv[i] = NAN;       /* a factor that cannot solve says so */
    for (ptrdiff_t i = 0; i < rows; i++) lam[i] = NAN;
    for (int c = 0; c < j->count; c++) sizes[c] = NAN;
}

typedef struct {
    void (*run)(const void *, ptrdiff_t, int);
    const void *shared;
    ptrdiff_t *next, batch;
    int number;
} worker;

static void *work(void *argument) {
    const worker *w = argument;
    for (ptrdiff_t m; (m = __atomic_fetch_add(w->next, 1, __ATOMIC_RELAXED)) < w->batch;)
        w->run(w->shared, m, w->number);
    return NULL;
}

/* the members of a batch over at most 64 threads, this one included */
static void spread(void (*run)(const void *, ptrdiff_t, int), const void *shared, ptrdiff_t batch, int threads) {
    ptrdiff_t next = 0;
    pthread_t handle[64];
    worker workers[64];
    int started = 0, wanted = threads < batch ? threads : (int)batch;
    for (int i = 0; i == 0 || (i < wanted && i < 64); i++) workers[i] = (worker){run, shared, &next, batch, i};
    for (int i = 1; i < wanted && i < 64; i++, started++)
        if (pthread_create(handle + i, NULL, work, workers + i)) break;
    work(workers);
    for (int i = 1; i <= started; i++) pthread_join(handle[i], NULL);
}

/* sigma: NULL, (batch, K) or (batch, K, NC); windows: one a thread; verdict (batch, 4) as octo_factor's */
void octo_factor_batch(int batch, int threads, int K, const double *H, const double *A, const double *sigma,
                       int per_variable, int stop, unit *units, double *store, window *windows, int *verdict) {
    job j = {.K = K, .per_variable = per_variable, .stop = stop, .H = H, .A = A, .sigma = sigma, .units = units,
             .store = store, .windows = windows, .verdict = verdict};
    spread(factor_member, &j, batch, threads);
}

/* f, dv (batch, K, NC, count), h, lam (batch, K, MA, count), sizes (batch, count); scratch: count rooms a thread */
void octo_solve_batch(int batch, int threads, int K, const double *H, const double *A, const double *sigma,
                      int per_variable, unit *units, double *store, int *verdict, int count, const double *f,
                      const double *h, int refine, double tolerance, int check, double *scratch, double *dv,
                      double *lam, double *sizes) {
    job j = {.K = K, .per_variable = per_variable, .count = count, .refine = refine, .check = check,
             .tolerance = tolerance, .H = H, .A = A, .sigma = sigma, .f = f, .h = h, .units = units, .store = store,
             .scratch = scratch, .dv = dv, .lam = lam, .sizes = sizes, .verdict = verdict};
    spread(solve_member, &j, batch, threads);
}
