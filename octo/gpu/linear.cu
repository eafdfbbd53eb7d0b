/* The KKT matrix of a batch (Eq. 12): products, block cyclic reduction, refinement; after common.cuh.
 *
 * The text before this one defines NCV and MAV, variables and constraint rows of a unit. Units are paired: an SBT(D, B) of
 * diagonal blocks (D, B, B) and blocks lower (D - 1, B, B) below them, B = 2 (NCV + MAV); for A Aᵀ B = 2 MAV. pivots.cu
 * makes of a block P that is eliminated T and signs with P⁻¹ = Tᵀ diag(sign) T. Grids are (blocks, batch). */

#define UNIT (NCV + MAV)
#define KKT (2 * UNIT)
#define GRAM (2 * MAV)

/* ---- products of blocks: a block of threads makes a tile of TILE x TILE entries, a thread 3 x 3 of them, EDGE apart ---- */

#define OWN (TILE / EDGE)
#define PITCH (TILE + 1) /* of a tile in shared memory: rows begin in different banks */
#define TILES(B) (((B) + TILE - 1) / TILE)
#define AHEAD 9 /* loads of a thread that are under way at a time */
#ifdef OCTO_ON_CPU
#define SQUARES (EDGE * EDGE) /* of one thread: there are as many threads as somebody wants */
#else
#define SQUARES 1 /* EDGE² threads */
#endif

/* An operand: entry (k, i) is first[k * down + i * right]. */
typedef struct { const double *first; int down, right; } octo_operand;

/* Entries (from + k, start + i) of x, times weight[from + k], to staged[k * PITCH + i], k, i < TILE; neighbours in memory are those of a warp. */
template <int B>
static __device__ inline void octo_stage(octo_operand x, const double *weight, int from, int start, double *staged) {
  for (int first = LANE; first < TILE * TILE; first += AHEAD * LANES) {
    double held[AHEAD];
    for (int u = 0; u < AHEAD; ++u) {
      int e = first + u * LANES, k = from + (x.right == 1 ? e / TILE : e % TILE), i = start + (x.right == 1 ? e % TILE : e / TILE);
      held[u] = e < TILE * TILE && k < B && i < B ? (weight ? weight[k] : 1.0) * x.first[k * x.down + i * x.right] : 0.0;
    }
    for (int u = 0; u < AHEAD; ++u) {
      int e = first + u * LANES;
      if (e < TILE * TILE) staged[x.right == 1 ? e / TILE * PITCH + e % TILE : e % TILE * PITCH + e / TILE] = held[u];
    }
  }
}

/* sum += Σ_k weight_k a(k, i) b(k, j) for the entries of a tile that begins at (top, left). staged: 2 TILE PITCH doubles, shared. */
template <int B>
static __device__ inline void octo_multiply(int top, int left, const double *weight, octo_operand a, octo_operand b, double *staged,
                                            double (*sum)[OWN][OWN]) {
  double *one = staged, *other = staged + TILE * PITCH;
  for (int from = 0; from < B; from += TILE) {
    int depth = B - from < TILE ? B - from : TILE;
    BARRIER; /* what was staged before is used up */
    octo_stage<B>(a, weight, from, top, one);
    octo_stage<B>(b, 0, from, left, other);
    BARRIER;
    for (int h = 0; h < SQUARES; ++h) {
      int square = LANE + h * LANES;
      if (square >= EDGE * EDGE) break;
      const double *x = one + square / EDGE, *y = other + square % EDGE;
      for (int k = 0; k < depth; ++k)
        for (int r = 0; r < OWN; ++r)
          for (int c = 0; c < OWN; ++c) sum[h][r][c] += x[k * PITCH + r * EDGE] * y[k * PITCH + c * EDGE];
    }
  }
}

/* put(i, j, sum) for the entries of a tile. */
template <int B, typename Put>
static __device__ inline void octo_put(int top, int left, double (*sum)[OWN][OWN], Put put) {
  for (int h = 0; h < SQUARES; ++h) {
    int square = LANE + h * LANES;
    if (square >= EDGE * EDGE) break;
    for (int r = 0; r < OWN; ++r)
      for (int c = 0; c < OWN; ++c) {
        int i = top + square / EDGE + r * EDGE, j = left + square % EDGE + c * EDGE;
        if (i < B && j < B) put(i, j, sum[h][r][c]);
      }
  }
}

/* right = T (block towards the one after), left = T (block towards the one before); grid (count tiles², 2, batch). */
template <int B>
static __device__ inline void octo_couple_of(int D, int first, const double *lower, const double *half, double *left, double *right) {
  SHARED(staged);
  const int tiles = TILES(B) * TILES(B);
  size_t member = blockIdx.z, e = blockIdx.x / tiles, count = gridDim.x / tiles, at = member * count + e, place = first + 2 * e;
  int tile = blockIdx.x % tiles, i0 = tile / TILES(B) * TILE, j0 = tile % TILES(B) * TILE, before = blockIdx.y;
  if (before && place == 0) return;
  const double *block = lower + (member * (D - 1) + place - before) * B * B;
  double sum[SQUARES][OWN][OWN] = {{{0.0}}}, *out = (before ? left : right) + at * B * B;
  octo_operand T = {half + at * B * B, 1, B}, towards = {block, before ? B : 1, before ? 1 : B};
  octo_multiply<B>(i0, j0, 0, T, towards, staged, sum);
  octo_put<B>(i0, j0, sum, [=](int i, int j, double v) { out[i * B + j] = v; });
}

/* What is left of the blocks that survive, at 1 - first + 2 s; grid (survivors tiles², 2, batch): diagonal, lower. */
template <int B>
static __device__ inline void octo_complement_of(int D, int first, const double *diagonal, const double *sign, const double *left,
                                                 const double *right, double *new_diagonal, double *new_lower) {
  SHARED(staged);
  const int tiles = TILES(B) * TILES(B);
  int s = blockIdx.x / tiles, S = gridDim.x / tiles, tile = blockIdx.x % tiles, E = D - S, before = s - first, after = s + 1 - first;
  int i0 = tile / TILES(B) * TILE, j0 = tile % TILES(B) * TILE;
  size_t member = blockIdx.z, size = (size_t)B * B;
  const double *l = left + member * E * size, *r = right + member * E * size, *weight = sign + member * E * B;
  auto of = [=](const double *blocks, int b) { octo_operand block = {blocks + b * size, B, 1}; return block; };
  double sum[SQUARES][OWN][OWN] = {{{0.0}}};
  if (blockIdx.y == 0) {
    double *out = new_diagonal + (member * S + s) * size;
    const double *old = diagonal + (member * D + 1 - first + 2 * s) * size;
    if (after < E) octo_multiply<B>(i0, j0, weight + after * B, of(l, after), of(l, after), staged, sum);
    if (before >= 0) octo_multiply<B>(i0, j0, weight + before * B, of(r, before), of(r, before), staged, sum);
    octo_put<B>(i0, j0, sum, [=](int i, int j, double v) { out[i * B + j] = old[i * B + j] - v; });
  } else if (s < S - 1) {
    double *out = new_lower + (member * (S - 1) + s) * size;
    octo_multiply<B>(i0, j0, weight + after * B, of(r, after), of(l, after), staged, sum);
    octo_put<B>(i0, j0, sum, [=](int i, int j, double v) { out[i * B + j] = -v; });
  }
}

/* ---- solving: r is (D, B, columns), a block of threads works on one block of it and one column; SLICES threads share a sum over k ---- */

#define BATCH 12 /* products whose numbers are read before the first is added */

/* Every SLICES-th product of a row and a vector of B, from number `part`. */
template <int B>
static __device__ inline double octo_slice(const double *row, int row_step, const double *x, int x_step, int part) {
  double sum = 0.0;
  for (int from = part; from < B; from += BATCH * SLICES) {
    double one[BATCH], other[BATCH];
    for (int u = 0; u < BATCH; ++u) {
      int k = from + u * SLICES;
      one[u] = k < B ? row[k * row_step] : 0.0;
      other[u] = k < B ? x[k * x_step] : 0.0;
    }
    for (int u = 0; u < BATCH; ++u) sum += one[u] * other[u];
  }
  return sum;
}

static __device__ inline double octo_slices(const double *partial, int size, int e) {
  double sum = 0.0;
  for (int part = 0; part < SLICES; ++part) sum += partial[part * size + e];
  return sum;
}

/* A column of out (B, columns) = Tᵀ x; x (B) and partial (SLICES B) are shared, x written before. */
template <int B>
static __device__ inline void octo_transposed_times(const double *half, const double *x, int columns, double *partial, double *out) {
  BARRIER;
  EACH(item, SLICES * B) partial[item] = octo_slice<B>(half + item % B, B, x, 1, item / B);
  BARRIER;
  EACH(i, B) out[i * columns] = octo_slices(partial, B, i);
}

/* held (E, B, columns) = sign T r of the eliminated blocks, what is left of r for the survivors; grid (S, batch, columns). Shared:
 * (2 + 2 SLICES) B doubles. */
template <int B>
static __device__ inline void octo_fold_of(int D, int first, const double *half, const double *sign, const double *left, const double *right,
                                           const double *r, double *held, double *folded) {
  SHARED(w);
  int s = blockIdx.x, S = gridDim.x, E = D - S, columns = gridDim.z, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B;
  double *partial = w + 2 * B;
  r += member * D * size + blockIdx.z, held += member * E * size + blockIdx.z, folded += member * S * size + blockIdx.z;
  EACH(item, 2 * SLICES * B) { /* side 0: the block before, which this one holds; 1: the block after */
    int side = item / (SLICES * B), i = item / SLICES % B, part = item % SLICES, b = s - first + side;
    if (b < 0 || b >= E) continue;
    double sum = octo_slice<B>(half + (member * E + b) * block + i * B, 1, r + (first + 2 * b) * size, columns, part);
    partial[(side * SLICES + part) * B + i] = sum;
  }
  BARRIER;
  EACH(item, 2 * B) {
    int side = item / B, i = item % B, b = s - first + side;
    if (b < 0 || b >= E) continue;
    double value = sign[(member * E + b) * B + i] * octo_slices(partial + side * SLICES * B, B, i);
    w[item] = value;
    if (side == 0) held[b * size + i * columns] = value;
  }
  BARRIER;
  EACH(item, SLICES * B) {
    int part = item / B, i = item % B, b = s - first;
    double sum = 0.0;
    if (b >= 0 && b < E) sum = octo_slice<B>(right + (member * E + b) * block + i, B, w, 1, part);
    if (b + 1 < E) sum += octo_slice<B>(left + (member * E + b + 1) * block + i, B, w + B, 1, part);
    partial[item] = sum;
  }
  BARRIER;
  EACH(i, B) folded[s * size + i * columns] = r[(1 - first + 2 * s) * size + i * columns] - octo_slices(partial, B, i);
}

/* x of a level from x of its survivors; grid (D, batch, columns); shared: (1 + SLICES) B doubles. */
template <int B>
static __device__ inline void octo_unfold_of(int D, int first, const double *half, const double *sign, const double *left, const double *right,
                                             const double *held, const double *x, double *unfolded) {
  SHARED(y);
  int place = blockIdx.x, E = (D - first) / 2, S = D - E, columns = gridDim.z, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B, at = member * E + place / 2;
  double *out = unfolded + (member * D + place) * size + blockIdx.z, *partial = y + B;
  x += member * S * size + blockIdx.z, held += at * size + blockIdx.z;
  if (place % 2 != first) {
    EACH(i, B) out[i * columns] = x[place / 2 * size + i * columns];
    return;
  }
  const double *after = x + (place / 2 + first) * size, *before = after - size;
  EACH(item, SLICES * B) {
    int i = item / SLICES, part = item % SLICES;
    double sum = octo_slice<B>(right + at * block + i * B, 1, after, columns, part);
    if (place > 0) sum += octo_slice<B>(left + at * block + i * B, 1, before, columns, part);
    partial[part * B + i] = sum;
  }
  BARRIER;
  EACH(i, B) y[i] = held[i * columns] - sign[at * B + i] * octo_slices(partial, B, i);
  octo_transposed_times<B>(half + at * block, y, columns, partial, out);
}

/* The last block: x = Tᵀ sign T r; grid (1, batch, columns); shared: (1 + SLICES) B doubles. */
template <int B>
static __device__ inline void octo_last_of(const double *half, const double *sign, const double *r, double *x) {
  SHARED(y);
  int columns = gridDim.z;
  size_t member = blockIdx.y, at = member * B * columns + blockIdx.z;
  double *partial = y + B;
  half += member * B * B, r += at;
  EACH(item, SLICES * B) partial[item % SLICES * B + item / SLICES] = octo_slice<B>(half + item / SLICES * B, 1, r, columns, item % SLICES);
  BARRIER;
  EACH(i, B) y[i] = sign[member * B + i] * octo_slices(partial, B, i);
  octo_transposed_times<B>(half, y, columns, partial, x + at);
}
