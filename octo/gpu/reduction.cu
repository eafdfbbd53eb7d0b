/* The kernels of linear.cu for one kind of matrix: NAME and NAME_BLOCK, the size of its blocks, are replaced (linear.py).
 * active (batch), or none: the members that are worked on. */

extern "C" __global__ void octo_NAME_pivots(int D, int first, double rounding, double shift, int places, int place,
                                                const int *active, double *diagonal, double *half, double *sign, int *counts) {
  ONLY(active, blockIdx.y);
  octo_pivots_of<NAME_BLOCK>(D, first, rounding, shift, places, place, diagonal, half, sign, counts);
}

extern "C" __global__ void __launch_bounds__(EDGE * EDGE) octo_NAME_couple(int D, int first, const int *active, const double *lower, const double *half, double *left,
                                                double *right) {
  ONLY(active, blockIdx.z);
  octo_couple_of<NAME_BLOCK>(D, first, lower, half, left, right);
}

extern "C" __global__ void __launch_bounds__(EDGE * EDGE) octo_NAME_complement(int D, int first, const int *active, const double *diagonal, const double *sign,
                                                    const double *left, const double *right, double *new_diagonal, double *new_lower) {
  ONLY(active, blockIdx.z);
  octo_complement_of<NAME_BLOCK>(D, first, diagonal, sign, left, right, new_diagonal, new_lower);
}

extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_NAME_fold(int D, int first, const int *active, const double *half, const double *sign,
                                                                 const double *left, const double *right, const double *r, double *held,
                                                                 double *folded) {
  ONLY(active, blockIdx.y);
  octo_fold_of<NAME_BLOCK>(D, first, half, sign, left, right, r, held, folded);
}

extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_NAME_unfold(int D, int first, const int *active, const double *half, const double *sign,
                                                                   const double *left, const double *right, const double *held, const double *x,
                                                                   double *unfolded) {
  ONLY(active, blockIdx.y);
  octo_unfold_of<NAME_BLOCK>(D, first, half, sign, left, right, held, x, unfolded);
}

extern "C" __global__ void __launch_bounds__(WIDE, 2) octo_NAME_last(const int *active, const double *half, const double *sign, const double *r, double *x) {
  ONLY(active, blockIdx.y);
  octo_last_of<NAME_BLOCK>(half, sign, r, x);
}
