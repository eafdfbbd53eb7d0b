/* Terms over two steps in a row: the mathematics of problem/step_pairs.c, gathered. After their generated text (step_pairs.py) and
 * common.cuh. A step's rows are PAIR_ROWS of W4 + 1 numbers, those to its four nodes and the value, scaled by the root of twice the
 * coefficient. Step 0 has none. */

#define W3 (3 * NX)
#define W4 (4 * NX)

/* r (PAIR_ROWS) of a step, or, with these, its derivatives jac (PAIR_ENTRIES) and second ones bends (PAIR_BENDS); ``item`` counts the
 * steps of all members. */
static __device__ inline void octo_pair_of(int steps, size_t item, const double *nodes, const double *fd, const double *p, const double *q,
                                           double *r, double *jac, double *bends) {
  const double *x = nodes + (item + 2 * (item / steps) + 2) * NX, *arg[8];
  double u[2][NU + 1], *res[1] = {r};
  for (int back = 0; back < 2; ++back)
    for (int j = 0; j < NU; ++j) u[back][j] = fd[(item - back) * NX + octo_pair_actuated[j]];
  for (int node = 0; node < 4; ++node) arg[node] = x - node * NX;
  arg[4] = u[0]; arg[5] = u[1]; arg[6] = p + item / steps * NP; arg[7] = q + item * NQ;
  if (r) octo_step_pair(arg, res);
  res[0] = jac;
  if (jac) octo_step_pair_jac(arg, res);
#if PAIR_BENDS > 0
  res[0] = bends;
  if (bends) octo_step_pair_bend(arg, res);
#endif
}

/* Adds their share of E to terms (count, NTERM); over count = batch steps. */
extern "C" __global__ void octo_pair_values(int count, int steps, const double *nodes, const double *fd, const double *p, const double *q,
                                            double *terms) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    double r[PAIR_ROWS + 1];
    if (e % steps == 0) continue;
    octo_pair_of(steps, e, nodes, fd, p, q, r, 0, 0);
    for (int row = 0; row < PAIR_ROWS; ++row) {
      int term = octo_pair_row_term[row];
      double c = q[(size_t)e * NQ + term];
      if (c != 0.0) terms[(size_t)e * NTERM + term] += c * r[row] * r[row];
    }
  }
}

/* r (count, PAIR_ROWS) and jac (count, PAIR_ENTRIES). */
extern "C" __global__ void octo_pair_slopes(int count, int steps, const double *nodes, const double *fd, const double *p, const double *q,
                                            double *r, double *jac) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x)
    if (e % steps) octo_pair_of(steps, e, nodes, fd, p, q, r + (size_t)e * PAIR_ROWS, jac + (size_t)e * PAIR_ENTRIES, 0);
}

/* lam (batch, steps, NX) += dE/du: of a step's own residual, and of that of the step after it; over count = batch steps NU. */
extern "C" __global__ void octo_pair_pull(int count, int steps, const double *q, const double *r, const double *jac, double *lam) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int item = e / NU, j = e % NU;
    double sum = 0.0;
    for (int after = 0; after < 2; ++after) {
      size_t own = (size_t)item + after;
      if ((item % steps + after) % steps == 0) continue; /* step 0, or none after the last */
      for (int z = 0; z < PAIR_ENTRIES; ++z) {
        int row = octo_pair_entry_row[z];
        if (octo_pair_entry_column[z] != W4 + after * NU + j) continue;
        double c = q[own * NQ + octo_pair_row_term[row]];
        if (c != 0.0) sum += 2.0 * c * r[own * PAIR_ROWS + row] * jac[own * PAIR_ENTRIES + z];
      }
    }
    lam[(size_t)item * NX + octo_pair_actuated[j]] += sum;
  }
}

/* The rows (batch, steps, PAIR_ROWS, W4 + 1) from the slopes fd_jac (batch, steps, NX, W3) of FD; grid (steps − 1, batch); shared:
 * PAIR_ROWS doubles. */
extern "C" __global__ void octo_pair_rows(int steps, const double *q, const double *r, const double *jac, const double *fd_jac,
                                          double *rows) {
  SHARED(scale);
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x + 1;
  r += item * PAIR_ROWS; jac += item * PAIR_ENTRIES; q += item * NQ; rows += item * PAIR_ROWS * (W4 + 1);
  EACH(row, PAIR_ROWS) scale[row] = sqrt(2.0 * q[octo_pair_row_term[row]]);
  EACH(e, PAIR_ROWS * (W4 + 1)) rows[e] = 0.0;
  BARRIER;
  EACH(row, PAIR_ROWS)
    if (scale[row] != 0.0) rows[row * (W4 + 1) + W4] = scale[row] * r[row];
  EACH(z, PAIR_ENTRIES) {
    int row = octo_pair_entry_row[z], column = octo_pair_entry_column[z];
    if (column < W4 && scale[row] != 0.0) rows[row * (W4 + 1) + column] = scale[row] * jac[z];
  }
  BARRIER;
  EACH(j, W4)
    for (int z = 0; z < PAIR_ENTRIES; ++z) {
      int row = octo_pair_entry_row[z], of = octo_pair_entry_column[z] - W4, back = of >= NU, column = j - back * NX;
      if (of < 0 || column < 0 || column >= W3 || scale[row] == 0.0) continue;
      double slope = fd_jac[((item - back) * NX + octo_pair_actuated[of - back * NU]) * W3 + column];
      rows[row * (W4 + 1) + j] += scale[row] * jac[z] * slope;
    }
}

/* Row k of [I; U_i; U_{i−1}] (W4 + 2 NU, W4), column c; fd_jac of step i. */
static __device__ inline double octo_pair_chain(const double *fd_jac, int k, int c) {
  int back = k >= W4 + NU, column = c - back * NX;
  if (k < W4) return k == c;
  return column < 0 || column >= W3 ? 0.0 : fd_jac[(octo_pair_actuated[k - W4 - back * NU] - back * NX) * W3 + column];
}

/* bends (batch, steps, W4, W4), what exact terms have beside rowsᵀ rows, of members that are curved; grid (steps − 1, batch); shared:
 * PAIR_BENDS doubles. */
extern "C" __global__ void octo_pair_bends(int steps, const int *curved, const double *nodes, const double *fd, const double *p,
                                           const double *q, const double *fd_jac, double *bends) {
#if PAIR_BENDS > 0
  SHARED(second);
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x + 1;
  int whole = !curved || curved[blockIdx.y];
  bends += item * W4 * W4;
  if (LANE == 0 && whole) octo_pair_of(steps, item, nodes, fd, p, q, 0, 0, second);
  BARRIER;
  fd_jac += item * NX * W3;
  EACH(e, W4 * W4) {
    double sum = 0.0;
    for (int z = 0; whole && z < PAIR_BENDS; ++z) {
      int a = octo_pair_bend_row[z], b = octo_pair_bend_column[z], r = e / W4, c = e % W4;
      sum += second[z] * octo_pair_chain(fd_jac, a, r) * octo_pair_chain(fd_jac, b, c);
      if (a != b) sum += second[z] * octo_pair_chain(fd_jac, b, r) * octo_pair_chain(fd_jac, a, c);
    }
    bends[e] = sum;
  }
#endif
}

/* H (units, 3, 2 NX, 2 NX) += rowsᵀ rows (+ bends, where there are) and b (units, 2 NX) += rowsᵀ values; places of Gather (tables.py), whose sources are
 * 16 step + 4 node + other node, and 4 step + node; grid (units, 3 lags, batch). */
extern "C" __global__ void octo_pair_add(int steps, const int *first, const int *source, const double *value, const int *b_first,
                                         const int *b_source, const double *b_value, const double *rows, const double *bends, double *h,
                                         double *b) {
  int unit = blockIdx.x, lag = blockIdx.y;
  size_t member = blockIdx.z, own = member * gridDim.x + unit;
  rows += member * steps * PAIR_ROWS * (W4 + 1); if (bends) bends += member * steps * W4 * W4; h += (own * 3 + lag) * W4 * NX; b += own * 2 * NX;
  first += 3 * unit + lag; b_first += unit;
  EACH(e, NX * NX) {
    int i = e / NX, j = e % NX;
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    for (int t = first[0]; t < first[1]; ++t) {
      const double *line = rows + (size_t)(source[t] / 16) * PAIR_ROWS * (W4 + 1);
      int left = source[t] / 4 % 4 * NX + i, right = source[t] % 4 * NX + j;
      double product = bends ? bends[((size_t)(source[t] / 16) * W4 + left) * W4 + right] : 0.0;
      for (int row = 0; row < PAIR_ROWS; ++row, line += W4 + 1) product += line[left] * line[right];
      for (int m = 0; m < 4; ++m) sum[m] += value[4 * t + m] * product;
    }
    for (int m = 0; m < 4; ++m) h[(m / 2 * NX + i) * 2 * NX + m % 2 * NX + j] += sum[m];
  }
  if (lag == 0)
    EACH(j, NX) {
      double sum[2] = {0.0, 0.0};
      for (int t = b_first[0]; t < b_first[1]; ++t) {
        const double *line = rows + (size_t)(b_source[t] / 4) * PAIR_ROWS * (W4 + 1);
        double product = 0.0;
        for (int row = 0; row < PAIR_ROWS; ++row, line += W4 + 1) product += line[b_source[t] % 4 * NX + j] * line[W4];
        for (int m = 0; m < 2; ++m) sum[m] += b_value[2 * t + m] * product;
      }
      for (int m = 0; m < 2; ++m) b[m * NX + j] += sum[m];
    }
}
