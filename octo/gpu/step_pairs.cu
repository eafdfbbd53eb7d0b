/* Terms over two steps in a row: the mathematics of problem/step_pairs.c, gathered. After their generated text (step_pairs.py) and
 * common.cuh. A step's rows are PAIR_ROWS of W4 + 1 numbers, those to its four nodes and the value, scaled by the root of twice the
 * coefficient. Step 0 has none, but in a cycle (carry (batch, NX, NX), else 0), where the last step, carried back, comes before it. */

#define W3 (3 * NX)
#define W4 (4 * NX)

/* What the last torques are multiplied with to be those before a cycle's first step. */
static __device__ inline double octo_pair_carried(const double *carry, int j, int k) {
  return carry[octo_pair_actuated[j] * NX + octo_pair_actuated[k]];
}

/* r (PAIR_ROWS) of a step, or, with these, its derivatives jac (PAIR_ENTRIES) and second ones bends (PAIR_BENDS); ``item`` counts the
 * steps of all members. */
static __device__ inline void octo_pair_of(int steps, size_t item, const double *nodes, const double *fd, const double *p, const double *q,
                                           const double *carry, double *r, double *jac, double *bends) {
  size_t member = item / steps, step = item % steps;
  const double *x = nodes + (item + 2 * member + 2) * NX, *arg[8];
  double u[2][NU + 1], oldest[NX], *res[1] = {r};
  for (int node = 0; node < 4; ++node) arg[node] = x - node * NX;
  for (int back = 0; back < 2; ++back)
    for (int j = 0; j < NU; ++j) u[back][j] = step < back ? 0.0 : fd[(item - back) * NX + octo_pair_actuated[j]];
  if (step == 0) {
    const double *last = x + (steps - 3) * NX; /* x_{N−2}: x_{−2} is carried back as x_{−1} = carry x_{N−1} + constant is */
    carry += member * NX * NX;
    for (int j = 0; j < NX; ++j) {
      oldest[j] = x[j - 2 * NX];
      for (int k = 0; k < NX; ++k) oldest[j] += carry[j * NX + k] * (last[k] - last[NX + k]);
    }
    for (int j = 0; j < NU; ++j)
      for (int k = 0; k < NU; ++k) u[1][j] += octo_pair_carried(carry, j, k) * fd[(item + steps - 1) * NX + octo_pair_actuated[k]];
    arg[3] = oldest;
  }
  arg[4] = u[0]; arg[5] = u[1]; arg[6] = p + member * NP; arg[7] = q + item * NQ;
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
                                            const double *carry, double *terms) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    double r[PAIR_ROWS + 1];
    if (e % steps == 0 && !carry) continue;
    octo_pair_of(steps, e, nodes, fd, p, q, carry, r, 0, 0);
    for (int row = 0; row < PAIR_ROWS; ++row) {
      int term = octo_pair_row_term[row];
      double c = q[(size_t)e * NQ + term];
      if (c != 0.0) terms[(size_t)e * NTERM + term] += c * r[row] * r[row];
    }
  }
}

/* r (count, PAIR_ROWS) and jac (count, PAIR_ENTRIES). */
extern "C" __global__ void octo_pair_slopes(int count, int steps, const double *nodes, const double *fd, const double *p, const double *q,
                                            const double *carry, double *r, double *jac) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x)
    if (e % steps || carry) octo_pair_of(steps, e, nodes, fd, p, q, carry, r + (size_t)e * PAIR_ROWS, jac + (size_t)e * PAIR_ENTRIES, 0);
}

/* lam (batch, steps, NX) += dE/du: of a step's own residual, and of that of the step after it; over count = batch steps NU. */
extern "C" __global__ void octo_pair_pull(int count, int steps, const double *q, const double *carry, const double *r, const double *jac,
                                          double *lam) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int j = e % NU, step = e / NU % steps, member = e / NU / steps;
    double sum = 0.0;
    for (int after = 0; after < 2; ++after) {
      int other = (step + after) % steps;
      size_t own = (size_t)member * steps + other;
      if (other == 0 && !carry) continue;
      for (int z = 0; z < PAIR_ENTRIES; ++z) {
        int row = octo_pair_entry_row[z], of = octo_pair_entry_column[z] - W4 - after * NU;
        double c = q[own * NQ + octo_pair_row_term[row]], part = of == j;
        if (of < 0 || of >= NU || c == 0.0) continue;
        if (other < after) part = octo_pair_carried(carry + (size_t)member * NX * NX, of, j);
        if (part != 0.0) sum += part * 2.0 * c * r[own * PAIR_ROWS + row] * jac[own * PAIR_ENTRIES + z];
      }
    }
    lam[((size_t)member * steps + step) * NX + octo_pair_actuated[j]] += sum;
  }
}

/* Row k of d(window, u, u_before)/d(what the nodes of the window are made of), column c, of step ``step``; fd_jac (steps, NX, W3) and
 * carry (NX, NX) of its member. */
static __device__ inline double octo_pair_chain(int steps, int step, const double *fd_jac, const double *carry, int k, int c) {
  int node = c / NX, column = c % NX, carried = carry && node > step;
  if (k < W4) return k / NX != node ? 0.0 : carried ? carry[k % NX * NX + column] : k == c;
  int back = k >= W4 + NU, j = k - W4 - back * NU, own = node - back;
  if (own < 0 || own > 2) return 0.0;
  double sum = 0.0;
  if (step < back) { /* before a cycle's first step: the last one, whose nodes are unknowns */
    for (int i = 0; i < NU; ++i)
      sum += octo_pair_carried(carry, j, i) * fd_jac[((size_t)(steps - 1) * NX + octo_pair_actuated[i]) * W3 + own * NX + column];
    return sum;
  }
  const double *line = fd_jac + ((size_t)(step - back) * NX + octo_pair_actuated[j]) * W3 + own * NX;
  if (!carried) return line[column];
  for (int i = 0; i < NX; ++i) sum += line[i] * carry[i * NX + column];
  return sum;
}

/* The rows (batch, steps, PAIR_ROWS, W4 + 1) from the slopes fd_jac (batch, steps, NX, W3) of FD; grid (steps − first, batch); shared:
 * PAIR_ROWS doubles. */
extern "C" __global__ void octo_pair_rows(int steps, int first, const double *q, const double *carry, const double *r, const double *jac,
                                          const double *fd_jac, double *rows) {
  SHARED(scale);
  int step = blockIdx.x + first;
  size_t item = (size_t)blockIdx.y * steps + step;
  r += item * PAIR_ROWS; jac += item * PAIR_ENTRIES; q += item * NQ; rows += item * PAIR_ROWS * (W4 + 1);
  fd_jac += (size_t)blockIdx.y * steps * NX * W3; if (carry) carry += (size_t)blockIdx.y * NX * NX;
  EACH(row, PAIR_ROWS) {
    scale[row] = sqrt(2.0 * q[octo_pair_row_term[row]]);
    rows[row * (W4 + 1) + W4] = scale[row] != 0.0 ? scale[row] * r[row] : 0.0;
  }
  BARRIER;
  EACH(c, W4) {
    for (int row = 0; row < PAIR_ROWS; ++row) rows[row * (W4 + 1) + c] = 0.0;
    for (int z = 0; z < PAIR_ENTRIES; ++z) {
      int row = octo_pair_entry_row[z];
      if (scale[row] == 0.0) continue;
      rows[row * (W4 + 1) + c] += scale[row] * jac[z] * octo_pair_chain(steps, step, fd_jac, carry, octo_pair_entry_column[z], c);
    }
  }
}

/* bends (batch, steps, W4, W4), what exact terms have beside rowsᵀ rows, of members that are curved; grid (steps − first, batch);
 * shared: PAIR_BENDS doubles. */
extern "C" __global__ void octo_pair_bends(int steps, int first, const int *curved, const double *nodes, const double *fd, const double *p,
                                           const double *q, const double *carry, const double *fd_jac, double *bends) {
#if PAIR_BENDS > 0
  SHARED(second);
  int step = blockIdx.x + first, whole = !curved || curved[blockIdx.y];
  size_t item = (size_t)blockIdx.y * steps + step;
  if (LANE == 0 && whole) octo_pair_of(steps, item, nodes, fd, p, q, carry, 0, 0, second);
  BARRIER;
  bends += item * W4 * W4; fd_jac += (size_t)blockIdx.y * steps * NX * W3; if (carry) carry += (size_t)blockIdx.y * NX * NX;
  EACH(e, W4 * W4) {
    double sum = 0.0;
    for (int z = 0; whole && z < PAIR_BENDS; ++z) {
      int a = octo_pair_bend_row[z], b = octo_pair_bend_column[z];
      for (int turn = 0; turn < (a == b ? 1 : 2); ++turn)
        sum += second[z] * octo_pair_chain(steps, step, fd_jac, carry, turn ? b : a, e / W4) *
               octo_pair_chain(steps, step, fd_jac, carry, turn ? a : b, e % W4);
    }
    bends[e] = sum;
  }
#endif
}

/* H (units, 3, parts NX, parts NX) += rowsᵀ rows (+ bends, where there are) and b (units, parts NX) += rowsᵀ values; places of Gather
 * (tables.py), whose sources are 16 step + 4 node + other node, and 4 step + node; grid (units, 3 lags, batch). */
extern "C" __global__ void octo_pair_add(int steps, int parts, const int *first, const int *source, const double *value, const int *b_first,
                                         const int *b_source, const double *b_value, const double *rows, const double *bends, double *h,
                                         double *b) {
  int unit = blockIdx.x, lag = blockIdx.y, nc = parts * NX;
  size_t member = blockIdx.z, own = member * gridDim.x + unit;
  rows += member * steps * PAIR_ROWS * (W4 + 1); if (bends) bends += member * steps * W4 * W4;
  h += (own * 3 + lag) * nc * nc; b += own * nc;
  first += 3 * unit + lag; b_first += unit;
  EACH(e, NX * NX) {
    int i = e / NX, j = e % NX;
    for (int t = first[0]; t < first[1]; ++t) {
      const double *line = rows + (size_t)(source[t] / 16) * PAIR_ROWS * (W4 + 1);
      int left = source[t] / 4 % 4 * NX + i, right = source[t] % 4 * NX + j;
      double product = bends ? bends[((size_t)(source[t] / 16) * W4 + left) * W4 + right] : 0.0;
      for (int row = 0; row < PAIR_ROWS; ++row, line += W4 + 1) product += line[left] * line[right];
      for (int m = 0; m < parts * parts; ++m)
        if (value[t * parts * parts + m] != 0.0) h[(m / parts * NX + i) * nc + m % parts * NX + j] += value[t * parts * parts + m] * product;
    }
  }
  if (lag == 0)
    EACH(j, NX)
      for (int t = b_first[0]; t < b_first[1]; ++t) {
        const double *line = rows + (size_t)(b_source[t] / 4) * PAIR_ROWS * (W4 + 1);
        double product = 0.0;
        for (int row = 0; row < PAIR_ROWS; ++row, line += W4 + 1) product += line[b_source[t] % 4 * NX + j] * line[W4];
        for (int m = 0; m < parts; ++m) b[m * NX + j] += b_value[t * parts + m] * product;
      }
}
