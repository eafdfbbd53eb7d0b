/* Cholesky factors of the normal matrix N = A A' of the constraints; follows elimination.c (VL, ROUND, vec).
 *
 * A has block lags 0..2, so N has them too: N[k, k-o] = sum_b A[k, b+o] A[k-o, b]'. Rows of A are scaled to length 1
 * first. A row that depends on the rows before it leaves no pivot: it is dropped, its multiplier is 0.
 */
#define LN ROUND(NC, VL)             /* leading dimension of a scaled row of A */
#define MW (3 * MA)                  /* columns of a row of the factor: units k-2, k-1, k */
#define DROP 1e-13                   /* a pivot, of a diagonal of 1, below this is rounding */

typedef struct {
    double L[MA ? MA : 1][MA ? MW : 1];
    double inverse[MA ? MA : 1], scale[MA ? MA : 1];   /* 1 / L_ii, 0 where dropped; 1 / length of the row */
} normal_unit;

ptrdiff_t octo_normal_bytes(void) { return sizeof(normal_unit); }

#if MA > 0
typedef struct { _Alignas(64) double row[3][MA][LN]; } scaled_rows;

static double scale_rows(int k, const double *A, normal_unit *u, scaled_rows *to) {
    double odd = 0;
    for (int i = 0; i < MA; i++) {
        double sum = 0;
        for (int o = 0; o < 3; o++)
            for (int j = 0; j < LN; j++) {
                double a = j < NC && o <= k ? A[(o * MA + i) * NC + j] : 0;
                to->row[o][i][j] = a, sum += a * a;
            }
        odd += sum * 0.0;
        u->scale[i] = sum > 0 ? 1 / sqrt(sum) : 0;
        for (int o = 0; o < 3; o++)
            for (int j = 0; j < LN; j++) to->row[o][i][j] *= u->scale[i];
    }
    return odd;
}

/* row block k of N, lower triangle, in the columns of the factor */
static void normal_rows(int k, const scaled_rows *own, const scaled_rows *before, const scaled_rows *earlier,
                        double (*N)[MW]) {
    const scaled_rows *rows[3] = {own, before, earlier};
    for (int i = 0; i < MA; i++)
        for (int c = 0; c < 2 * MA + i + 1; c++) {
            int o = 2 - c / MA;
            vec acc = {0};
            for (int b = 0; b + o < 3 && o <= k; b++)
                for (int j = 0; j < LN; j += VL)
                    acc += *(const vec *)(own->row[b + o][i] + j) * *(const vec *)(rows[o]->row[b][c % MA] + j);
            double sum = 0;
            for (int j = 0; j < VL; j++) sum += acc[j];
            N[i][c] = sum;
        }
}

/* One member; returns the number of rows dropped, -1 where A is not finite. */
static int normal_factor(int K, const double *A, normal_unit *units) {
    scaled_rows ring[3];
    int dropped = 0;
    for (int k = 0; k < K; k++) {
        normal_unit *u = units + k;
        if (scale_rows(k, A + (ptrdiff_t)k * 3 * MA * NC, u, ring + k % 3) != 0) return -1;
        normal_rows(k, ring + k % 3, ring + (k + 2) % 3, ring + (k + 1) % 3, u->L);
        for (int i = 0; i < MA; i++) {
            double *own = u->L[i], pivot = own[2 * MA + i];
            for (int c = k < 2 ? (2 - k) * MA : 0; c < 2 * MA + i; c++) {
                int back = 2 - c / MA;                          /* column c is row c % MA of unit k - back */
                const double *row = u[-back].L[c % MA] + back * MA;
                double sum = own[c];
                for (int j = k < 2 ? (2 - k) * MA : 0; j < c; j++) sum -= own[j] * row[j];
                own[c] = sum * u[-back].inverse[c % MA];
                pivot -= own[c] * own[c];
            }
            int kept = pivot > DROP;
            dropped += !kept;
            own[2 * MA + i] = kept ? sqrt(pivot) : 0;
            u->inverse[i] = kept ? 1 / own[2 * MA + i] : 0;
        }
    }
    return dropped;
}

/* x (K, MA) = N^-1 x */
static void normal_sweeps(int K, const normal_unit *units, double *x) {
    for (int k = 0; k < K; k++)
        for (int i = 0; i < MA; i++) {
            const double *row = units[k].L[i], *past = x + (k - 2) * MA;
            double sum = x[k * MA + i] * units[k].scale[i];
            for (int c = k < 2 ? (2 - k) * MA : 0; c < 2 * MA + i; c++) sum -= row[c] * past[c];
            x[k * MA + i] = sum * units[k].inverse[i];
        }
    for (int k = K - 1; k >= 0; k--)
        for (int i = MA - 1; i >= 0; i--) {
            const double *row = units[k].L[i];
            double *past = x + (k - 2) * MA, own = x[k * MA + i] *= units[k].inverse[i];
            for (int c = k < 2 ? (2 - k) * MA : 0; c < 2 * MA + i; c++) past[c] -= row[c] * own;
            x[k * MA + i] *= units[k].scale[i];
        }
}

/* x = A' lam (K, NC), and r -= A x (K, MA) */
static void transposed_product(int K, const double *A, const double *lam, double *x) {
    memset(x, 0, (size_t)K * NC * sizeof(double));
    for (int k = 0; k < K; k++)
        for (int o = 0; o < 3 && o <= k; o++)
            for (int i = 0; i < MA; i++) {
                const double *row = A + ((ptrdiff_t)(k * 3 + o) * MA + i) * NC;
                for (int j = 0; j < NC; j++) x[(k - o) * NC + j] += row[j] * lam[k * MA + i];
            }
}

static void subtract_product(int K, const double *A, const double *x, double *r) {
    for (int k = 0; k < K; k++)
        for (int o = 0; o < 3 && o <= k; o++)
            for (int i = 0; i < MA; i++) {
                const double *row = A + ((ptrdiff_t)(k * 3 + o) * MA + i) * NC;
                double sum = 0;
                for (int j = 0; j < NC; j++) sum += row[j] * x[(k - o) * NC + j];
                r[k * MA + i] -= sum;
            }
}

/* One member and right-hand side: lam (K, MA) = N^-1 rhs, and x = A' lam (K, NC); room for K MA numbers in r. */
static void normal_solve(int K, const double *A, const normal_unit *units, const double *rhs, int refine, double *lam,
                         double *x, double *r) {
    memcpy(lam, rhs, (size_t)K * MA * sizeof(double));
    normal_sweeps(K, units, lam);
    transposed_product(K, A, lam, x);
    for (int step = 0; step < refine; step++) {                  /* the residual uses A itself: N squares its rounding */
        memcpy(r, rhs, (size_t)K * MA * sizeof(double));
        subtract_product(K, A, x, r);
        normal_sweeps(K, units, r);
        for (int i = 0; i < K * MA; i++) lam[i] += r[i];
        transposed_product(K, A, lam, x);
    }
}

typedef struct {
    int K, count, refine;
    const double *A, *rhs;
    normal_unit *units;
    int *dropped;
    double *lam, *x, *r;
} normal_job;

static void normal_factor_member(const void *shared, ptrdiff_t m, int worker) {
    const normal_job *j = shared;
    j->dropped[m] = normal_factor(j->K, j->A + m * j->K * 3 * MA * NC, j->units + m * j->K);
}

static void normal_solve_member(const void *shared, ptrdiff_t m, int worker) {
    const normal_job *j = shared;
    ptrdiff_t rows = (ptrdiff_t)j->K * MA, variables = (ptrdiff_t)j->K * NC;
    for (ptrdiff_t c = m * j->count; c < (m + 1) * j->count; c++) {
        double *lam = j->lam + c * rows, *x = j->x + c * variables;
        if (j->dropped[m] >= 0) {
            normal_solve(j->K, j->A + m * j->K * 3 * MA * NC, j->units + m * j->K, j->rhs + c * rows, j->refine, lam, x,
                         j->r + worker * rows);
            continue;
        }
        for (ptrdiff_t i = 0; i < rows; i++) lam[i] = NAN;      /* a factor that cannot solve says so */
        for (ptrdiff_t i = 0; i < variables; i++) x[i] = NAN;
    }
}

/* A (batch, K, 3, MA, NC); units (batch, K); dropped (batch) as normal_factor's */
void octo_normal_factor(int batch, int threads, int K, const double *A, normal_unit *units, int *dropped) {
    normal_job j = {.K = K, .A = A, .units = units, .dropped = dropped};
    octo_parallel_for_workers(normal_factor_member, &j, batch, threads);
}

/* rhs, lam (batch, count, K, MA), x = A' lam (batch, count, K, NC); r (K, MA) a thread is scratch */
void octo_normal_solve(int batch, int threads, int K, const double *A, normal_unit *units, int *dropped, int count,
                       const double *rhs, int refine, double *lam, double *x, double *r) {
    normal_job j = {.K = K, .count = count, .refine = refine, .A = A, .rhs = rhs, .units = units, .dropped = dropped,
                    .lam = lam, .x = x, .r = r};
    octo_parallel_for_workers(normal_solve_member, &j, batch, threads);
}
#endif
