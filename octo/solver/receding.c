/* One problem over and over, eliminated in two goes: what does not depend on the measurement, then the rest. Its text follows
 * that of elimination_solve.c.
 *
 * Units below `past` are measured, not solved for: their steps are zero, and the pivots of unit `past` give the first
 * planned configuration as a linear function of them. */

typedef struct {
    factoring factor;
    solving solve;
    int past;
} receding;

ptrdiff_t octo_receding_bytes(void) { return sizeof(receding); }

void octo_receding_start(receding *r, int K, int past, const double *H, const double *A, const double *sigma, unit *units,
                         double *store, window *windows, double *scratch) {
    r->past = past;
    r->factor = (factoring){.K = K, .H = H, .A = A, .sigma = sigma, .stop = 1, .units = units, .store = store, .windows = windows};
    r->solve = (solving){.K = K, .count = 1, .H = H, .A = A, .sigma = sigma, .units = units, .store = store, .scratch = scratch};
}

/* Units from ... to, with the right-hand side [-b; -c]; 1 where all their pivots are positive. From the last unit on it
 * begins anew. */
int octo_receding_eliminate(receding *r, int from, int to, const double *b, const double *c) {
    factoring *f = &r->factor;
    double *F = residual_of(&r->solve, 0), *G = F + f->K * NC;
    if (from == f->K - 1) {
        memset(f->windows->S, 0, sizeof f->windows->S);
        memset(sweep_of(&r->solve, 0, 0), 0, sizeof(sweep));
        f->side[0] = (progress){.bad = -1, .usable = 1};
    }
    for (int k = from; k >= to && f->side[0].usable; k--) {
        for (int j = k * NC; j < (k + 1) * NC; j++) F[j] = -b[j];
        for (int j = k * MA; j < (k + 1) * MA; j++) G[j] = -c[j];
        if (eliminate_unit(f, k, 0)) down_unit(&r->solve, k, 0);
    }
    return f->side[0].usable;
}

/* dv (K, NC) and lam (K, MA); zero for the measured units */
void octo_receding_solve(receding *r, double *dv, double *lam) {
    solving *s = &r->solve;
    double *V = answer_of(s, 0);
    s->correction = 0;
    memset(V, 0, (size_t)s->K * (NC + MA) * sizeof(double));
    for (int k = r->past; k < s->K; k++) up_unit(s, k, 0);
    memcpy(dv, V, (size_t)s->K * NC * sizeof(double));
    memcpy(lam, V + s->K * NC, (size_t)s->K * MA * sizeof(double));
}

/* (NC, 2 NC) d v_past / d (v_{past-1}, v_{past-2}) */
void octo_receding_gain(receding *r, double *gain) {
    const unit *u = r->solve.units + r->past;
    const double *T = r->solve.store + u->at + u->rank * LD, *U = T + u->rank * LD;
    int n = NC - u->rank;
    const double *inverse = U + n * LD;
    _Alignas(64) double z[LD];
    for (int c = 0; c < SC; c++) {
        memset(z, 0, sizeof z);
        z[c] = 1;
        for (int p = n - 1; p >= 0; p--)
            z[SC + u->column[u->rank + p]] = -u->sign[p] * dot(U + p * LD, z) * inverse[p];
        double pivots[NC];
        for (int a = 0; a < u->rank; a++) pivots[a] = dot(T + a * LD, z);
        for (int a = 0; a < u->rank; a++) z[SC + u->column[a]] = pivots[a];
        for (int i = 0; i < NC; i++) gain[i * SC + c] = z[SC + i];
    }
}
