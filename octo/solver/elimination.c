/* Window elimination of the KKT matrix [[H + diag(sigma), A'], [A, 0]], units k = K-1 ... 0.
 *
 * The window is s = (v_{k-1}, v_{k-2}) and v = v_k, columns [s | v]. Unit k's rows, and rows carried from later
 * units, are solved for r of v's variables (LU with complete pivoting): v_B = T [s | v_N] + t. What has no pivot in
 * v is carried on. The Hessian is reduced by that substitution, P' = P + T'Y + Y'T with Y = P_B + P_BB T / 2, and
 * v_N is eliminated by signed Cholesky: its pivots are those of the reduced Hessian, so the inertia of the KKT matrix
 * is right exactly when all of them are positive. Columns are never permuted: T has zeros in its own columns B.
 *
 * Compiled with -DNC (variables a unit) and -DMA (rows a unit).
 */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
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
#define ROWS (CARRY + MA)
#define ROW_TOLERANCE 1e-12          /* of a row scaled to largest entry 1 */
#define PIVOT_TOLERANCE 1e-14        /* of the reduced diagonal entry before elimination */

typedef double vec __attribute__((vector_size(8 * VL), may_alias));
typedef double loose __attribute__((vector_size(8 * VL), aligned(8), may_alias));
typedef long long bits __attribute__((vector_size(8 * VL), may_alias));

typedef struct {
    int rank, rows, carried_in, carried_out;
    int column[NC];                  /* B in pivot order, then N in elimination order */
    int row[ROWS];                   /* active rows (carried first, then own): pivot rows in order, then carried out */
    ptrdiff_t at;                    /* offset of this unit's numbers */
    double sign[NC];
    double scale[MA ? MA : 1];       /* own rows are multiplied by this power of two */
} unit;

/* numbers of a unit: Y (r x LD), T (r x LD), U (n x LD), 1/sqrt|d| (n), P_BB (r x r), L\U (rows x r) */
#define ROOM(r, rows) ROUND((ptrdiff_t)(NC + (r)) * LD + NC + (r) * (r) + (rows) * (r), VL)

typedef struct {
    _Alignas(64) double P[NC][LD];
    _Alignas(64) double R[2][ROWS][LD];
    _Alignas(64) double S[3][LS][LS];
    _Alignas(64) double X[2 * NC][LS];
    _Alignas(64) double W[ROUND(NC, TILE_ROWS)][LD];
    double L[ROWS][NC], peak[ROWS];
} window;

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
static double gather_hessian(int k, const double *H, const double *sigma, int per_variable, const double (*S1)[LS],
                             const double (*S2)[LS], double (*P)[LD]) {
    vec odd = {0};
    for (int i = 0; i < NC; i++) {
        double *row = P[i];
        const double *h0 = H + i * NC, *h1 = h0 + NC * NC, *h2 = h1 + NC * NC;
        for (int j = 0; j < NC; j++) row[j] = k > 0 ? h1[j] + S1[i][NC + j] : 0;
        for (int j = 0; j < NC; j++) row[NC + j] = k > 1 ? h2[j] : 0;
        for (int j = 0; j < i; j++) row[SC + j] = P[j][SC + i];
        for (int j = i; j < NC; j++) row[SC + j] = h0[j] + S1[i][j] + S2[NC + i][NC + j];
        for (int j = 3 * NC; j < LD; j++) row[j] = 0;
        row[SC + i] += sigma ? sigma[per_variable ? i : 0] : 0;
        for (int j = 0; j < LV; j++) odd += *(vec *)(row + j * VL) * 0.0;
    }
    double sum = 0;
    for (int i = 0; i < VL; i++) sum += odd[i];
    return sum;
}

/* rows carried from unit k+1 (their s is now [v | first half of s]) followed by A_k, scaled */
static double gather_rows(int k, const double *A, const double (*carried)[LD], const int *which, unit *u,
                          double (*R)[LD], double *peak) {
    double odd = 0;
    for (int i = 0; i < u->carried_in; i++) {
        const double *from = carried[which[i]];
        for (int j = 0; j < NC; j++) R[i][j] = from[NC + j];
        for (int j = 0; j < NC; j++) R[i][NC + j] = 0;
        for (int j = 0; j < NC; j++) R[i][SC + j] = from[j];
        for (int j = 3 * NC; j < LD; j++) R[i][j] = 0;
        peak[i] = largest(R[i], SC);
    }
    for (int i = 0; i < MA; i++) {
        double *row = R[u->carried_in + i];
        const double *a0 = A + i * NC, *a1 = a0 + MA * NC, *a2 = a1 + MA * NC;
        for (int j = 0; j < NC; j++) row[j] = k > 0 ? a1[j] : 0;
        for (int j = 0; j < NC; j++) row[NC + j] = k > 1 ? a2[j] : 0;
        for (int j = 0; j < NC; j++) row[SC + j] = a0[j];
        for (int j = 3 * NC; j < LD; j++) row[j] = 0;
        double top = largest(row, 0);
        int exponent = 0;
        frexp(top, &exponent);
        u->scale[i] = top > 0 && top < INFINITY ? ldexp(1.0, -exponent) : 1.0;
        for (int j = 0; j < LV; j++) *(vec *)(row + j * VL) *= u->scale[i];
        for (int j = 0; j < 3 * NC; j++) odd += row[j] * 0.0;
        peak[u->carried_in + i] = largest(row, SC);
    }
    return odd;
}

/* LU with complete pivoting over v's columns; leaves R's pivot rows as T, writes L\U; returns rows found dependent */
static int eliminate_rows(unit *u, double (*R)[LD], double (*L)[NC], double *peak, double *T, double *LU) {
    int rows = u->rows, rank = 0, dependent = 0;
    char taken[NC] = {0};
    for (int i = 0; i < rows; i++) u->row[i] = i;
    for (; rank < rows && rank < NC; rank++) {
        int best = rank;
        for (int i = rank + 1; i < rows; i++)
            if (peak[u->row[i]] > peak[u->row[best]]) best = i;
        int pivot_row = u->row[best], column = -1;
        if (!(peak[pivot_row] > ROW_TOLERANCE)) break;
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

/* One member. verdict: negative pivots, first bad unit or -1, dependent rows, 1 where the factor can solve. */
void octo_factor(int K, const double *H, const double *A, const double *sigma, int per_variable, int stop, unit *units,
                 double *store, window *w, int *verdict) {
    int negative = 0, bad = -1, dependent = 0, usable = 1, carried = 0;
    ptrdiff_t at = 0;
    const int *which = NULL;
    memset(w->S, 0, sizeof w->S);
    for (int k = K - 1; k >= 0; k--) {
        unit *u = units + k;
        double(*R)[LD] = w->R[k & 1], *numbers = store + at;
        u->carried_in = carried, u->rows = carried + MA, u->at = at;
        const double *weight = sigma ? sigma + (per_variable ? NC * k : k) : NULL;
        double odd = gather_hessian(k, H + (ptrdiff_t)k * 3 * NC * NC, weight, per_variable, w->S[(k + 1) % 3],
                                    w->S[(k + 2) % 3], w->P);
        odd += gather_rows(k, A + (ptrdiff_t)k * 3 * MA * NC, w->R[~k & 1], which, u, R, w->peak);
        /* T and L\U first land in scratch places of the full size, the rank is not known yet */
        double *T = w->W[0], *LU = w->X[0];
        dependent += eliminate_rows(u, R, w->L, w->peak, T, LU);
        int r = u->rank, found;
        at += ROOM(r, u->rows);
        double *inverse = numbers + (ptrdiff_t)(NC + r) * LD, *PBB = inverse + NC;
        memcpy(numbers + r * LD, T, (size_t)r * LD * sizeof(double));
        memcpy(PBB + r * r, LU, (size_t)u->rows * r * sizeof(double));
        substitute(u, numbers, PBB, w);
        found = odd == 0 ? eliminate_variables(u, numbers + 2 * r * LD, inverse, w, stop) : -1;
        if (found != 0 && bad < 0) bad = k;
        if (found < 0) {
            negative++, usable = 0;
            break;
        }
        negative += found;
        complement(u, numbers, w, w->S[k % 3]);
        which = u->row + r, carried = u->carried_out;
    }
    verdict[0] = negative, verdict[1] = bad, verdict[2] = dependent + (usable ? carried : 0), verdict[3] = usable;
}
