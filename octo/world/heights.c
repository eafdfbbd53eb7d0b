/* The jet of z - h: sums over y. ``order`` is a constant. */
static inline void octo_world_heights_sums(const octo_world_four *sums, const octo_world_four *weights, int order, double *jet) {
  OCTO_WORLD_UNROLLED
  for (int total = 0; total <= order; total++) {
    OCTO_WORLD_UNROLLED
    for (int f = total; f >= 0; f--) {
      const octo_world_four *w = weights + (total - f);
      *jet++ = -(sums[f][0] * w[0][1] + sums[f][1] * w[4][1] + sums[f][2] * w[8][1] + sums[f][3] * w[12][1]);
      for (int z = 1; z <= total - f; z++) *jet++ = 0.0;
    }
  }
}

/* A height field, phi = z - h(x, y). own: size_x size_y 1/cell x y | coefficients. */
static void octo_world_heights(const double *own, const double *point, int order, double *jet) {
  octo_world_four weights[16], sums[4] = {{0.0}};
  double image[2][4], t[2];
  int first[2];
  for (int axis = 0; axis < 2; axis++) {
    octo_world_image((point[axis] - own[3 + axis]) * own[2], own[axis], image[axis]);
    const int cell = octo_world_cell(image[axis][0], own[axis]);
    t[axis] = image[axis][0] - cell;
    first[axis] = cell + 1;
  }
  const octo_world_four place = {t[0], t[1], 0.0, 0.0};
  octo_world_basis(&place, own[2], weights);
  for (int axis = 0; axis < 2; axis++)
    if (image[axis][1] != 1.0) octo_world_chain(image[axis], own[2], axis, weights);
  const int stride = (int)own[1] + 4;
  const double *row = own + 5 + (size_t)first[0] * stride + first[1];
  OCTO_WORLD_UNROLLED
  for (int a = 0; a < 4; a++, row += stride) {
    const octo_world_four v = *(const octo_world_four *)row;
    OCTO_WORLD_UNROLLED
    for (int f = 0; f < 4; f++) sums[f] += v * weights[4 * a + f][0];
  }
  switch (order) {
    case 0: octo_world_heights_sums(sums, weights, 0, jet); break;
    case 1: octo_world_heights_sums(sums, weights, 1, jet); break;
    case 2: octo_world_heights_sums(sums, weights, 2, jet); break;
    default: octo_world_heights_sums(sums, weights, 3, jet);
  }
  jet[0] += point[2];
  if (order > 0) jet[3] = 1.0;
}
