/* The KKT matrix of a batch (Eq. 12): products, block cyclic reduction, refinement; after common.cuh.
 *
 * The text before this one defines NCV and MAV, variables and constraint rows of a unit. Units are paired: an SBT(D, B) of
 * diagonal blocks (D, B, B) and blocks lower (D - 1, B, B) below them, B = 2 (NCV + MAV); for A Aᵀ B = 2 MAV. pivots.cu
 * makes of a block P that is eliminated T and signs with P⁻¹ = Tᵀ diag(sign) T. Grids are (blocks, batch). */

#define UNIT (NCV + MAV)
#define KKT (2 * UNIT)
#define GRAM (2 * MAV)

/* ---- products of blocks: a block of threads makes a tile of TILE x TILE entries, a thread 3 x 3 of them, EDGE apart ---- */

#define TILE 48
#define EDGE 16
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

/* ---- solving: r is (D, B, columns), one block of threads a surviving block; SLICES threads share a sum over k ---- */

#define SLICES 4

/* Every SLICES-th product of a row and a vector of B, from number `part`. */
template <int B>
static __device__ inline double octo_slice(const double *row, int row_step, const double *x, int x_step, int part) {
  double sum = 0.0;
  for (int k = part; k < B; k += SLICES) sum += row[k * row_step] * x[k * x_step];
  return sum;
}

static __device__ inline double octo_slices(const double *partial, int size, int e) {
  double sum = 0.0;
  for (int part = 0; part < SLICES; ++part) sum += partial[part * size + e];
  return sum;
}

/* out (B, columns) = Tᵀ x; x and partial (SLICES B columns) are shared, x written before. */
template <int B>
static __device__ inline void octo_transposed_times(const double *half, const double *x, int columns, double *partial, double *out) {
  int size = B * columns;
  BARRIER;
  EACH(item, SLICES * size) {
    int part = item / size, e = item % size;
    partial[item] = octo_slice<B>(half + e / columns, B, x + e % columns, columns, part);
  }
  BARRIER;
  EACH(e, size) out[e] = octo_slices(partial, size, e);
}

/* held (E, B, columns) = sign T r of the eliminated blocks, what is left of r for the survivors. Shared: (2 + 2 SLICES) B columns. */
template <int B>
static __device__ inline void octo_fold_of(int D, int first, int columns, const double *half, const double *sign, const double *left,
                                           const double *right, const double *r, double *held, double *folded) {
  SHARED(w);
  int s = blockIdx.x, S = gridDim.x, E = D - S, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B;
  double *partial = w + 2 * size;
  EACH(item, 2 * SLICES * size) { /* side 0: the block before, which this one holds; 1: the block after */
    int side = item / (SLICES * size), e = item / SLICES % size, part = item % SLICES, b = s - first + side;
    if (b < 0 || b >= E) continue;
    const double *row = half + (member * E + b) * block + e / columns * B, *x = r + (member * D + first + 2 * b) * size + e % columns;
    partial[(side * SLICES + part) * size + e] = octo_slice<B>(row, 1, x, columns, part);
  }
  BARRIER;
  EACH(item, 2 * size) {
    int side = item / size, e = item % size, b = s - first + side;
    if (b < 0 || b >= E) continue;
    double value = sign[(member * E + b) * B + e / columns] * octo_slices(partial + side * SLICES * size, size, e);
    w[item] = value;
    if (side == 0) held[(member * E + b) * size + e] = value;
  }
  BARRIER;
  EACH(item, SLICES * size) {
    int part = item / size, e = item % size;
    double sum = 0.0;
    for (int side = 0; side < 2; ++side) {
      int b = s - first + side;
      if (b < 0 || b >= E) continue;
      const double *reach = (side == 0 ? right : left) + (member * E + b) * block;
      sum += octo_slice<B>(reach + e / columns, B, w + side * size + e % columns, columns, part);
    }
    partial[item] = sum;
  }
  BARRIER;
  const double *own = r + (member * D + 1 - first + 2 * s) * size;
  double *out = folded + (member * S + s) * size;
  EACH(e, size) out[e] = own[e] - octo_slices(partial, size, e);
}

/* x of a level from x of its survivors; grid (D, batch); shared: (1 + SLICES) B columns. */
template <int B>
static __device__ inline void octo_unfold_of(int D, int first, int columns, const double *half, const double *sign, const double *left,
                                             const double *right, const double *held, const double *x, double *unfolded) {
  SHARED(y);
  int place = blockIdx.x, E = (D - first) / 2, S = D - E, size = B * columns;
  size_t member = blockIdx.y, block = (size_t)B * B;
  double *out = unfolded + (member * D + place) * size, *partial = y + size;
  if (place % 2 != first) {
    const double *own = x + (member * S + place / 2) * size;
    EACH(k, size) out[k] = own[k];
    return;
  }
  size_t at = member * E + place / 2;
  const double *after = x + (member * S + place / 2 + first) * size, *before = after - size;
  EACH(item, SLICES * size) {
    int e = item / SLICES, part = item % SLICES, i = e / columns, c = e % columns;
    double sum = octo_slice<B>(right + at * block + i * B, 1, after + c, columns, part);
    if (place > 0) sum += octo_slice<B>(left + at * block + i * B, 1, before + c, columns, part);
    partial[part * size + e] = sum;
  }
  BARRIER;
  EACH(e, size) y[e] = held[at * size + e] - sign[at * B + e / columns] * octo_slices(partial, size, e);
  octo_transposed_times<B>(half + at * block, y, columns, partial, out);
}

/* The last block: x = Tᵀ sign T r; grid (1, batch); shared: (1 + SLICES) B columns. */
template <int B>
static __device__ inline void octo_last_of(int columns, const double *half, const double *sign, const double *r, double *x) {
  SHARED(y);
  int size = B * columns;
  size_t member = blockIdx.y;
  double *partial = y + size;
  EACH(item, SLICES * size) {
    int e = item / SLICES, part = item % SLICES;
    partial[part * size + e] = octo_slice<B>(half + (member * B + e / columns) * B, 1, r + member * size + e % columns, columns, part);
  }
  BARRIER;
  EACH(e, size) y[e] = sign[member * B + e / columns] * octo_slices(partial, size, e);
  octo_transposed_times<B>(half + member * B * B, y, columns, partial, x + member * size);
}
