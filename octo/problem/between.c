/* Terms over neighbouring Hermite controls r(c_k, c_{k+1}), one segment of steps between them: the mathematics of
 * neighbours.py. After assemble.c and the terms' generated text (between.py). */

/* One call: unit k of the task is c_{k+1}; controls (batch, units, BC) are c_0 … c_Z, what is pinned included. */
typedef struct { const octo_task *task; const double *controls; const int *fixed; } octo_between_call;

/* What the square of a term of E is multiplied with: the sum over the steps of a segment, whose last row of q is given. */
static double octo_between_weight(int length, const double *q, int term) {
  double sum = 0.0;
  for (int step = length - 1; step >= 0; --step) sum += q[term - step * BQ];
  return sum;
}

/* The terms' share of E, at the last step of each segment. */
static void octo_between_values_of(void *shared, int member) {
  const octo_between_call *call = shared;
  const octo_task *t = call->task;
  int segments = t->units - 1, length = t->steps / segments;
  for (int z = 0; z < segments; ++z) {
    size_t last = (size_t)member * t->steps + (z + 1) * length - 1;
    const double *c = call->controls + ((size_t)member * t->units + z) * BC, *q = t->q + last * BQ;
    for (int k = 0; k < BETWEEN; ++k) {
      double r[BR + 1], sum = 0.0, weight = octo_between_weight(length, q, octo_between_term[k]);
      octo_between(k, (const double *[]){c, c + BC, q}, (double *[]){r});
      for (int row = 0; weight != 0.0 && row < octo_between_first_row[k + 1] - octo_between_first_row[k]; ++row) sum += r[row] * r[row];
      t->terms[last * BTERM + octo_between_term[k]] = weight * sum;
    }
  }
}

/* h and b of segment z += a row's square, times ``twice``: value, and slopes by the entries of the row. */
static void octo_between_square(const octo_between_call *call, int member, int z, int row, double twice, double value, const double *slopes) {
  const octo_task *t = call->task;
  size_t first = (size_t)member * t->units + z; /* of c_{z+1}; c_z is the unit before */
  for (int e = octo_between_row_start[row]; e < octo_between_row_start[row + 1]; ++e) {
    int a = octo_between_entry_column[octo_between_row_entry[e]], newer = a >= BC, unit = z - !newer;
    if (unit < 0 || call->fixed[unit]) continue;
    double slope = twice * slopes[octo_between_row_entry[e]];
    t->b[(first - !newer) * t->nc + a % BC] += slope * value;
    if (!t->h) continue;
    for (int o = octo_between_row_start[row]; o < octo_between_row_start[row + 1]; ++o) {
      int b = octo_between_entry_column[octo_between_row_entry[o]], lag = newer && b < BC;
      if ((b >= BC && !newer) || (lag && (z == 0 || call->fixed[z - 1]))) continue;
      t->h[(((first - !newer) * 3 + lag) * t->nc + a % BC) * t->nc + b % BC] += slope * slopes[octo_between_row_entry[o]];
    }
  }
}

#ifdef BENT
/* h of segment z += 2 Σ r ∂²r of the exact terms. */
static void octo_between_bend(const octo_between_call *call, int member, int z, int length, const double **arg) {
  const octo_task *t = call->task;
  double made[BS], *h = t->h + ((size_t)member * t->units + z) * 3 * t->nc * t->nc;
  int older = z == 0 || call->fixed[z - 1], newer = call->fixed[z];
  for (int k = 0; k < BENT; ++k) {
    double weight = octo_between_weight(length, arg[2], octo_between_bend_term[k]);
    if (weight == 0.0) continue;
    octo_between_second(k, arg, (double *[]){made + octo_between_bend_first[k]});
    for (int e = octo_between_bend_first[k]; e < octo_between_bend_first[k + 1]; ++e) {
      int a = octo_between_bend_row[e], b = octo_between_bend_column[e]; /* a <= b */
      if ((a < BC && older) || (b >= BC && newer)) continue;
      double value = 2.0 * weight * made[e], *own = b < BC ? h - 3 * (size_t)t->nc * t->nc : h;
      if (a < BC && b >= BC) own[(t->nc + b - BC) * t->nc + a] += value;
      else {
        own[a % BC * t->nc + b % BC] += value;
        if (a != b) own[b % BC * t->nc + a % BC] += value;
      }
    }
  }
}
#endif

/* 2 JᵀJ and 2 Jᵀr to h, where there is one, and b; to JᵀJ of exact terms their residuals' curvature, as octo_linearize does. */
static void octo_between_model_of(void *shared, int member) {
  const octo_between_call *call = shared;
  const octo_task *t = call->task;
  int segments = t->units - 1, length = t->steps / segments;
  for (int z = 0; z < segments; ++z) {
    const double *c = call->controls + ((size_t)member * t->units + z) * BC;
    const double *q = t->q + ((size_t)member * t->steps + (z + 1) * length - 1) * BQ, *arg[3] = {c, c + BC, q};
    for (int k = 0; k < BETWEEN; ++k) {
      double r[BR + 1], slopes[BZ + 1], weight = octo_between_weight(length, q, octo_between_term[k]);
      if (weight == 0.0) continue; /* it may not be finite there */
      octo_between(k, arg, (double *[]){r + octo_between_first_row[k]});
      octo_between(BETWEEN + k, arg, (double *[]){slopes + octo_between_first_entry[k]});
      for (int row = octo_between_first_row[k]; row < octo_between_first_row[k + 1]; ++row)
        octo_between_square(call, member, z, row, 2.0 * weight, r[row], slopes);
    }
#ifdef BENT
    if (t->h && octo_is_curved(t, member)) octo_between_bend(call, member, z, length, arg);
#endif
  }
}

/* After octo_evaluate: terms of the task. */
void octo_between_values(const octo_task *t, const double *controls, int threads) {
  octo_parallel_for(octo_between_values_of, &(octo_between_call){t, controls, 0}, t->batch, threads);
}

/* After octo_linearize: h and b of the task; fixed (units): those that nothing moves. */
void octo_between_model(const octo_task *t, const double *controls, const int *fixed, int threads) {
  octo_parallel_for(octo_between_model_of, &(octo_between_call){t, controls, fixed}, t->batch, threads);
}
