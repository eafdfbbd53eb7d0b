/* A grid of signed distances in bricks of 8 x 8 x 8 coefficients, with a coarse grid where there are none.
   own: size_x size_y size_z 1/cell x y z bricks_x bricks_y bricks_z coarse_x coarse_y coarse_z
   coarse_place | table of the bricks' places, 0: no brick | coarse coefficients | bricks. */
/* The 4 x 4 x 4 coefficients of a cell from its bricks; 0: one of them is missing. */
static int octo_world_cell(const double *own, const int *first, double *values) {
  const double *block[2][2][2];
  int brick[3], within[3];
  for (int axis = 0; axis < 3; axis++) {
    brick[axis] = first[axis] >> 3;
    within[axis] = first[axis] & 7;
  }
  const double *table = own + 14;
  for (int a = 0; a <= (within[0] + 3) >> 3; a++)
    for (int b = 0; b <= (within[1] + 3) >> 3; b++)
      for (int c = 0; c <= (within[2] + 3) >> 3; c++) {
        const size_t row = (size_t)(brick[0] + a) * (size_t)own[8] + (size_t)(brick[1] + b);
        const double place = table[row * (size_t)own[9] + (size_t)(brick[2] + c)];
        if (place == 0.0) return 0;
        block[a][b][c] = own + (size_t)place;
      }
  for (int a = within[0]; a < within[0] + 4; a++)
    for (int b = within[1]; b < within[1] + 4; b++, values += 4) {
      const int row = 64 * (a & 7) + 8 * (b & 7), z = within[2];
      const double *low = block[a >> 3][b >> 3][0] + row;
      if (z <= 4) { /* a row within one brick is read at once */
        for (int c = 0; c < 4; c++) values[c] = low[z + c];
      } else {
        const double *high = block[a >> 3][b >> 3][1] + row;
        for (int c = 0; c < 4; c++) values[c] = z + c < 8 ? low[z + c] : high[z + c - 8];
      }
    }
  return 1;
}

/* The same from the coarse grid. */
static void octo_world_coarse(const double *own, const int *first, double *values) {
  const size_t y = (size_t)own[11] + 4, z = (size_t)own[12] + 4;
  const double *corner = own + (size_t)own[13] + ((size_t)first[0] * y + first[1]) * z + first[2];
  for (int a = 0; a < 4; a++)
    for (int b = 0; b < 4; b++)
      for (int c = 0; c < 4; c++) *values++ = corner[(a * y + b) * z + c];
}

static void octo_world_grid(const double *own, const double *point, int order, double *jet) {
  double image[3][4], weights[3][16], values[64], inner[16][4], middle[4][4][4];
  int first[3];
  for (int axis = 0; axis < 3; axis++) {
    octo_world_image((point[axis] - own[4 + axis]) * own[3], own[axis], image[axis]);
    first[axis] = octo_world_weights(image[axis], own[axis], own[3], weights[axis]);
  }
  if (!octo_world_cell(own, first, values)) {
    for (int axis = 0; axis < 3; axis++) {
      const double *fine = image[axis]; /* in cells of a quarter */
      const double coarse[4] = {0.25 * fine[0], fine[1], 4.0 * fine[2], 16.0 * fine[3]};
      first[axis] = octo_world_weights(coarse, own[10 + axis], 0.25 * own[3], weights[axis]);
    }
    octo_world_coarse(own, first, values);
  }
  for (int row = 0; row < 16; row++) {
    const double *v = values + 4 * row, *w = weights[2];
    for (int d = 0; d < 4; d++)
      inner[row][d] = v[0] * w[d] + v[1] * w[4 + d] + v[2] * w[8 + d] + v[3] * w[12 + d];
  }
  for (int e = 0; e <= order; e++)
    for (int a = 0; a < 4; a++) {
      const double *w = weights[1] + e;
      for (int d = 0; d < 4; d++)
        middle[e][a][d] = inner[4 * a][d] * w[0] + inner[4 * a + 1][d] * w[4] +
                          inner[4 * a + 2][d] * w[8] + inner[4 * a + 3][d] * w[12];
    }
  int k = 0;
  for (int total = 0; total <= order; total++)
    for (int f = total; f >= 0; f--)
      for (int e = total - f; e >= 0; e--) {
        const double *w = weights[0] + f;
        const int d = total - f - e;
        jet[k++] = middle[e][0][d] * w[0] + middle[e][1][d] * w[4] + middle[e][2][d] * w[8] +
                   middle[e][3][d] * w[12];
      }
  /* outside: and how far the point is from its image, summed over the axes */
  const int pure[3][4] = {{0, 1, 4, 10}, {0, 2, 7, 16}, {0, 3, 9, 19}};
  for (int axis = 0; axis < 3; axis++) {
    const double u = (point[axis] - own[4 + axis]) * own[3];
    if (u >= 0.0 && u <= own[axis] - 1.0) continue;
    const double side = u < 0.0 ? -1.0 : 1.0;
    jet[0] += side * (u - image[axis][0]) / own[3];
    if (order > 0) jet[pure[axis][1]] += side * (1.0 - image[axis][1]);
    if (order > 1) jet[pure[axis][2]] -= side * image[axis][2] * own[3];
    if (order > 2) jet[pure[axis][3]] -= side * image[axis][3] * own[3] * own[3];
  }
}
