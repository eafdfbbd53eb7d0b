/* A Aᵀ, its rows scaled to length 1, as a symmetric block-tridiagonal matrix of paired units (normal.py); MAV > 0. */

/* Inverse lengths of the rows, 0 for rows of zeros; grid (units, batch). */
extern "C" __global__ void octo_row_scale(const double *a, double *scale) {
  size_t unit = (size_t)blockIdx.y * gridDim.x + blockIdx.x;
  EACH(i, MAV) {
    double sum = 0.0;
    for (int o = 0; o < 3; ++o)
      for (int j = 0; j < NCV; ++j) {
        double entry = a[((unit * 3 + o) * MAV + i) * NCV + j];
        sum += entry * entry;
      }
    scale[unit * MAV + i] = sum > 0.0 ? 1.0 / sqrt(sum) : sum;
  }
}

/* finite (batch): 1 where the scales of all rows are; grid (1, batch). */
extern "C" __global__ void octo_gram_finite(int rows, const double *scale, int *finite) {
  size_t member = blockIdx.y;
  int broken = 0;
  EACH(e, rows) broken |= !isfinite(scale[member * rows + e]);
  broken = __syncthreads_or(broken);
  if (LANE == 0) finite[member] = !broken;
}

/* Row r of unit k times row c of unit l, k >= l; units beyond the last are the identity. */
static __device__ inline double octo_gram_entry(int units, int k, int r, int l, int c, const double *a, const double *scale) {
  int lag = k - l;
  if (k >= units) return k == l && r == c ? 1.0 : 0.0;
  double sum = 0.0;
  for (int p = 0; p + lag <= 2 && p <= l; ++p) {
    const double *one = a + (((size_t)k * 3 + lag + p) * MAV + r) * NCV, *other = a + (((size_t)l * 3 + p) * MAV + c) * NCV;
    for (int j = 0; j < NCV; ++j) sum += one[j] * other[j];
  }
  return sum * scale[k * MAV + r] * scale[l * MAV + c];
}

/* Pairs of units as SBT(D, GRAM); grid (D, batch); members that are not finite become the identity. */
extern "C" __global__ void octo_gram_blocks(int units, const int *finite, const double *a, const double *scale, double *diagonal, double *lower) {
  int d = blockIdx.x, D = gridDim.x;
  size_t member = blockIdx.y, size = (size_t)GRAM * GRAM;
  double *own = diagonal + (member * D + d) * size, *below = lower + (member * (D - 1) + d) * size;
  a += member * units * 3 * MAV * NCV; scale += member * units * MAV;
  EACH(e, GRAM * GRAM) {
    int i = e / GRAM, j = e % GRAM, k = 2 * d + i / MAV, l = 2 * d + j / MAV, r = i % MAV, c = j % MAV;
    double value = k >= l ? octo_gram_entry(units, k, r, l, c, a, scale) : octo_gram_entry(units, l, c, k, r, a, scale);
    own[e] = finite[member] ? value : i == j ? 1.0 : 0.0;
    if (d == D - 1) continue;
    k = 2 * d + 2 + i / MAV;
    below[e] = finite[member] && k - l <= 2 ? octo_gram_entry(units, k, r, l, c, a, scale) : 0.0;
  }
}

/* r = s rhs of paired units and, back, out = s x, added with ``more``; grid (D, batch). */
extern "C" __global__ void octo_gram_join(int units, int columns, const int *finite, const double *scale, const double *rhs, double *r) {
  size_t member = blockIdx.y, d = blockIdx.x, D = gridDim.x;
  EACH(e, GRAM * columns) {
    size_t row = 2 * d * MAV + e / columns, at = member * units * MAV + row;
    r[(member * D + d) * GRAM * columns + e] = row < (size_t)units * MAV && finite[member] ? scale[at] * rhs[at * columns + e % columns] : 0.0;
  }
}

extern "C" __global__ void octo_gram_part(int units, int columns, int more, const int *finite, const double *scale, const double *x, double *out) {
  size_t member = blockIdx.y, d = blockIdx.x, D = gridDim.x;
  EACH(e, GRAM * columns) {
    size_t row = 2 * d * MAV + e / columns, at = member * units * MAV + row, to = at * columns + e % columns;
    if (row >= (size_t)units * MAV) continue;
    double value = finite[member] ? scale[at] * x[(member * D + d) * GRAM * columns + e] : NAN;
    out[to] = more ? out[to] + value : value;
  }
}
