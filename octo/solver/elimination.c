/* Window elimination of the KKT matrix [[H + diag(sigma), A'], [A, 0]], units k = K-1 ... 0.
 *
 * The window is s = (v_{k-1}, v_{k-2}) and v = v_k, columns [s | v]. Unit k's rows, and rows carried from later
 * units, are solved for r of v's variables (LU with complete pivoting): v_B = T [s | v_N] + t. What has no pivot in
 * v is carried on. The Hessian is reduced by that substitution, P' = P + T'Y + Y'T with Y = P_B + P_BB T / 2, and
 * v_N is eliminated by signed Cholesky: its pivots are those of the reduced Hessian, so the inertia of the KKT matrix
 * is right exactly when all of them are positive. Columns are never permuted: T has zeros in its own columns B.
 *
 * Two threads share one problem from both ends (split > 0): one eliminates units K-1 ... split+2 as above, the other
 * units 0 ... split-1 forward in time, the window then being s = (v_{k+1}, v_{k+2}); rows belong to the thread whose
 * units they touch first. Units split+1 and split, with what both left, come last.
 *
 * Compiled with -DNC (variables a unit) and -DMA (rows a unit).
 */
#include <math.h>
#include <string.h>

#ifdef __AVX512F__
#define VL 8
#define TILE_ROWS 8
#else
#define VL 4
#define TILE_ROWS 4
#endif
#define TILE_VECS 3
#define ROUND(n, to) (((n) + (to)-1) / (to) * (to))
#define SC (2 * NC)                  /* columns of s */
#define LD ROUND(3 * NC, VL)         /* leading dimension of window rows */
#define LV (LD / VL)
#define LS ROUND(SC, TILE_ROWS)      /* leading dimension of the Schur complement onto s */
#define CARRY SC                     /* more carried rows than columns of s are dependent */
#define ROWS (2 * CARRY + MA)        /* rows of a unit: carried from both sides, or carried and own */
#define OWN (3 * MA)                 /* own rows: MA, at the first unit forward those of three row blocks */
#define ROW_TOLERANCE 1e-12          /* of a row scaled to largest entry 1 */
/* Of a row's largest entry: with a smaller pivot in v, its square outweighs the rest of the Hessian by more than a double
 * holds, and the inertia is lost (rows of three steps before a fixed end, or at the fold of a cycle, are almost dependent
 * in v). The row is carried on without what it has in v; refinement mends what that changed. */
#define SMALL_PIVOT 1e-6
#define PIVOT_TOLERANCE 1e-14        /* of the reduced diagonal entry before elimination */

typedef double vec __attribute__((vector_size(8 * VL), may_alias));
typedef double loose __attribute__((vector_size(8 * VL), aligned(8), may_alias));
typedef long long bits __attribute__((vector_size(8 * VL), may_alias));

typedef struct {
    int rank, rows, carried_in, carried_out;
    int first_row;                   /* own rows are first_row, first_row + 1, ... of the K MA rows of A */
    int column[NC];                  /* B in pivot order, then N in elimination order */
    int row[ROWS];                   /* active rows (carried first, then own): pivot rows in order, then carried out */
    ptrdiff_t at;                    /* offset of this unit's numbers */
    double sign[NC];
    double scale[MA ? OWN : 1];      /* own rows are multiplied by this power of two */
} unit;

/* numbers of a unit: Y (r x LD), T (r x LD), U (n x LD), 1/sqrt|d| (n), P_BB (r x r), L\U (rows x r) */
#define ROOM(r, rows) ROUND((ptrdiff_t)(NC + (r)) * LD + NC + (r) * (r) + (rows) * (r), VL)

typedef struct {
    _Alignas(64) double P[NC][LD];
    _Alignas(64) double R[2][ROWS][LD];
    _Alignas(64) double S[3][LS][LS];
    _Alignas(64) double X[2 * NC][LS];
    _Alignas(64) double W[ROUND(NC, TILE_ROWS)][LD];
    double L[ROWS][NC], LU[ROWS * NC], peak[ROWS];
} window;

/* one direction's state between units; side 0 goes backward in time, side 1 forward */
typedef struct {
    int negative, bad, dependent, usable, carried;
    const int *which;                /* carried rows, in the window's R of the last unit */
    ptrdiff_t at;
} progress;

typedef struct {
    int K, split, per_variable, stop;
    const double *H, *A, *sigma;
    unit *units;
    double *store;
    window *windows;                 /* one a side */
    progress side[2];
} factoring;

ptrdiff_t octo_unit_bytes(void) { return sizeof(unit); }
ptrdiff_t octo_window_bytes(void) { return sizeof(window); }
ptrdiff_t octo_unit_room(void) { return ROOM(NC, ROWS); }

static inline __attribute__((always_inline)) double largest(const double *row, int first) {
    const bits positive = (bits){0} + 0x7fffffffffffffffLL;      /* of positive doubles the order is that of integers */
    bits top = {0};
    for (int j = first / VL; j < LV; j++) {
        bits a = *(const bits *)(row + j * VL) & positive;
        if (j == first / VL && first % VL)
            for (int i = 0; i < first % VL; i++) a[i] = 0;
        for (int i = 0; i < VL; i++) top[i] = a[i] > top[i] ? a[i] : top[i];
    }
    long long best = 0;
    for (int i = 0; i < VL; i++) best = top[i] > best ? top[i] : best;
    double value;
    memcpy(&value, &best, sizeof value);
    return value;
}

/* C (rows x vecs) (+)= sum_p x[p][rows] z[p][vecs] with the accumulators in registers */
static inline __attribute__((always_inline)) void tile(int rows, int vecs, int load, int rank, const double *x, int lx,
                                                       const double *z, double *c, int lc) {
    vec acc[TILE_ROWS][TILE_VECS];
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < vecs; j++) acc[i][j] = load ? *(const vec *)(c + i * lc + j * VL) : (vec){0};
    for (int p = 0; p < rank; p++, x += lx, z += LD) {
        vec line[TILE_VECS];
        for (int j = 0; j < vecs; j++) line[j] = *(const vec *)(z + j * VL);
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < vecs; j++) acc[i][j] += x[i] * line[j];
    }
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < vecs; j++) *(vec *)(c + i * lc + j * VL) = acc[i][j];
}

static __attribute__((noinline)) void strip(int vecs, int load, int rank, const double *x, int lx, const double *z,
                                            double *c, int lc) {
    for (; vecs >= 3; vecs -= 3, z += 3 * VL, c += 3 * VL)
        if (load) tile(TILE_ROWS, 3, 1, rank, x, lx, z, c, lc);
        else tile(TILE_ROWS, 3, 0, rank, x, lx, z, c, lc);
    if (vecs == 2) {
        if (load) tile(TILE_ROWS, 2, 1, rank, x, lx, z, c, lc);
        else tile(TILE_ROWS, 2, 0, rank, x, lx, z, c, lc);
    } else if (vecs == 1) {
        if (load) tile(TILE_ROWS, 1, 1, rank, x, lx, z, c, lc);
        else tile(TILE_ROWS, 1, 0, rank, x, lx, z, c, lc);
    }
}

/* P = [P_{v,s} | P_{v,v}] of unit k: blocks of H, sigma, and the two Schur complements that reach v_k */
static double gather_hessian(const factoring *f, int k, int side, const double (*S1)[LS], const double (*S2)[LS],
                             double (*P)[LD]) {
    vec odd = {0};
    const double *h = f->H + (ptrdiff_t)k * 3 * NC * NC, *h1 = h + (side ? 4 : 1) * NC * NC, *h2 = h + (side ? 8 : 2) * NC * NC;
    const double *sigma = f->sigma ? f->sigma + (f->per_variable ? NC * k : k) : NULL;
    int one = side || k > f->split, two = side || k > f->split + 1, across = side ? NC : 1, along = side ? 1 : NC;
    for (int i = 0; i < NC; i++) {                    /* forward in time the couplings are those of later units, turned */
        double *row = P[i];
        for (int j = 0; j < NC; j++) row[j] = one ? h1[i * along + j * across] + S1[i][NC + j] : 0;
        for (int j = 0; j < NC; j++) row[NC + j] = two ? h2[i * along + j * across] : 0;
        for (int j = 0; j < i; j++) row[SC + j] = P[j][SC + i];
        for (int j = i; j < NC; j++) row[SC + j] = h[i * NC + j] + S1[i][j] + S2[NC + i][NC + j];
        for (int j = 3 * NC; j < LD; j++) row[j] = 0;
        row[SC + i] += sigma ? sigma[f->per_variable ? i : 0] : 0;
        for (int j = 0; j < LV; j++) odd += *(vec *)(row + j * VL) * 0.0;
    }
    double sum = 0;
    for (int i = 0; i < VL; i++) sum += odd[i];
    return sum;
}

/* what side 1 left on units split and split+1 */
static void merge_hessian(const factoring *f, int k, double (*P)[LD]) {
    const double(*last)[LS] = f->windows[1].S[(f->split + 2) % 3], (*before)[LS] = f->windows[1].S[(f->split + 1) % 3];
    for (int i = 0; i < NC; i++)
        for (int j = 0; j < NC; j++) {
            int low = i < j ? i : j, high = i < j ? j : i;
            if (k > f->split) P[i][j] += last[j][NC + i];
            P[i][SC + j] += k > f->split ? last[NC + low][NC + high] : last[low][high] + before[NC + low][NC + high];
        }
}

/* a row over s = (a, b) of the unit before becomes one over v = a and the first half of s = b, or the reverse */
static void carry_row(const double *from, int v, double *to) {
    for (int j = 0; j < NC; j++) to[j] = from[NC - v + j];
    for (int j = 0; j < NC; j++) to[NC + j] = 0;
    for (int j = 0; j < NC; j++) to[SC + j] = from[v + j];
    for (int j = 3 * NC; j < LD; j++) to[j] = 0;
}

/* row q of A, scaled by a power of two, in the columns of unit k's window */
static double gather_row(const factoring *f, int k, int side, int q, double *row, double *scale) {
    double odd = 0;
    int block = MA ? q / MA : 0, lag = side ? block - k : 0;
    static const int place[3] = {SC, 0, NC};
    for (int j = 0; j < 3; j++, lag += side ? -1 : 1) {
        int there = lag >= 0 && lag < 3 && lag <= block;
        const double *from = f->A + ((ptrdiff_t)(3 * block + (there ? lag : 0)) * MA + (MA ? q % MA : 0)) * NC;
        for (int i = 0; i < NC; i++) row[place[j] + i] = there ? from[i] : 0;
    }
    for (int j = 3 * NC; j < LD; j++) row[j] = 0;
    double top = largest(row, 0);
    int exponent = 0;
    frexp(top, &exponent);
    *scale = top > 0 && top < INFINITY ? ldexp(1.0, -exponent) : 1.0;
    for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) *= *scale;
    for (int j = 0; j < 3 * NC; j++) odd += row[j] * 0.0;
    return odd;
}

/* rows carried from the unit before, at unit split+1 those that side 1 carried, and own rows; not 0: not finite */
static double gather_rows(const factoring *f, int k, int side, unit *u, window *w) {
    const progress *own = f->side + side, *other = f->side + 1;
    double odd = 0, (*R)[LD] = w->R[k & 1];
    int merging = f->split > 0 && side == 0 && k <= f->split + 1, from_other = merging && k > f->split ? other->carried : 0;
    u->carried_in = own->carried + from_other;
    u->first_row = side == 0 ? k * MA : k == 0 ? 0 : (k + 2) * MA;
    u->rows = u->carried_in + (merging ? 0 : side && k == 0 ? OWN : MA);
    for (int i = 0; i < own->carried; i++) carry_row(w->R[~k & 1][own->which[i]], 0, R[i]);
    for (int i = 0; i < from_other; i++)
        carry_row(f->windows[1].R[(f->split - 1) & 1][other->which[i]], NC, R[own->carried + i]);
    for (int i = u->carried_in; i < u->rows; i++)
        odd += gather_row(f, k, side, u->first_row + i - u->carried_in, R[i], u->scale + i - u->carried_in);
    for (int i = 0; i < u->rows; i++) w->peak[i] = largest(R[i], SC);
    return odd;
}

/* LU with complete pivoting over v's columns; leaves R's pivot rows as T, writes L\U; returns rows found dependent */
static int eliminate_rows(unit *u, double (*R)[LD], double (*L)[NC], double *peak, double *T, double *LU) {
    int rows = u->rows, rank = 0, dependent = 0;
    char taken[NC] = {0};
    for (int i = 0; i < rows; i++) u->row[i] = i;
    while (rank < rows && rank < NC) {
        int best = rank;
        for (int i = rank + 1; i < rows; i++)
            if (peak[u->row[i]] > peak[u->row[best]]) best = i;
        int pivot_row = u->row[best], column = -1;
        if (!(peak[pivot_row] > ROW_TOLERANCE)) break;
        if (!(peak[pivot_row] > SMALL_PIVOT * largest(R[pivot_row], 0))) {
            peak[pivot_row] = 0;                                /* almost dependent here: for an earlier unit */
            continue;
        }
        const double *top = R[pivot_row];
        for (int j = 0; j < NC && column < 0; j++)
            if (fabs(top[SC + j]) >= peak[pivot_row] && !taken[j]) column = j;
        if (column < 0) break;
        u->row[best] = u->row[rank], u->row[rank] = pivot_row;
        u->column[rank] = column, taken[column] = 1;
        double inverse = 1 / top[SC + column];
        for (int i = rank + 1; i < rows; i++) {
            double *row = R[u->row[i]], factor = row[SC + column] * inverse;
            L[u->row[i]][rank] = factor;
            if (factor == 0) continue;
            for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) -= factor * *(const vec *)(top + j * VL);
            row[SC + column] = 0;
            peak[u->row[i]] = largest(row, SC);
        }
        rank++;
    }
    u->rank = rank;
    for (int j = 0, n = rank; j < NC; j++)
        if (!taken[j]) u->column[n++] = j;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < rank; j++)
            LU[i * rank + j] = i > j ? L[u->row[i]][j] : R[u->row[i]][SC + u->column[j]];
    for (int p = rank - 1; p >= 0; p--) {                       /* T = -(L U)^-1 R, own columns zero */
        double *row = T + p * LD, inverse = -1 / LU[p * rank + p];
        const double *from = R[u->row[p]];
        for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) = *(const vec *)(from + j * VL) * inverse;
        for (int q = p + 1; q < rank; q++)
            for (int j = 0; j < LV; j++)
                *(vec *)(row + j * VL) += LU[p * rank + q] * inverse * *(vec *)(T + q * LD + j * VL);
        for (int q = 0; q < rank; q++) row[SC + u->column[q]] = 0;
    }
    int kept = rank;
    for (int i = rank; i < rows; i++) {                         /* rows with nothing left are dependent */
        int row = u->row[i];
        if (kept - rank < CARRY && largest(R[row], 0) > ROW_TOLERANCE) {
            for (int j = 0; j < rank && kept != i; j++) {
                double held = LU[kept * rank + j];
                LU[kept * rank + j] = LU[i * rank + j], LU[i * rank + j] = held;
            }
            u->row[i] = u->row[kept], u->row[kept++] = row;
        } else dependent++;
    }
    u->carried_out = kept - rank;
    return dependent;
}

/* Y = P_B + P_BB T / 2 and the rows N of P' = P + T'Y + Y'T, gathered in W */
static void substitute(const unit *u, double *numbers, double *PBB, window *w) {
    int r = u->rank, n = NC - r;
    double *Y = numbers, *T = numbers + r * LD;
    for (int a = 0; a < r; a++) {
        const double *from = w->P[u->column[a]];
        vec acc[LV];
        for (int j = 0; j < LV; j++) acc[j] = *(const vec *)(from + j * VL);
        for (int b = 0; b < r; b++) {
            double half = 0.5 * (PBB[a * r + b] = from[SC + u->column[b]]);
            for (int j = 0; j < LV; j++) acc[j] += half * *(const vec *)(T + b * LD + j * VL);
        }
        for (int j = 0; j < LV; j++) *(vec *)(Y + a * LD + j * VL) = acc[j];
    }
    for (int i = 0; i < n; i++) memcpy(w->W[i], w->P[u->column[r + i]], sizeof w->W[i]);
    for (int p = 0; p < r; p++)
        for (int i = 0; i < n; i++) {
            w->X[p][i] = T[p * LD + SC + u->column[r + i]];
            w->X[r + p][i] = Y[p * LD + SC + u->column[r + i]];
        }
    for (int i = 0; i < n && r > 0; i += TILE_ROWS) strip(LV, 1, 2 * r, w->X[0] + i, LS, numbers, w->W[i], LD);
}

/* W = U'DU row by row, U into the unit; returns the number of negative pivots, -1 at a pivot that cannot be used */
static int eliminate_variables(unit *u, double *U, double *inverse, const window *w, int stop) {
    int r = u->rank, n = NC - r, negative = 0;
    for (int q = 0; q < n; q++) {
        int own = SC + u->column[r + q];
        double diagonal = w->W[q][own], before = w->P[u->column[r + q]][own];
        vec acc[LV];
        for (int j = 0; j < LV; j++) acc[j] = *(const vec *)(w->W[q] + j * VL);
        for (int p = 0; p < q; p++) {
            const double *row = U + p * LD;
            double factor = u->sign[p] * row[own];
            for (int j = 0; j < LV; j++) acc[j] -= factor * *(const vec *)(row + j * VL);
        }
        double *row = U + q * LD;
        for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) = acc[j];
        double pivot = row[own], scale = fmax(fabs(diagonal), fabs(before));
        if (!(fabs(pivot) > PIVOT_TOLERANCE * scale)) return -1;
        if (pivot < 0) negative++;
        if (pivot < 0 && stop) return -1;
        u->sign[q] = pivot < 0 ? -1 : 1;
        inverse[q] = 1 / sqrt(fabs(pivot));
        for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) *= inverse[q];
    }
    return negative;
}

/* upper half of S = T'Y + Y'T - U'DU over the columns of s */
static void complement(const unit *u, const double *numbers, window *w, double (*S)[LS]) {
    int r = u->rank, n = NC - r;
    for (int p = 0; p < r; p++) {
        memcpy(w->X[p], numbers + (r + p) * LD, sizeof w->X[p]);
        memcpy(w->X[r + p], numbers + p * LD, sizeof w->X[p]);
    }
    for (int p = 0; p < n; p++) {
        const double *row = numbers + (2 * r + p) * LD;
        for (int j = 0; j < LS; j += VL) *(vec *)(w->X[2 * r + p] + j) = -u->sign[p] * *(const vec *)(row + j);
    }
    for (int i = 0; i < LS; i += TILE_ROWS) strip((LS - i) / VL, 0, NC + r, w->X[0] + i, LS, numbers + i, S[i] + i, LS);
}

/* one unit of one side; 0 when the side cannot go on */
static int eliminate_unit(factoring *f, int k, int side) {
    unit *u = f->units + k;
    window *w = f->windows + side;
    progress *p = f->side + side;
    double *numbers = f->store + p->at;
    int toward = side ? -1 : 1;                       /* the unit before this one in the order of elimination */
    double odd = gather_hessian(f, k, side, w->S[(k + toward + 3) % 3], w->S[(k + 2 * toward + 3) % 3], w->P);
    if (f->split > 0 && side == 0 && k <= f->split + 1) merge_hessian(f, k, w->P);
    odd += gather_rows(f, k, side, u, w);
    /* T and L\U first land in scratch places of the full size, the rank is not known yet */
    p->dependent += eliminate_rows(u, w->R[k & 1], w->L, w->peak, w->W[0], w->LU);
    int r = u->rank;
    u->at = p->at, p->at += ROOM(r, u->rows);
    double *inverse = numbers + (ptrdiff_t)(NC + r) * LD, *PBB = inverse + NC;
    memcpy(numbers + r * LD, w->W[0], (size_t)r * LD * sizeof(double));
    memcpy(PBB + r * r, w->LU, (size_t)u->rows * r * sizeof(double));
    substitute(u, numbers, PBB, w);
    int found = odd == 0 ? eliminate_variables(u, numbers + 2 * r * LD, inverse, w, f->stop) : -1;
    if (found != 0 && p->bad < 0) p->bad = k;
    p->negative += found < 0 ? 1 : found;
    p->usable = found >= 0;
    if (!p->usable) return 0;
    complement(u, numbers, w, w->S[k % 3]);
    p->which = u->row + r, p->carried = u->carried_out;
    return 1;
}

static void factor_side(void *shared, int side) {
    factoring *f = shared;
    memset(f->windows[side].S, 0, sizeof f->windows[side].S);
    f->side[side] = (progress){.bad = -1, .usable = 1, .at = side ? (f->K - f->split) * ROOM(NC, ROWS) : 0};
    if (side)
        for (int k = 0; k < f->split && eliminate_unit(f, k, 1); k++) {}
    else
        for (int k = f->K - 1; k >= (f->split ? f->split + 2 : 0) && eliminate_unit(f, k, 0); k--) {}
}

/* One member, the companion taking the first `split` units. verdict: negative pivots, a bad unit (the first one
 * eliminated of side 0, else of side 1) or -1, dependent rows, 1 where the factor can solve. */
static void octo_factor(factoring *f, companion *c, int *verdict) {
    progress *back = f->side, *forward = f->side + 1;
    both(c, factor_side, f);
    if (f->split && back->usable && forward->usable)
        for (int k = f->split + 1; k >= f->split && eliminate_unit(f, k, 0); k--) {}
    verdict[0] = back->negative + forward->negative;
    verdict[1] = back->bad >= 0 ? back->bad : forward->bad;
    verdict[3] = back->usable && forward->usable;
    verdict[2] = back->dependent + forward->dependent + (verdict[3] ? back->carried : 0);
}
