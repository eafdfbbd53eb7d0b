/* H, A and b of Eq. 9 gathered out of the blocks of steps: every number has one writer and its sum one order. After model.cu. */

/* Sums of one place (tables.py) over the blocks of all steps: number ``of`` of a block, ``of_transposed`` of one whose place is
 * negative (~), times a coefficient for each part of a unit or each pair of parts. */
template <int count>
static __device__ __forceinline__ void octo_gather(const int *first, const int *source, const double *value, const double *blocks, int of,
                                                   int of_transposed, double *sum) {
  for (int m = 0; m < count; ++m) sum[m] = 0.0;
#pragma unroll 8
  for (int t = first[0]; t < first[1]; ++t) {
    int at = source[t];
    double taken = blocks[at < 0 ? ~at + of_transposed : at + of];
    for (int m = 0; m < count; ++m) sum[m] += value[t * count + m] * taken;
  }
}

/* Number (r, c) of the blocks of each pair of parts, ``height`` rows each; dummy (parts), or none: 1 on the diagonal of those parts. */
template <int parts>
static __device__ __forceinline__ void octo_gather_pairs(const int *first, const int *source, const double *value, const double *blocks, int of,
                                                         int of_transposed, double scale, const int *dummy, int height, int r, int c, double *out) {
  double sum[parts * parts];
  octo_gather<parts * parts>(first, source, value, blocks, of, of_transposed, sum);
  for (int m = 0; m < parts * parts; ++m)
    out[(m / parts * height + r) * parts * NX + m % parts * NX + c] =
        scale * sum[m] + (dummy && m / parts == m % parts && dummy[m / parts] ? 1.0 : 0.0);
}

template <int parts>
static __device__ __forceinline__ void octo_gather_parts(const int *first, const int *source, const double *value, const double *blocks, int c,
                                                         double *out) {
  double sum[parts];
  octo_gather<parts>(first, source, value, blocks, c, 0, sum);
  for (int m = 0; m < parts; ++m) out[m * NX + c] = sum[m];
}

/* H (units, 3, NCV, NCV) = Sᵀ hess S and b (units, NCV) = Sᵀ gradient, NCV = parts NX; grid (units groups, 3 lags, batch).
 * Parts of units that nothing moves (dummy) are the identity. */
extern "C" __global__ void __launch_bounds__(SMALL, 8)
octo_gather_hessian(int steps, int parts, int groups, const int *first, const int *source, const double *value, const int *b_first,
                    const int *b_source, const double *b_value, const int *dummy, const double *hess, const double *gradient, double *h,
                    double *b) {
  int unit = blockIdx.x / groups, lag = blockIdx.y, nc = parts * NX;
  size_t member = blockIdx.z, own = member * (gridDim.x / groups) + unit;
  h += (own * 3 + lag) * nc * nc; b += own * nc;
  hess += member * steps * 6 * NX * NX; gradient += member * steps * W3;
  for (int e = blockIdx.x % groups * LANES + LANE; e < NX * NX + (lag == 0 ? NX : 0); e += groups * LANES) {
    int r = e / NX, c = e % NX;
    if (e < NX * NX) {
      const int *one = lag == 0 && r == c ? dummy + unit * parts : 0;
      if (parts == 1) octo_gather_pairs<1>(first + 3 * unit + lag, source, value, hess, e, c * NX + r, 1.0, one, NX, r, c, h);
#ifdef FOUR_PARTS
      else if (parts == 4) octo_gather_pairs<4>(first + 3 * unit + lag, source, value, hess, e, c * NX + r, 1.0, one, NX, r, c, h);
#endif
      else octo_gather_pairs<2>(first + 3 * unit + lag, source, value, hess, e, c * NX + r, 1.0, one, NX, r, c, h);
    } else if (parts == 1) {
      octo_gather_parts<1>(b_first + unit, b_source, b_value, gradient, c, b);
#ifdef FOUR_PARTS
    } else if (parts == 4) {
      octo_gather_parts<4>(b_first + unit, b_source, b_value, gradient, c, b);
#endif
    } else {
      octo_gather_parts<2>(b_first + unit, b_source, b_value, gradient, c, b);
    }
  }
}

/* A (units, 3, parts MU, parts NX) = Sᵀ U_/J S, scaled; grid (units, 3 lags, batch). */
extern "C" __global__ void __launch_bounds__(SMALL, 8)
octo_gather_constraints(int steps, int parts, const int *first, const int *source, const double *value, const double *row_scale,
                        const double *jac, double *a) {
#if MU > 0
  int unit = blockIdx.x, lag = blockIdx.y;
  size_t member = blockIdx.z;
  a += ((member * gridDim.x + unit) * 3 + lag) * parts * MU * parts * NX; jac += member * steps * NX * W3;
  EACH(e, MU * NX) {
    int r = e / NX, c = e % NX, of = octo_unactuated[r] * W3 + c;
    double scale = row_scale[member * MU + r];
    if (parts == 1) octo_gather_pairs<1>(first + 3 * unit + lag, source, value, jac, of, 0, scale, 0, MU, r, c, a);
#ifdef FOUR_PARTS
    else if (parts == 4) octo_gather_pairs<4>(first + 3 * unit + lag, source, value, jac, of, 0, scale, 0, MU, r, c, a);
#endif
    else octo_gather_pairs<2>(first + 3 * unit + lag, source, value, jac, of, 0, scale, 0, MU, r, c, a);
  }
#endif
}
