/* Cubic B-splines on a lattice, four numbers side by side. */
#ifndef OCTO_WORLD_SPLINE
#define OCTO_WORLD_SPLINE

#ifdef __CUDACC_RTC__
#define OCTO_WORLD_UNROLLED _Pragma("unroll")
struct octo_world_four {
  double of[4];
  octo_world_four(double all = 0.0) { for (int k = 0; k < 4; k++) of[k] = all; }
  octo_world_four(double a, double b, double c, double d = 0.0) { of[0] = a; of[1] = b; of[2] = c; of[3] = d; }
  double &operator[](int k) { return of[k]; }
  double operator[](int k) const { return of[k]; }
  octo_world_four &operator+=(const octo_world_four &b) { for (int k = 0; k < 4; k++) of[k] += b.of[k]; return *this; }
};
#define OCTO_WORLD_EACH(op) \
  inline octo_world_four operator op(octo_world_four a, const octo_world_four &b) { \
    for (int k = 0; k < 4; k++) a.of[k] = a.of[k] op b.of[k]; \
    return a; \
  }
OCTO_WORLD_EACH(+) OCTO_WORLD_EACH(-) OCTO_WORLD_EACH(*)
#else
#define OCTO_WORLD_UNROLLED _Pragma("GCC unroll 4")
typedef double octo_world_four __attribute__((vector_size(32), aligned(8), may_alias)); /* anywhere in memory */
typedef long long octo_world_mask __attribute__((vector_size(32)));
#endif

/* The image of a place u (in cells, from sample 0) on a lattice of `size` samples, and its first three
   derivatives: u itself over the lattice; outside, it tends to one cell beyond the edge (C3). */
static void octo_world_image(double u, double size, double *image) {
  const double last = size - 1.0;
  const double side = u > last ? 1.0 : u < 0.0 ? -1.0 : 0.0;
  image[0] = u;
  image[1] = 1.0;
  image[2] = image[3] = 0.0;
  if (side != 0.0) {
    const double beyond = fmin(side > 0.0 ? u - last : -u, 1e30);
    const double inverse = 1.0 / (1.0 + beyond * beyond * beyond), root = cbrt(inverse);
    const double square = root * inverse * inverse;
    image[0] = (side > 0.0 ? last : 0.0) + side * beyond * root;
    image[1] = root * inverse;
    image[2] = -4.0 * side * beyond * beyond * square;
    image[3] = (28.0 * beyond * beyond * beyond * inverse - 8.0) * beyond * square;
  }
}

/* The cell of an image. Four coefficients are around it, the first one stored at the next number: a lattice has two
   beyond each edge. */
static int octo_world_cell(double at, double size) {
  return at > -1.0 ? (at < size ? (int)(at + 1.0) - 1 : (int)size - 1) : -1;
}

/* The weights of the four coefficients around a place t, in its cell, of up to four axes side by side, with three
   derivatives each by t times `inverse` (1/m): weights[4 * tap + derivative][axis]. */
static void octo_world_basis(const octo_world_four *place, double inverse, octo_world_four *weights) {
  const octo_world_four t = *place, s = 1.0 - t, t2 = t * t, s2 = s * s, one = t + s;
  const double sixth = 1.0 / 6.0, square = inverse * inverse, cube = square * inverse;
  weights[0] = sixth * s2 * s;
  weights[1] = -0.5 * inverse * s2;
  weights[2] = square * s;
  weights[3] = -cube * one;
  weights[4] = (0.5 * t - 1.0) * t2 + 4.0 * sixth;
  weights[5] = (1.5 * t - 2.0) * (inverse * t);
  weights[6] = square * (3.0 * t - 2.0);
  weights[7] = 3.0 * cube * one;
  weights[8] = (0.5 * s - 1.0) * s2 + 4.0 * sixth;
  weights[9] = (2.0 - 1.5 * s) * (inverse * s);
  weights[10] = square * (3.0 * s - 2.0);
  weights[11] = -3.0 * cube * one;
  weights[12] = sixth * t2 * t;
  weights[13] = 0.5 * inverse * t2;
  weights[14] = square * t;
  weights[15] = cube * one;
}

/* Outside of the lattice along an axis: the chain rule, with derivatives of the image in cells of 1/`inverse`. */
static void octo_world_chain(const double *image, double inverse, int axis, octo_world_four *weights) {
  const double first = image[1], second = image[2] * inverse, third = image[3] * inverse * inverse;
  for (int tap = 0; tap < 4; tap++, weights += 4) {
    const double once = weights[1][axis], twice = weights[2][axis];
    weights[1][axis] = once * first;
    weights[2][axis] = twice * first * first + once * second;
    weights[3][axis] = weights[3][axis] * first * first * first + 3.0 * twice * first * second + once * third;
  }
}
#endif
