/* The KKT matrix of a batch as a symmetric block-tridiagonal matrix of paired units; products; after linear.cu.
 *
 * H (units, 3, NCV, NCV), A (units, 3, MAV, NCV): block o of unit k couples it with unit k - o. active (batch), or none: the
 * members that are worked on; the others keep what they have. */

/* Entry of the matrix of Eq. 12: row r of unit k, column c of unit l, k >= l; units beyond the last are the identity. */
static __device__ inline double octo_kkt_entry(int units, int k, int r, int l, int c, const double *h, const double *a, const double *sigma) {
  if (k - l > 2) return 0.0;
  if (k >= units) return k == l && r == c ? 1.0 : 0.0;
  int lag = k - l;
  if (r < NCV && c < NCV) return h[(((size_t)k * 3 + lag) * NCV + r) * NCV + c] + (lag == 0 && r == c && sigma ? sigma[k] : 0.0);
  if (r >= NCV && c < NCV) return a[(((size_t)k * 3 + lag) * MAV + r - NCV) * NCV + c];
  if (r < NCV && lag == 0) return a[((size_t)k * 3 * MAV + c - NCV) * NCV + r];
  return 0.0;
}

/* Pairs of units as SBT(D, KKT): grid (D, batch); finite (D) is 0 where a block has an entry that is not. */
extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_kkt_blocks(int units, const int *active, const double *h, const double *a, const double *sigma,
                                           double *diagonal, double *lower, int *finite) {
  ONLY(active, blockIdx.y);
  int d = blockIdx.x, D = gridDim.x, broken = 0;
  size_t member = blockIdx.y, size = (size_t)KKT * KKT;
  h += member * units * 3 * NCV * NCV; a += member * units * 3 * MAV * NCV;
  if (sigma) sigma += member * units;
  double *own = diagonal + (member * D + d) * size, *below = lower + (member * (D - 1) + d) * size;
  EACH(e, KKT * KKT) {
    int i = e / KKT, j = e % KKT, k = 2 * d + i / UNIT, l = 2 * d + j / UNIT, r = i % UNIT, c = j % UNIT;
    double value = k >= l ? octo_kkt_entry(units, k, r, l, c, h, a, sigma) : octo_kkt_entry(units, l, c, k, r, h, a, sigma);
    own[e] = value;
    broken |= !isfinite(value);
    if (d == D - 1) continue;
    value = octo_kkt_entry(units, 2 * d + 2 + i / UNIT, r, l, c, h, a, sigma);
    below[e] = value;
    broken |= !isfinite(value);
  }
  broken = __syncthreads_or(broken);
  if (LANE == 0) finite[member * D + d] = !broken;
}

/* finite (batch): 1 where all D blocks of a member are; grid (1, batch). */
extern "C" __global__ void octo_kkt_finite(int D, const int *active, const int *blocks, int *finite) {
  ONLY(active, blockIdx.y);
  size_t member = blockIdx.y;
  int broken = 0;
  EACH(d, D) broken |= !blocks[member * D + d];
  broken = __syncthreads_or(broken);
  if (LANE == 0) finite[member] = !broken;
}

/* What a factorisation found, from the counts (D, 2) of its pivot blocks: good (batch) where the inertia is right, negative
 * eigenvalues beyond the number of constraints (1 where the matrix is not finite), pivots that were rounding.
 * Grid (1, batch); shared: 2 PARTS doubles. */
extern "C" __global__ void octo_kkt_verdict(int D, int units, const int *active, const int *finite, const int *counts, int *good,
                                            int *negative, int *shifted) {
  SHARED(part);
  ONLY(active, blockIdx.y);
  double *more = part + PARTS;
  size_t member = blockIdx.y;
  EACH(p, PARTS) {
    part[p] = more[p] = 0.0;
    for (int d = p; d < D; d += PARTS) part[p] += counts[2 * (member * D + d)], more[p] += counts[2 * (member * D + d) + 1];
  }
  int below = (int)octo_block_sum(part) - units * MAV, rounding = (int)octo_block_sum(more);
  if (LANE == 0) {
    negative[member] = finite[member] ? below : 1;
    shifted[member] = rounding;
    good[member] = finite[member] && below == 0;
  }
}

/* One pass of Ruiz scaling: the largest entry of every row of diag(s) M diag(s) towards 1, from the scales ``old`` (none: 1);
 * grid (D, batch); shared: SLICES KKT doubles. */
extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_kkt_equilibrate(const int *active, const double *diagonal, const double *lower, const double *old,
                                                double *scale) {
  SHARED(most);
  ONLY(active, blockIdx.y);
  int d = blockIdx.x, D = gridDim.x;
  size_t member = blockIdx.y, size = (size_t)KKT * KKT;
  const double *own = diagonal + (member * D + d) * size, *below = lower + (member * (D - 1) + d) * size;
  const double *s = old ? old + (member * D + d) * KKT : 0;
  EACH(item, SLICES * KKT) {
    int i = item / SLICES, part = item % SLICES;
    double top = 0.0;
    for (int j = part; j < KKT; j += SLICES) {
      top = fmax(top, fabs(own[i * KKT + j]) * (s ? s[j] : 1.0));
      if (d > 0) top = fmax(top, fabs((below - size)[i * KKT + j]) * (s ? (s - KKT)[j] : 1.0));
      if (d < D - 1) top = fmax(top, fabs(below[j * KKT + i]) * (s ? (s + KKT)[j] : 1.0));
    }
    most[item] = top;
  }
  BARRIER;
  EACH(i, KKT) {
    double before = s ? s[i] : 1.0, top = 0.0;
    for (int part = 0; part < SLICES; ++part) top = fmax(top, most[i * SLICES + part]);
    top *= before;
    scale[(member * D + d) * KKT + i] = before / sqrt(top > 0.0 ? top : 1.0);
  }
}

/* diag(s) M diag(s) in place; members that are not finite become the identity. Grid (D, batch). */
extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_kkt_scale(const int *active, const int *finite, const double *scale, double *diagonal, double *lower) {
  ONLY(active, blockIdx.y);
  int d = blockIdx.x, D = gridDim.x;
  size_t member = blockIdx.y, size = (size_t)KKT * KKT;
  double *own = diagonal + (member * D + d) * size, *below = lower + (member * (D - 1) + d) * size;
  const double *s = scale + (member * D + d) * KKT;
  int good = finite[member];
  EACH(e, KKT * KKT) {
    int i = e / KKT, j = e % KKT;
    own[e] = good ? own[e] * s[i] * s[j] : i == j ? 1.0 : 0.0;
    if (d < D - 1) below[e] = good ? below[e] * (s + KKT)[i] * s[j] : 0.0;
  }
}

/* r (D, KKT, columns) = s (v, lam) of paired units, 0 for members that are not usable; grid (D, batch). */
extern "C" __global__ void octo_kkt_join(int units, int columns, const int *active, const int *usable, const double *scale, const double *v,
                                         const double *lam, double *r) {
  ONLY(active, blockIdx.y);
  size_t member = blockIdx.y, d = blockIdx.x, D = gridDim.x;
  double *out = r + (member * D + d) * KKT * columns;
  const double *s = scale + (member * D + d) * KKT;
  EACH(e, KKT * columns) {
    int i = e / columns, c = e % columns, k = 2 * (int)d + i / UNIT, u = i % UNIT;
    double value = 0.0;
    if (k < units && u < NCV) value = v[((member * units + k) * NCV + u) * columns + c];
    else if (k < units && lam) value = lam[((member * units + k) * MAV + u - NCV) * columns + c];
    out[e] = usable[member] ? s[i] * value : 0.0;
  }
}

/* (v, lam) = s x, added to what is there with ``more``; NaN for members that are not usable; grid (D, batch). */
extern "C" __global__ void octo_kkt_part(int units, int columns, int more, const int *active, const int *usable, const double *scale,
                                         const double *x, double *v, double *lam) {
  ONLY(active, blockIdx.y);
  size_t member = blockIdx.y, d = blockIdx.x, D = gridDim.x;
  const double *own = x + (member * D + d) * KKT * columns, *s = scale + (member * D + d) * KKT;
  EACH(e, KKT * columns) {
    int i = e / columns, c = e % columns, k = 2 * (int)d + i / UNIT, u = i % UNIT;
    if (k >= units) continue;
    double *out = u < NCV ? v + ((member * units + k) * NCV + u) * columns + c : lam + ((member * units + k) * MAV + u - NCV) * columns + c;
    double value = usable[member] ? s[i] * own[e] : NAN;
    *out = more ? *out + value : value;
  }
}

/* ---- products with H, A and Aᵀ; v is (units, NCV, columns), lam (units, MAV, columns); grid (units, batch) ---- */

/* Of the products of a row, those from number `part` in steps of `parts`. */
static __device__ inline double octo_hessian_row(int units, int k, int i, int c, int columns, const double *h, const double *v, int part,
                                                 int parts) {
  double sum = 0.0;
  for (int o = 0; o <= 2 && o <= k; ++o) {
    const double *row = h + (((size_t)k * 3 + o) * NCV + i) * NCV, *x = v + (size_t)(k - o) * NCV * columns + c;
    for (int j = part; j < NCV; j += parts) sum += row[j] * x[j * columns];
  }
  for (int o = 1; o <= 2 && k + o < units; ++o) {
    const double *column = h + ((size_t)(k + o) * 3 + o) * NCV * NCV + i, *x = v + (size_t)(k + o) * NCV * columns + c;
    for (int j = part; j < NCV; j += parts) sum += column[j * NCV] * x[j * columns];
  }
  return sum;
}

static __device__ inline double octo_row_times(int k, int i, int c, int columns, const double *a, const double *v, int part, int parts) {
  double sum = 0.0;
  for (int o = 0; o <= 2 && o <= k; ++o) {
    const double *row = a + (((size_t)k * 3 + o) * MAV + i) * NCV, *x = v + (size_t)(k - o) * NCV * columns + c;
    for (int j = part; j < NCV; j += parts) sum += row[j] * x[j * columns];
  }
  return sum;
}

static __device__ inline double octo_column_times(int units, int k, int i, int c, int columns, const double *a, const double *lam, int part,
                                                  int parts) {
  double sum = 0.0;
  for (int o = 0; o <= 2 && k + o < units; ++o) {
    const double *column = a + ((size_t)(k + o) * 3 + o) * MAV * NCV + i, *x = lam + (size_t)(k + o) * MAV * columns + c;
    for (int j = part; j < MAV; j += parts) sum += column[j * NCV] * x[j * columns];
  }
  return sum;
}

#define AT_UNIT \
  int k = blockIdx.x, units = gridDim.x; \
  size_t member = blockIdx.y; \
  const size_t v_at = member * units * NCV * columns, c_at = member * units * MAV * columns, own_v = v_at + (size_t)k * NCV * columns, \
               own_c = c_at + (size_t)k * MAV * columns; \
  (void)v_at; (void)c_at; (void)own_v; (void)own_c

/* H v. */
extern "C" __global__ void octo_hessian_times(int columns, const double *h, const double *v, double *out) {
  AT_UNIT;
  EACH(e, NCV * columns)
    out[own_v + e] = octo_hessian_row(units, k, e / columns, e % columns, columns, h + member * units * 3 * NCV * NCV, v + v_at, 0, 1);
}

/* base + factor A v (base may be none). */
extern "C" __global__ void octo_rows_times(int columns, double factor, const double *a, const double *base, const double *v, double *out) {
  AT_UNIT;
  EACH(e, MAV * columns)
    out[own_c + e] = (base ? base[own_c + e] : 0.0) +
                     factor * octo_row_times(k, e / columns, e % columns, columns, a + member * units * 3 * MAV * NCV, v + v_at, 0, 1);
}

/* base + factor Aᵀ lam. */
extern "C" __global__ void octo_rows_transposed_times(int columns, double factor, const double *a, const double *base, const double *lam,
                                                      double *out) {
  AT_UNIT;
  EACH(e, NCV * columns)
    out[own_v + e] = (base ? base[own_v + e] : 0.0) +
                     factor * octo_column_times(units, k, e / columns, e % columns, columns, a + member * units * 3 * MAV * NCV, lam + c_at, 0, 1);
}

/* (left_v, left_c) = (rhs_v, rhs_c) - KKT (v, lam); rhs_c may be none: zero. tops (units, columns, 2): the largest entry of what is
 * left and of the right-hand side. Grid (units, batch, columns); shared: (SLICES + 2) UNIT doubles. */
extern "C" __global__ void __launch_bounds__(PARTS, 4) octo_kkt_residual(const int *active, const double *h, const double *a, const double *sigma,
                                                                      const double *rhs_v, const double *rhs_c, const double *v,
                                                                      const double *lam, double *left_v, double *left_c, double *tops) {
  SHARED(partial);
  ONLY(active, blockIdx.y);
  int columns = gridDim.z, column = blockIdx.z;
  AT_UNIT;
  double *left = partial + SLICES * UNIT, *right = left + UNIT;
  h += member * units * 3 * NCV * NCV; a += member * units * 3 * MAV * NCV; v += v_at; lam += c_at;
  EACH(item, SLICES * UNIT) {
    int i = item / SLICES, part = item % SLICES;
    double sum = 0.0;
    if (i < NCV)
      sum = octo_hessian_row(units, k, i, column, columns, h, v, part, SLICES) + octo_column_times(units, k, i, column, columns, a, lam, part, SLICES);
    else sum = octo_row_times(k, i - NCV, column, columns, a, v, part, SLICES);
    partial[part * UNIT + i] = sum;
  }
  BARRIER;
  double weight = sigma ? sigma[member * units + k] : 0.0;
  EACH(i, UNIT) {
    size_t e = i < NCV ? own_v + i * columns + column : own_c + (i - NCV) * columns + column;
    double given = i < NCV ? rhs_v[e] : rhs_c ? rhs_c[e] : 0.0, value = given - octo_slices(partial, UNIT, i);
    if (i < NCV) left_v[e] = value -= weight * v[e - v_at];
    else left_c[e] = value;
    left[i] = fabs(value), right[i] = fabs(given);
  }
  BARRIER;
  EACH(side, 2) {
    const double *of = side ? right : left;
    double most = 0.0;
    for (int i = 0; i < UNIT; ++i) most = octo_larger(of[i], most);
    tops[((member * units + k) * columns + column) * 2 + side] = most;
  }
}

/* residual (columns): the largest of what is left by the largest of the right-hand side, from tops (units, columns, 2); coarse: where
 * one of them is above the tolerance. Grid (1, batch); shared: 2 PARTS doubles. */
extern "C" __global__ void octo_kkt_check(int units, int columns, double tolerance, const int *active, const double *tops, double *residual,
                                          int *coarse) {
  SHARED(left);
  ONLY(active, blockIdx.y);
  double *right = left + PARTS;
  size_t member = blockIdx.y;
  int more = 0;
  for (int c = 0; c < columns; ++c) {
    EACH(p, PARTS) {
      left[p] = right[p] = 0.0;
      for (int k = p; k < units; k += PARTS) {
        const double *own = tops + ((member * units + k) * columns + c) * 2;
        left[p] = octo_larger(own[0], left[p]), right[p] = octo_larger(own[1], right[p]);
      }
    }
    double most = octo_block_max(left), size = octo_block_max(right), ratio = most / (size > 0.0 ? size : 1.0);
    if (LANE == 0) residual[member * columns + c] = ratio;
    more |= ratio > tolerance;
  }
  if (LANE == 0) coarse[member] = more;
}

/* Of each unit: the largest |delta|, the largest |b + Aᵀ lam| and b delta; grid (units, batch); shared: 3 PARTS doubles. */
extern "C" __global__ void octo_step_numbers(const double *a, const double *b, const double *delta, const double *lam, double *numbers) {
  SHARED(moved);
  double *dual = moved + PARTS, *slope = dual + PARTS;
  const int columns = 1;
  AT_UNIT;
  EACH(p, PARTS) {
    double most = 0.0, steepest = 0.0, sum = 0.0;
    for (int i = p; i < NCV; i += PARTS) {
      double gradient = b[own_v + i], column = octo_column_times(units, k, i, 0, 1, a + member * units * 3 * MAV * NCV, lam + c_at, 0, 1);
      most = octo_larger(fabs(delta[own_v + i]), most);
      steepest = octo_larger(fabs(gradient + column), steepest);
      sum += gradient * delta[own_v + i];
    }
    moved[p] = most, dual[p] = steepest, slope[p] = sum;
  }
  double most = octo_block_max(moved), steepest = octo_block_max(dual), sum = octo_block_sum(slope);
  double *out = numbers + (member * units + k) * 3;
  if (LANE == 0) out[0] = most, out[1] = steepest, out[2] = sum;
}

/* unknowns = at + length delta with length = min(limit, cap / largest |delta|); numbers (units, 3) are those of octo_step_numbers,
 * bounds (2) limit and cap of each member. Grid (units, batch); shared: PARTS doubles. */
extern "C" __global__ void octo_advance(const double *bounds, const double *numbers, const double *at, const double *delta, double *unknowns) {
  SHARED(part);
  const int columns = 1;
  AT_UNIT;
  EACH(p, PARTS) {
    double most = 0.0;
    for (int e = p; e < units; e += PARTS) most = octo_larger(numbers[(member * units + e) * 3], most);
    part[p] = most;
  }
  double most = octo_block_max(part), length = fmin(bounds[2 * member], bounds[2 * member + 1] / fmax(most, 1e-300));
  EACH(i, NCV) unknowns[own_v + i] = at[own_v + i] + length * delta[own_v + i];
}

/* x with its sign turned. */
extern "C" __global__ void octo_negative(int count, const double *x, double *out) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) out[e] = -x[e];
}

/* ‖C‖₁ of each unit; count = batch units. */
extern "C" __global__ void octo_unit_sizes(int count, const double *c, double *sizes) {
  for (int unit = blockIdx.x * blockDim.x + threadIdx.x; unit < count; unit += gridDim.x * blockDim.x) {
    double sum = 0.0;
    for (int i = 0; i < MAV; ++i) sum += fabs(c[(size_t)unit * MAV + i]);
    sizes[unit] = sum;
  }
}

/* The minimiser z of gᵀz + zᵀBz / 2 over |z| <= radius, B = [[a, b], [b, c]] with the multiplier ``shift`` of the ball. */
static __device__ inline double octo_two_at(double shift, double a, double b, double c, double g1, double g2, double *z1, double *z2) {
  double d = fmax((a + shift) * (c + shift) - b * b, 1e-300);
  *z1 = -((c + shift) * g1 - b * g2) / d;
  *z2 = -((a + shift) * g2 - b * g1) / d;
  return *z1 * *z1 + *z2 * *z2;
}

/* two_by_two of subproblem.py; a thread a member. */
extern "C" __global__ void octo_two_by_two(int batch, const double *aa, const double *bb, const double *cc, const double *gg1,
                                           const double *gg2, const double *radius, double *z1, double *z2) {
  for (int k = blockIdx.x * blockDim.x + threadIdx.x; k < batch; k += gridDim.x * blockDim.x) {
    double a = aa[k], b = bb[k], c = cc[k], g1 = gg1[k], g2 = gg2[k], room = radius[k] * radius[k];
    double mean = 0.5 * (a + c), half = sqrt(0.25 * (a - c) * (a - c) + b * b);
    double least = sqrt(g1 * g1 + g2 * g2) / fmax(radius[k], 1e-300); /* the multiplier where the Hessian is zero */
    double low = fmax(0.0, half - mean) + 1e-14 * fmax(fabs(mean) + half, fmax(least, 1e-300)), high = low + least + 1e-300;
    if (octo_two_at(low, a, b, c, g1, g2, z1 + k, z2 + k) <= room) continue;
    for (int step = 0; step < 60; ++step) {
      double middle = 0.5 * (low + high);
      if (octo_two_at(middle, a, b, c, g1, g2, z1 + k, z2 + k) > room) low = middle;
      else high = middle;
    }
    octo_two_at(high, a, b, c, g1, g2, z1 + k, z2 + k);
  }
}
