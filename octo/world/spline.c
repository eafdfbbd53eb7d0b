/* Cubic B-splines on a lattice. Derivatives stand innermost, so that they are computed side by side. */
#ifndef OCTO_WORLD_SPLINE
#define OCTO_WORLD_SPLINE

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

/* The weights of the four coefficients around an image, with three derivatives each by u times
   `inverse` (1/m), weights[4 * tap + derivative]; returns where the first one is stored. A lattice has
   two coefficients beyond each edge. */
static int octo_world_weights(const double *image, double size, double inverse, double *weights) {
  const double at = image[0], square = inverse * inverse, cube = square * inverse;
  const int cell = at > -1.0 ? (at < size ? (int)(at + 1.0) - 1 : (int)size - 1) : -1;
  const double t = at - cell, s = 1.0 - t, sixth = 1.0 / 6.0;
  weights[0] = sixth * s * s * s;
  weights[1] = -0.5 * s * s * inverse;
  weights[2] = s * square;
  weights[3] = -cube;
  weights[4] = (0.5 * t - 1.0) * t * t + 4.0 * sixth;
  weights[5] = (1.5 * t - 2.0) * t * inverse;
  weights[6] = (3.0 * t - 2.0) * square;
  weights[7] = 3.0 * cube;
  weights[8] = (0.5 * s - 1.0) * s * s + 4.0 * sixth;
  weights[9] = (2.0 - 1.5 * s) * s * inverse;
  weights[10] = (3.0 * s - 2.0) * square;
  weights[11] = -3.0 * cube;
  weights[12] = sixth * t * t * t;
  weights[13] = 0.5 * t * t * inverse;
  weights[14] = t * square;
  weights[15] = cube;
  if (image[1] != 1.0) { /* outside: the chain rule */
    const double first = image[1], second = image[2] * inverse, third = image[3] * square;
    for (int tap = 0; tap < 4; tap++, weights += 4) {
      const double once = weights[1], twice = weights[2];
      weights[1] = once * first;
      weights[2] = twice * first * first + once * second;
      weights[3] = weights[3] * first * first * first + 3.0 * twice * first * second + once * third;
    }
  }
  return cell + 1;
}
#endif
