/* A pivot block P (B, B) of block cyclic reduction, factored in place by one block of threads; after common.cuh.
 *
 * Complete pivoting (Bunch and Parlett 1971), P = L diag(2x2 and 1x1) Lᵀ in the order of the pivots; the 2x2 pivots are
 * diagonalised by a rotation, so that P⁻¹ = Tᵀ diag(sign) T with T = |diag|^-½ Qᵀ L⁻¹, and the signs are the block's inertia.
 * The pivots follow one another, so what counts is how long one takes: rows stay where they are (a list of those that are left
 * takes the place of swaps), every thread works out the pivot for itself, and there is one barrier a pivot. */

#define ALPHA 0.6403882032022076 /* (1 + sqrt 17) / 8 */

/* ---- the largest entry: by the first 32 bits of its size (20 of them after the point), of equals the last one: by pairs of columns,
 * rows, columns ---- */

typedef struct { unsigned size, place; } octo_entry;
#define ROW_BITS 15

/* best: on the diagonal (0) and below it (1); entries come in the order of their places. */
static __device__ inline void octo_note(octo_entry *best, double value, int i, int j) {
  octo_entry own = {(unsigned)(__double_as_longlong(value) >> 32) & 0x7fffffff, (unsigned)j / 2 << (ROW_BITS + 1) | i << 1 | j % 2};
  if (i == j && own.size >= best[0].size) best[0] = own;
  if (i > j && own.size >= best[1].size) best[1] = own;
}
static __device__ inline double octo_size(octo_entry e) { return __longlong_as_double((long long)e.size << 32); }
static __device__ inline int octo_row(octo_entry e) { return (int)(e.place >> 1 & ((1u << ROW_BITS) - 1)); }
static __device__ inline int octo_column(octo_entry e) { return (int)(e.place >> (ROW_BITS + 1) << 1 | e.place % 2); }

#define WARP 32
#define WARPS ((LANES + WARP - 1) / WARP)
#define MOST_WARPS 32

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800 /* in one instruction since */
static __device__ inline unsigned __reduce_max_sync(unsigned mask, unsigned value) {
  for (int reach = WARP / 2; reach; reach /= 2) value = max(value, __shfl_xor_sync(mask, value, reach));
  return value;
}
#endif

static __device__ inline octo_entry octo_warp_top(octo_entry own) {
  octo_entry top;
  top.size = __reduce_max_sync(0xffffffff, own.size);
  top.place = __reduce_max_sync(0xffffffff, own.size == top.size ? own.place : 0u);
  return top;
}

/* best: the largest that a thread has seen on the diagonal (0) and below it (1), and then that all have. seen (2 MOST_WARPS): not
 * in use by the call before. */
static __device__ inline void octo_agree(octo_entry *seen, octo_entry *best) {
  for (int c = 0; c < 2; ++c) {
    octo_entry own = octo_warp_top(best[c]);
    if (LANE % WARP == 0) seen[c * MOST_WARPS + LANE / WARP] = own;
  }
  BARRIER;
  for (int c = 0; c < 2; ++c) {
    octo_entry top = {0, 0};
    for (int w = LANE % WARP; w < WARPS; w += LANES < WARP ? LANES : WARP) {
      octo_entry other = seen[c * MOST_WARPS + w];
      if (other.size > top.size || (other.size == top.size && other.place > top.place)) top = other;
    }
    best[c] = octo_warp_top(top);
  }
}

/* ---- elimination ---- */

/* Rows p and q (q = p: one alone) of the pivot, and its inverse [[f, -g], [-g, h]]. */
typedef struct { int p, q; double f, g, h; } octo_chosen;

/* How the threads share the entries: pairs of columns `pair`, `pair` + `pairs`, ... of rows number `group`, `group` + `groups`, ... */
typedef struct { int pair, pairs, group, groups; } octo_share;

template <int B> static __device__ inline octo_share octo_shared() {
  int pairs = B / 2;
  while (pairs > LANES || (pairs > WARP && LANES / pairs < 4)) pairs = (pairs + 1) / 2;
  octo_share share = {LANE % pairs, pairs, LANE / pairs, LANES / pairs};
  return share;
}

typedef struct __align__(2 * sizeof(double)) { double at[2]; } octo_two;

/* The `count` rows of the list lose their multiples of the SIZE pivot rows; columns eliminated before hold L⁻¹ as it grows, the others
 * what is left of P, of which `best` gets the largest entries that this thread leaves behind. */
template <int B, int SIZE>
static __device__ inline void octo_eliminate(double *w, octo_chosen pivot, octo_share share, const int *list, int count, const int *gone,
                                             octo_entry *best) {
  static_assert(B % 2 == 0, "columns go in pairs");
  const int p = pivot.p, q = pivot.q, rows = B > 64 ? 4 : 2; /* of a thread, under way at a time */
  best[0].size = best[1].size = best[0].place = best[1].place = 0;
  if (share.group >= share.groups) return;
  for (int left = 2 * share.pair; left < B; left += 2 * share.pairs) {
    int kept[2], alive[2];
    double first[2], second[2];
    for (int s = 0; s < 2; ++s) {
      int j = left + s;
      kept[s] = j != p && (SIZE == 1 || j != q), alive[s] = kept[s] && !gone[j];
      double one = kept[s] ? w[p * B + j] : j == p, other = SIZE == 1 ? 0.0 : kept[s] ? w[q * B + j] : j == q;
      first[s] = pivot.f * one - (SIZE == 1 ? 0.0 : pivot.g * other), second[s] = pivot.h * other - pivot.g * one;
    }
    for (int e = share.group; e < count; e += rows * share.groups) {
      int row[rows];
      octo_two value[rows];
      for (int r = 0; r < rows; ++r) row[r] = list[e + r * share.groups < count ? e + r * share.groups : e];
      for (int r = 0; r < rows; ++r) {
        value[r] = *(const octo_two *)(w + row[r] * B + left);
        for (int s = 0; s < 2; ++s) {
          value[r].at[s] = (kept[s] ? value[r].at[s] : 0.0) - w[p * B + row[r]] * first[s];
          if (SIZE > 1) value[r].at[s] -= w[q * B + row[r]] * second[s];
        }
      }
      for (int r = 0; r < rows; ++r) {
        if (e + r * share.groups >= count || row[r] == p || (SIZE > 1 && row[r] == q)) continue;
        *(octo_two *)(w + row[r] * B + left) = value[r];
        for (int s = 0; s < 2; ++s)
          if (alive[s]) octo_note(best, value[r].at[s], row[r], left + s);
      }
    }
  }
}

/* What one pivot after the other leaves: row order[e] of w was eliminated as number e, with the one before it where
 * begin[e] < e; `eliminated` of them, of which `negative` eigenvalues are negative. */
typedef struct { int eliminated, negative; } octo_eliminated;

template <int B>
static __device__ inline octo_eliminated octo_pivots(double *w, octo_entry *seen, int *list, int *gone, int *order, int *begin,
                                                     double rounding, double shift) {
  octo_share share = octo_shared<B>();
  octo_entry best[2] = {{0, 0}, {0, 0}};
  octo_eliminated done = {0, 0};
  EACH(i, B) { list[i] = i; gone[i] = 0; }
  EACH(e, B * B) {
    int j = e / (2 * B) * 2 + e % 2, i = e / 2 % B;
    octo_note(best, w[j * B + i], i, j);
  }
  for (int turn = 0; done.eliminated < B; turn ^= 1) {
    octo_agree(seen + turn * 2 * MOST_WARPS, best);
    double single = octo_size(best[0]), pair = octo_size(best[1]);
    if (!(single > rounding || pair > rounding)) break;
    int two = shift > 0.0 && single < ALPHA * pair, k = done.eliminated, count = B - k;
    octo_entry chosen = two ? best[1] : best[0];
    int p = octo_column(chosen), q = octo_row(chosen);
    double a = w[p * B + p], b = w[q * B + p], c = w[q * B + q];
    if (shift == 0.0 && !(a > rounding)) break; /* not positive: rounding, where shift is 0 */
    double inverse = 1.0 / (two ? a * c - b * b : a);
    octo_chosen pivot = {p, q, two ? c * inverse : inverse, two ? b * inverse : 0.0, two ? a * inverse : 0.0};
    const int *now = list + turn * B;
    int *next = list + (turn ^ 1) * B;
    EACH(e, count) {
      int i = now[e];
      if (i != p && i != q) next[e - (i > p) - (two && i > q)] = i;
    }
    if (LANE == 0) {
      gone[p] = gone[q] = 1;
      order[k] = p, begin[k] = k;
      if (two) order[k + 1] = q, begin[k + 1] = k;
    }
    if (two) octo_eliminate<B, 2>(w, pivot, share, now, count, gone, best);
    else octo_eliminate<B, 1>(w, pivot, share, now, count, gone, best);
    done.eliminated += 1 + two;
    done.negative += two || a < 0.0; /* the determinant of a 2x2 pivot is negative */
    if (done.eliminated == B) break;
  }
  BARRIER;
  EACH(i, B) if (!gone[i]) { /* in the order in which they stand */
    int e = done.eliminated;
    for (int j = 0; j < i; ++j) e += !gone[j];
    order[e] = i, begin[e] = done.eliminated;
  }
  BARRIER;
  return done;
}

/* Row e of T is own[e] times row order[e] of L⁻¹ and other[e] times that of its partner; sign (B): of its eigenvalue. */
template <int B>
static __device__ inline void octo_rotations(const double *w, const int *order, const int *begin, int eliminated, double shift, double *sign,
                                             double *own, double *other, int *partner) {
  EACH(e, B) {
    int first = begin[e], paired = e < eliminated && (first < e || (e + 1 < eliminated && begin[e + 1] == e)), p = order[first];
    double d = e < eliminated ? w[order[e] * B + order[e]] : -shift, cosine = 1.0, sine = 0.0;
    if (paired) { /* [[a, b], [b, c]] is turned until it is diagonal */
      int q = order[first + 1];
      double a = w[p * B + p], b = w[q * B + p], c = w[q * B + q];
      double t = 0.5 * (c - a) / b, tangent = (t < 0 ? -1.0 : 1.0) / (fabs(t) + sqrt(1.0 + t * t));
      cosine = 1.0 / sqrt(1.0 + tangent * tangent);
      sine = first == e ? -tangent * cosine : tangent * cosine;
      d = first == e ? a - tangent * b : c + tangent * b;
    }
    double scale = d != 0.0 ? 1.0 / sqrt(fabs(d)) : 0.0;
    sign[e] = d > 0.0 ? 1.0 : d < 0.0 ? -1.0 : 0.0;
    own[e] = cosine * scale, other[e] = sine * scale;
    partner[e] = !paired ? e : first == e ? e + 1 : first;
  }
}

/* T (B, B) and sign (B) of one pivot block w. Pivots that are nothing but rounding become -shift, or none at all (sign 0) when
 * shift is 0; counts gets the negative ones and those. scratch: PIVOT_BYTES(B) of shared memory. */
#define PIVOT_BYTES(B) (4 * MOST_WARPS * sizeof(octo_entry) + (B) * (2 * sizeof(double) + 6 * sizeof(int)))
template <int B>
static __device__ inline void octo_pivot(double *w, double *scratch, double rounding, double shift, double *half, double *sign, int *counts) {
  static_assert(B <= 1 << ROW_BITS, "the place of an entry must fit into a word");
  octo_entry *seen = (octo_entry *)scratch;
  double *own = (double *)(seen + 4 * MOST_WARPS), *other = own + B;
  int *list = (int *)(other + B), *gone = list + 2 * B, *order = gone + B, *begin = order + B, *partner = begin + B, *number = gone;
  octo_eliminated done = octo_pivots<B>(w, seen, list, gone, order, begin, rounding, shift);
  octo_rotations<B>(w, order, begin, done.eliminated, shift, sign, own, other, partner);
  EACH(e, B) number[order[e]] = e;
  BARRIER;
  EACH(at, B * B) {
    int e = at / B, j = at % B, row = order[e], mate = order[partner[e]];
    int before = number[j] < begin[e]; /* eliminated before: the part of L⁻¹ that is not the identity */
    double mine = before ? w[row * B + j] : j == row, theirs = before ? w[mate * B + j] : j == mate;
    half[at] = own[e] * mine + other[e] * theirs;
  }
  if (LANE == 0) {
    counts[0] = done.negative + (shift > 0.0 ? B - done.eliminated : 0);
    counts[1] = B - done.eliminated;
  }
}

/* Block number e of `count` eliminated ones stands at first + 2 e of the level's D blocks; its counts at place + e of `places`.
 * Shared: PIVOT_BYTES(B) and, where SHARED_BYTES allow it, the block. */
template <int B>
static __device__ inline void octo_pivots_of(int D, int first, double rounding, double shift, int places, int place, double *diagonal,
                                             double *half, double *sign, int *counts) {
  SHARED(scratch);
  size_t member = blockIdx.y, e = blockIdx.x, count = gridDim.x, at = member * count + e;
  double *w = diagonal + (member * D + first + 2 * e) * B * B, *own = half + at * B * B;
  counts += 2 * (member * places + place + e);
  if constexpr (PIVOT_BYTES(B) + sizeof(double) * B * B <= SHARED_BYTES) {
    double *copy = scratch + PIVOT_BYTES(B) / sizeof(double);
    EACH(k, B * B) copy[k] = w[k];
    BARRIER;
    octo_pivot<B>(copy, scratch, rounding, shift, own, sign + at * B, counts);
  } else {
    octo_pivot<B>(w, scratch, rounding, shift, own, sign + at * B, counts);
  }
}

