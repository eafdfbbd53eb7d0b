/* Terms over neighbouring Hermite controls r(c_k, c_{k+1}), one segment of `length` steps between them: the mathematics of
 * problem/neighbours.py. After their generated text (between.py) and common.cuh; a segment's rows are BR of 2 BC + 1 numbers,
 * those to c_k, those to c_{k+1} and the value, scaled by the root of twice the coefficient. */

/* What a term's square is multiplied with in E: the sum over the steps of a segment, whose last row of q is given. */
static __device__ inline double octo_between_weight(int length, const double *q, int k) {
  double sum = 0.0;
  for (int step = length - 1; step >= 0; --step) sum += q[octo_between_term[k] - step * BQ];
  return sum;
}

/* r (BR) and, with jac, its derivatives (BZ); one thread for each term's values, one for its derivatives. */
static __device__ inline void octo_between_of(const double *controls, const double *q, double *r, double *jac) {
  EACH(k, jac ? 2 * BETWEEN : BETWEEN) {
    const double *arg[3] = {controls, controls + BC, q};
    double *res[1] = {k < BETWEEN ? r + octo_between_first_row[k] : jac + octo_between_first_entry[k - BETWEEN]};
    octo_between(k, arg, res);
  }
  BARRIER;
}

/* c_0 … c_Z of each member: anchor, and the unknowns of the unit before; over count = batch units BC numbers. */
extern "C" __global__ void octo_between_controls(int count, int units, const double *anchor, const double *unknowns, double *controls) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x)
    controls[e] = anchor[e] + (e / BC % units > 0 ? unknowns[e - BC] : 0.0);
}

/* The terms' share of E, at the last step of each segment; grid (segments, batch); shared: BR doubles. */
extern "C" __global__ void octo_between_values(int length, const double *controls, const double *q, double *terms) {
  SHARED(r);
  size_t segments = gridDim.x, member = blockIdx.y, last = (member * segments + blockIdx.x + 1) * length - 1;
  octo_between_of(controls + (member * (segments + 1) + blockIdx.x) * BC, q + last * BQ, r, 0);
  EACH(k, BETWEEN) {
    double sum = 0.0, weight = octo_between_weight(length, q + last * BQ, k);
    for (int row = octo_between_first_row[k]; weight != 0.0 && row < octo_between_first_row[k + 1]; ++row) sum += r[row] * r[row];
    terms[last * BTERM + octo_between_term[k]] = weight * sum;
  }
}

/* The rows of each segment; grid (segments, batch); shared: 2 BR + BZ doubles. */
extern "C" __global__ void octo_between_rows(int length, const double *controls, const double *q, double *rows) {
  SHARED(r);
  double *scale = r + BR, *jac = scale + BR;
  size_t segments = gridDim.x, member = blockIdx.y, segment = member * segments + blockIdx.x;
  const double *own = q + ((segment + 1) * length - 1) * BQ;
  double *out = rows + segment * BR * (2 * BC + 1);
  EACH(k, BETWEEN) {
    double weight = octo_between_weight(length, own, k);
    for (int row = octo_between_first_row[k]; row < octo_between_first_row[k + 1]; ++row) scale[row] = sqrt(2.0 * weight);
  }
  EACH(e, BR * (2 * BC + 1)) out[e] = 0.0;
  octo_between_of(controls + (member * (segments + 1) + blockIdx.x) * BC, own, r, jac);
  EACH(row, BR)
    if (scale[row] != 0.0) out[row * (2 * BC + 1) + 2 * BC] = scale[row] * r[row];
  EACH(z, BZ) {
    int row = octo_between_entry_row[z];
    if (scale[row] != 0.0) out[row * (2 * BC + 1) + octo_between_entry_column[z]] = scale[row] * jac[z];
  }
}

/* H (units, 3, BC, BC) and b (units, BC) += rowsᵀ rows and rowsᵀ values, of unit z, which is c_{z+1}: the segments before and
 * after it, and between it and the unit before; grid (segments, 2 lags, batch). Pinned units stay as they are: dummy (units, 2), of both
 * parts alike. */
extern "C" __global__ void octo_between_add(const int *dummy, const double *rows, double *h, double *b) {
  int unit = blockIdx.x, lag = blockIdx.y, segments = gridDim.x, width = 2 * BC + 1;
  size_t member = blockIdx.z, own = member * (segments + 1) + unit;
  const double *before = rows + (member * segments + unit) * BR * width, *after = before + BR * width;
  int last = unit + 1 == segments;
  if (dummy[2 * unit] || (lag == 1 && (unit == 0 || dummy[2 * unit - 2]))) return;
  EACH(e, BC * BC) {
    int i = e / BC, j = e % BC;
    double sum = h[(own * 3 + lag) * BC * BC + e];
    for (int row = 0; row < BR; ++row) {
      sum += before[row * width + BC + i] * before[row * width + (lag == 0 ? BC : 0) + j];
      if (lag == 0 && !last) sum += after[row * width + i] * after[row * width + j];
    }
    h[(own * 3 + lag) * BC * BC + e] = sum;
  }
  if (lag == 0)
    EACH(i, BC) {
      double sum = b[own * BC + i];
      for (int row = 0; row < BR; ++row) {
        sum += before[row * width + BC + i] * before[row * width + 2 * BC];
        if (!last) sum += after[row * width + i] * after[row * width + 2 * BC];
      }
      b[own * BC + i] = sum;
    }
}
