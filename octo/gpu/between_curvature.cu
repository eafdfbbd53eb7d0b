/* Curvature of exact terms over neighbouring Hermite controls, after between.cu: BENT of them, BS numbers of the upper triangles
 * of Σ r ∂²r to (c_k, c_{k+1}), those of term k from octo_between_bend_first[k] on. */

/* The numbers second (BS) of one segment, times twice their coefficients; one thread for each term. */
static __device__ inline void octo_between_curvature(int length, const double *controls, const double *q, double *second) {
  EACH(k, BENT) {
    double *out = second + octo_between_bend_first[k], weight = 0.0;
    for (int step = length - 1; step >= 0; --step) weight += q[octo_between_bend_term[k] - step * BQ];
    const double *arg[3] = {controls, controls + BC, q};
    double *res[1] = {out};
    octo_between_second(k, arg, res);
    for (int z = 0; z < octo_between_bend_first[k + 1] - octo_between_bend_first[k]; ++z)
      out[z] = weight != 0.0 ? 2.0 * weight * out[z] : 0.0; /* it may not be finite there */
  }
  BARRIER;
}

/* Adds to H (units, 3, BC, BC), of unit z, which is c_{z+1}, what the segments before and after it have, and what the one before has
 * between it and the unit before; one term after the other. Pinned units stay as they are: dummy (units, 2). Grid (segments, batch);
 * shared: BS doubles. */
extern "C" __global__ void octo_between_bend(int length, const int *curved, const int *dummy, const double *controls, const double *q,
                                             double *h) {
  SHARED(second);
  int unit = blockIdx.x, segments = gridDim.x, joined = unit > 0 && !dummy[2 * unit - 2];
  size_t member = blockIdx.y;
  if (dummy[2 * unit] || (curved && !curved[member])) return;
  h += (member * (segments + 1) + unit) * 3 * BC * BC;
  for (int after = 0; after < 2 && unit + after < segments; ++after) {
    size_t segment = member * segments + unit + after;
    octo_between_curvature(length, controls + (segment + member) * BC, q + ((segment + 1) * length - 1) * BQ, second);
    for (int k = 0; k < BENT; ++k) {
      EACH(e, octo_between_bend_first[k + 1] - octo_between_bend_first[k]) {
        int z = octo_between_bend_first[k] + e, a = octo_between_bend_row[z], b = octo_between_bend_column[z]; /* a <= b */
        int i = a % BC, j = b % BC;
        if (after ? b < BC : a >= BC) {
          h[i * BC + j] += second[z];
          if (i != j) h[j * BC + i] += second[z];
        } else if (!after && joined && a < BC && b >= BC) h[(BC + j) * BC + i] += second[z];
      }
      BARRIER;
    }
  }
}
