/* The KKT matrix of a batch (Eq. 12): products, block cyclic reduction, refinement; after common.cuh.
 *
 * The text before this one defines NCV and MAV, variables and constraint rows of a unit. Units are paired: an SBT(D, B) of
 * diagonal blocks (D, B, B) and blocks lower (D - 1, B, B) below them, B = 2 (NCV + MAV); for A Aᵀ B = 2 MAV. A pivot block is
 * factored with complete pivoting (Bunch and Parlett 1971), Π P Πᵀ = L diag(2x2 and 1x1) Lᵀ; the 2x2 pivots are diagonalised
 * by a rotation, so that P⁻¹ = Tᵀ diag(sign) T and the signs are the block's inertia. Grids are (blocks, batch). */

#define UNIT (NCV + MAV)
#define KKT (2 * UNIT)
#define GRAM (2 * MAV)
#define ALPHA 0.6403882032022076 /* (1 + sqrt 17) / 8 */
#define CHOICES 16
#define TILE 4

/* ---- pivot blocks ---- */

typedef struct { double top; int at; } octo_choice;

static __device__ inline octo_choice octo_better(octo_choice a, octo_choice b) {
  return b.top > a.top || (b.top == a.top && b.at < a.at) ? b : a;
}

static __device__ inline void octo_note(octo_choice *best, double value, int i, int j, int at) {
  octo_choice here = {fabs(value), at};
  best[j < i] = octo_better(best[j < i], here);
}

/* What the threads have seen, put together: the largest on the diagonal (0) and below it (1), the first of equals. */
static __device__ inline void octo_agree(octo_choice *seen, octo_choice *best) {
  seen[2 * LANE] = best[0];
  seen[2 * LANE + 1] = best[1];
  BARRIER;
  octo_choice *few = seen + 2 * LANES;
  EACH(c, 2 * CHOICES) {
    octo_choice top = {-1.0, 0};
    for (int t = c / 2; t < LANES; t += CHOICES) top = octo_better(top, seen[2 * t + c % 2]);
    few[c] = top;
  }
  BARRIER;
  best[0].top = best[1].top = -1.0;
  best[0].at = best[1].at = 0;
  for (int c = 0; c < 2 * CHOICES; ++c) best[c % 2] = octo_better(best[c % 2], few[c]);
}

/* Rows k and r of the whole array change places, and columns k and r of the rows not yet eliminated. */
template <int B>
static __device__ inline void octo_swap(double *w, int *order, int k, int r, int eliminated) {
  if (k == r) return; /* the same for all threads */
  EACH(j, B) { double t = w[k * B + j]; w[k * B + j] = w[r * B + j]; w[r * B + j] = t; }
  BARRIER;
  EACH(e, B - eliminated) {
    int i = eliminated + e;
    double t = w[i * B + k]; w[i * B + k] = w[i * B + r]; w[i * B + r] = t;
  }
  if (LANE == 0) { int t = order[k]; order[k] = order[r]; order[r] = t; }
  BARRIER;
}

/* Rows k and k + 1 are rotated so that their 2x2 pivot [[a, b], [b, c]] becomes diagonal: its eigenvalues. */
template <int B>
static __device__ inline void octo_rotate(double *w, int k, double *d) {
  double a = w[k * B + k], b = w[(k + 1) * B + k], c = w[(k + 1) * B + k + 1];
  double t = 0.5 * (c - a) / b, tangent = (t < 0 ? -1.0 : 1.0) / (fabs(t) + sqrt(1.0 + t * t));
  double cosine = 1.0 / sqrt(1.0 + tangent * tangent), sine = tangent * cosine;
  BARRIER;
  EACH(j, B) {
    double up = w[k * B + j], down = w[(k + 1) * B + j];
    if (j == k) up = 1.0, down = 0.0;
    if (j == k + 1) up = 0.0, down = 1.0;
    w[k * B + j] = cosine * up - sine * down;
    w[(k + 1) * B + j] = sine * up + cosine * down;
  }
  if (LANE == 0) { d[k] = a - tangent * b; d[k + 1] = c + tangent * b; }
  BARRIER;
}

/* Rows below k + size lose their multiples of the pivot rows; columns left of k hold T = L⁻¹ as it grows. best: the largest
 * entries that this thread leaves behind. */
template <int B>
static __device__ inline void octo_eliminate(double *w, int k, int size, const double *d, octo_choice *best) {
  double inverse = 1.0 / d[k], second = size > 1 ? 1.0 / d[k + 1] : 0.0;
  const double *row = w + k * B, *next = row + (size > 1 ? B : 0);
  best[0].top = best[1].top = -1.0;
  EACH(e, (B - k - size) * B) {
    int i = k + size + e / B, j = e % B;
    double value = j >= k && j < k + size ? 0.0 : w[i * B + j];
    value -= row[i] * inverse * row[j];
    if (size > 1) value -= next[i] * second * next[j];
    w[i * B + j] = value;
    if (j >= k + size && j <= i) octo_note(best, value, i, j, i * B + j);
  }
  BARRIER;
}

/* T (B, B) and sign (B) of one pivot block w. Pivots that are nothing but rounding become -shift, or none at all (sign 0) when
 * shift is 0; counts gets the negative ones and those. scratch: 2 B + 4 threads + 4 CHOICES doubles of shared memory. */
template <int B>
static __device__ inline void octo_pivot(double *w, double *scratch, double rounding, double shift, double *half, double *sign, int *counts) {
  double *d = scratch;
  int *order = (int *)(d + B), *last = order + B; /* the last column of each row of T */
  octo_choice *seen = (octo_choice *)(d + 2 * B), best[2] = {{-1.0, 0}, {-1.0, 0}};
  EACH(j, B) order[j] = last[j] = j;
  EACH(e, B * B) if (e % B <= e / B) octo_note(best, w[e], e / B, e % B, e);
  BARRIER;
  int k = 0;
  while (k < B) {
    octo_agree(seen, best);
    if (!(best[0].top > rounding || best[1].top > rounding)) break;
    int two = shift > 0.0 && best[0].top < ALPHA * best[1].top;
    if (two) {
      int r = best[1].at / B, c = best[1].at % B; /* c < r */
      octo_swap<B>(w, order, k, c, k);
      octo_swap<B>(w, order, k + 1, r, k);
      octo_rotate<B>(w, k, d);
      if (LANE == 0) last[k] = k + 1;
    } else {
      octo_swap<B>(w, order, k, best[0].at / B, k);
      double pivot = w[k * B + k];
      BARRIER;
      if (shift == 0.0 && !(pivot > rounding)) break; /* not positive: rounding, where shift is 0 */
      if (LANE == 0) d[k] = pivot, w[k * B + k] = 1.0;
      BARRIER;
    }
    octo_eliminate<B>(w, k, 1 + two, d, best);
    k += 1 + two;
  }
  EACH(i, B) {
    if (i >= k) d[i] = -shift;
    sign[i] = d[i] > 0.0 ? 1.0 : d[i] < 0.0 ? -1.0 : 0.0;
  }
  BARRIER;
  EACH(e, B * B) {
    int i = e / B, j = e % B;
    double value = i < k ? (j <= last[i] ? w[e] : 0.0) : j < k ? w[e] : j == i ? 1.0 : 0.0;
    half[i * B + order[j]] = d[i] != 0.0 ? value / sqrt(fabs(d[i])) : 0.0;
  }
  if (LANE == 0) {
    counts[0] = 0;
    for (int i = 0; i < B; ++i) counts[0] += d[i] < 0.0;
    counts[1] = B - k;
  }
}

/* Block number e of `count` eliminated ones stands at first + 2 e of the level's D blocks; its counts at place + e of `places`. */
template <int B>
static __device__ inline void octo_pivots_of(int D, int first, double rounding, double shift, int places, int place, int spill,
                                             double *diagonal, double *half, double *sign, int *counts) {
  SHARED(scratch);
  size_t member = blockIdx.y, e = blockIdx.x, count = gridDim.x, at = member * count + e;
  double *w = diagonal + (member * D + first + 2 * e) * B * B;
  if (!spill) {
    double *copy = scratch + 2 * B + 4 * LANES + 4 * CHOICES;
    EACH(k, B * B) copy[k] = w[k];
    w = copy;
    BARRIER;
  }
  octo_pivot<B>(w, scratch, rounding, shift, half + at * B * B, sign + at * B, counts + 2 * (member * places + place + e));
}

/* ---- products of blocks ---- */

#define TILES(B) (((B) + 47) / 48)

/* A tile of 48x48 entries of sum_k weight_k a(k, i) b(k, j): given to `put(i, j, value)` in squares of TILE. at(i) and bt(j)
 * are where column i of a and column j of b start, a_step and b_step lead from k to k + 1. */
template <int B, typename Put>
static __device__ inline void octo_tile(int tile, const double *weight, const double *a, int a_step, int a_next, const double *b, int b_step,
                                        int b_next, Put put) {
  int top = tile / TILES(B) * 48, left = tile % TILES(B) * 48;
  EACH(square, (48 / TILE) * (48 / TILE)) {
    int i = top + square / (48 / TILE) * TILE, j = left + square % (48 / TILE) * TILE;
    if (i >= B || j >= B) continue;
    double sum[TILE][TILE] = {{0.0}};
    int rows = B - i < TILE ? B - i : TILE, columns = B - j < TILE ? B - j : TILE;
    for (int k = 0; k < B; ++k) {
      double w = weight ? weight[k] : 1.0, one[TILE], other[TILE];
      for (int r = 0; r < TILE; ++r) one[r] = r < rows ? w * a[k * a_step + (i + r) * a_next] : 0.0;
      for (int c = 0; c < TILE; ++c) other[c] = c < columns ? b[k * b_step + (j + c) * b_next] : 0.0;
      for (int r = 0; r < TILE; ++r)
        for (int c = 0; c < TILE; ++c) sum[r][c] += one[r] * other[c];
    }
    for (int r = 0; r < TILE; ++r)
      for (int c = 0; c < TILE; ++c)
        if (r < rows && c < columns) put(i + r, j + c, sum[r][c]);
  }
}

/* right = T (block towards the one after), left = T (block towards the one before); grid (count tiles², 2, batch). */
template <int B>
static __device__ inline void octo_couple_of(int D, int first, const double *lower, const double *half, double *left, double *right) {
  const int tiles = TILES(B) * TILES(B);
  size_t member = blockIdx.z, e = blockIdx.x / tiles, count = gridDim.x / tiles, at = member * count + e, place = first + 2 * e;
  int tile = blockIdx.x % tiles;
  const double *T = half + at * B * B;
  if (blockIdx.y == 0) {
    double *out = right + at * B * B;
    octo_tile<B>(tile, 0, T, 1, B, lower + (member * (D - 1) + place) * B * B, 1, B, [=](int i, int j, double v) { out[i * B + j] = v; });
  } else if (place > 0) {
    double *out = left + at * B * B;
    octo_tile<B>(tile, 0, T, 1, B, lower + (member * (D - 1) + place - 1) * B * B, B, 1, [=](int i, int j, double v) { out[i * B + j] = v; });
  }
}

/* What is left of the blocks that survive, at 1 - first + 2 s; grid (survivors tiles², 2, batch): diagonal, lower. */
template <int B>
static __device__ inline void octo_complement_of(int D, int first, const double *diagonal, const double *sign, const double *left,
                                                 const double *right, double *new_diagonal, double *new_lower) {
  const int tiles = TILES(B) * TILES(B);
  int s = blockIdx.x / tiles, S = gridDim.x / tiles, tile = blockIdx.x % tiles, E = D - S, before = s - first, after = s + 1 - first;
  size_t member = blockIdx.z, size = (size_t)B * B;
  const double *l = left + (member * E + after) * size, *r = right + (member * E + before) * size;
  if (blockIdx.y == 0) {
    double *out = new_diagonal + (member * S + s) * size;
    const double *old = diagonal + (member * D + 1 - first + 2 * s) * size;
    EACH(square, 48 * 48) {
      int i = tile / TILES(B) * 48 + square / 48, j = tile % TILES(B) * 48 + square % 48;
      if (i < B && j < B) out[i * B + j] = old[i * B + j];
    }
    BARRIER;
    auto less = [=](int i, int j, double v) { out[i * B + j] -= v; };
    if (after < E) octo_tile<B>(tile, sign + (member * E + after) * B, l, B, 1, l, B, 1, less);
    if (before >= 0) octo_tile<B>(tile, sign + (member * E + before) * B, r, B, 1, r, B, 1, less);
  } else if (s < S - 1) {
    double *out = new_lower + (member * (S - 1) + s) * size;
    const double *next = right + (member * E + after) * size;
    octo_tile<B>(tile, sign + (member * E + after) * B, next, B, 1, l, B, 1, [=](int i, int j, double v) { out[i * B + j] = -v; });
  }
}

/* ---- solving: r is (D, B, columns), one block of threads a surviving block ---- */

/* out (B, columns) = block (B, B) x, or its transpose times x; with sign: its rows weighted. */
template <int B>
static __device__ inline void octo_block_times(const double *block, int transposed, const double *x, int columns, const double *sign, double *out) {
  EACH(e, B * columns) {
    int i = e / columns, c = e % columns, step = transposed ? B : 1;
    const double *row = block + (transposed ? i : i * B);
    double sum = 0.0;
    for (int k = 0; k < B; ++k) sum += row[k * step] * x[k * columns + c];
    out[e] = sign ? sign[i] * sum : sum;
  }
}

/* held (E, B, columns) = sign T r of the eliminated blocks, what is left of r for the survivors. Shared: 3 B columns. */
template <int B>
static __device__ inline void octo_fold_of(int D, int first, int columns, const double *half, const double *sign, const double *left,
                                           const double *right, const double *r, double *held, double *folded) {
  SHARED(w);
  int s = blockIdx.x, S = gridDim.x, E = D - S, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B;
  double *product = w + 2 * size;
  for (int side = 0; side < 2; ++side) { /* the block before, which this one holds, and the block after */
    int e = s - first + side;
    if (e < 0 || e >= E) continue;
    size_t at = member * E + e;
    octo_block_times<B>(half + at * block, 0, r + (member * D + first + 2 * e) * size, columns, sign + at * B, w + side * size);
    BARRIER;
    if (side == 0) EACH(k, size) held[at * size + k] = w[k];
  }
  const double *own = r + (member * D + 1 - first + 2 * s) * size;
  double *out = folded + (member * S + s) * size;
  EACH(k, size) product[k] = own[k];
  for (int side = 0; side < 2; ++side) {
    int e = s - first + side;
    if (e < 0 || e >= E) continue;
    const double *reach = (side == 0 ? right : left) + (member * E + e) * block;
    EACH(k, size) {
      double sum = 0.0;
      for (int j = 0; j < B; ++j) sum += reach[j * B + k / columns] * w[side * size + j * columns + k % columns];
      product[k] -= sum;
    }
  }
  EACH(k, size) out[k] = product[k];
}

/* x of a level from x of its survivors; grid (D, batch); shared: 2 B columns. */
template <int B>
static __device__ inline void octo_unfold_of(int D, int first, int columns, const double *half, const double *sign, const double *left,
                                             const double *right, const double *held, const double *x, double *unfolded) {
  SHARED(y);
  int place = blockIdx.x, E = (D - first) / 2, S = D - E, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B;
  double *out = unfolded + (member * D + place) * size;
  if (place % 2 != first) {
    const double *own = x + (member * S + place / 2) * size;
    EACH(k, size) out[k] = own[k];
    return;
  }
  int e = place / 2;
  size_t at = member * E + e;
  const double *after = x + (member * S + e + first) * size, *before = after - size;
  EACH(k, size) {
    int i = k / columns, c = k % columns;
    const double *r = right + at * block + i * B, *l = left + at * block + i * B;
    double sum = 0.0;
    for (int j = 0; j < B; ++j) sum += r[j] * after[j * columns + c];
    if (place > 0)
      for (int j = 0; j < B; ++j) sum += l[j] * before[j * columns + c];
    y[k] = held[at * size + k] - sign[at * B + i] * sum;
  }
  BARRIER;
  octo_block_times<B>(half + at * block, 1, y, columns, 0, out);
}

/* The last block: x = Tᵀ sign T r; grid (1, batch); shared: B columns. */
template <int B>
static __device__ inline void octo_last_of(int columns, const double *half, const double *sign, const double *r, double *x) {
  SHARED(y);
  size_t member = blockIdx.y;
  octo_block_times<B>(half + member * B * B, 0, r + member * B * columns, columns, sign + member * B, y);
  BARRIER;
  octo_block_times<B>(half + member * B * B, 1, y, columns, 0, x + member * B * columns);
}
