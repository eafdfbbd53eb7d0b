/* A grid of signed distances in bricks of 8 x 8 x 8 coefficients, with a coarse grid where there are none.
   own: size_x size_y size_z 1/cell x y z bricks_x bricks_y bricks_z coarse_x coarse_y coarse_z
   coarse_place | table of the bricks' places, 0: no brick | coarse coefficients | bricks. */
typedef struct {
  const double *block[2][2][2]; /* where the coefficients of a cell are: one block along an axis, or two */
  int within[3], stride[2];     /* the first one's place in its block, of 8 along an axis; steps along x and y */
} octo_world_place;

/* Where a cell's coefficients are in bricks; 0: one of them is missing. */
static int octo_world_in_bricks(const double *own, const int *first, octo_world_place *place) {
  const double *table = own + 14;
  int brick[3], *within = place->within;
  for (int axis = 0; axis < 3; axis++) {
    brick[axis] = first[axis] >> 3;
    within[axis] = first[axis] & 7;
  }
  for (int a = 0; a <= (within[0] + 3) >> 3; a++)
    for (int b = 0; b <= (within[1] + 3) >> 3; b++)
      for (int c = 0; c <= (within[2] + 3) >> 3; c++) {
        const size_t row = (size_t)(brick[0] + a) * (size_t)own[8] + (size_t)(brick[1] + b);
        const double at = table[row * (size_t)own[9] + (size_t)(brick[2] + c)];
        if (at == 0.0) return 0;
        place->block[a][b][c] = own + (size_t)at;
      }
  place->stride[0] = 64;
  place->stride[1] = 8;
  return 1;
}

/* Where they are in the coarse grid, one block. */
static void octo_world_in_coarse(const double *own, const int *first, octo_world_place *place) {
  const int y = (int)own[11] + 4, z = (int)own[12] + 4;
  place->block[0][0][0] = own + (size_t)own[13] + ((size_t)first[0] * y + first[1]) * z + first[2];
  for (int axis = 0; axis < 3; axis++) place->within[axis] = 0;
  place->stride[0] = y * z;
  place->stride[1] = z;
}

/* The sum over z of four coefficients times their weights, with its derivatives (4). */
static void octo_world_along_z(const octo_world_place *place, int x, int y, const double *weights, double *sum) {
  const double *const *block = place->block[x >> 3][y >> 3];
  const int row = place->stride[0] * (x & 7) + place->stride[1] * (y & 7), z = place->within[2];
  double v[4];
  if (z <= 4) { /* in one block, read at once */
    for (int c = 0; c < 4; c++) v[c] = block[0][row + z + c];
  } else {
    for (int c = 0; c < 4; c++) v[c] = z + c < 8 ? block[0][row + z + c] : block[1][row + z + c - 8];
  }
  for (int d = 0; d < 4; d++)
    sum[d] = v[0] * weights[d] + v[1] * weights[4 + d] + v[2] * weights[8 + d] + v[3] * weights[12 + d];
}

static void octo_world_grid(const double *own, const double *point, int order, double *jet) {
  double image[3][4], weights[3][16], inner[4][4], middle[4], outer[4][4][4] = {{{0.0}}};
  int first[3];
  octo_world_place place;
  for (int axis = 0; axis < 3; axis++) {
    octo_world_image((point[axis] - own[4 + axis]) * own[3], own[axis], image[axis]);
    first[axis] = octo_world_weights(image[axis], own[axis], own[3], weights[axis]);
  }
  if (!octo_world_in_bricks(own, first, &place)) {
    for (int axis = 0; axis < 3; axis++) {
      const double *fine = image[axis]; /* in cells of a quarter */
      const double coarse[4] = {0.25 * fine[0], fine[1], 4.0 * fine[2], 16.0 * fine[3]};
      first[axis] = octo_world_weights(coarse, own[10 + axis], 0.25 * own[3], weights[axis]);
    }
    octo_world_in_coarse(own, first, &place);
  }
  for (int a = 0; a < 4; a++) {
    for (int b = 0; b < 4; b++)
      octo_world_along_z(&place, place.within[0] + a, place.within[1] + b, weights[2], inner[b]);
    for (int e = 0; e <= order; e++) {
      const double *w = weights[1] + e;
      for (int d = 0; d < 4; d++)
        middle[d] = inner[0][d] * w[0] + inner[1][d] * w[4] + inner[2][d] * w[8] + inner[3][d] * w[12];
      for (int f = 0; f <= order - e; f++)
        for (int d = 0; d < 4; d++) outer[f][e][d] += middle[d] * weights[0][4 * a + f];
    }
  }
  int k = 0;
  for (int total = 0; total <= order; total++)
    for (int f = total; f >= 0; f--)
      for (int e = total - f; e >= 0; e--) jet[k++] = outer[f][e][total - f - e];
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
