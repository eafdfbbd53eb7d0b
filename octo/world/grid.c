/* A grid of signed distances in bricks of 8 x 8 x 8 coefficients, with a coarse grid where there are none.
   own: size_x size_y size_z 1/cell x y z bricks_x bricks_y bricks_z coarse_x coarse_y coarse_z
   coarse_place | table of the bricks' places, 0: no brick | coarse coefficients | bricks. */
typedef struct {
  const double *row[4][4], *next[4][4]; /* of x and y: where the four coefficients along z are in one brick and in the next one */
  int count;                            /* how many of the four are in the first */
} octo_world_rows;

/* Where a cell's coefficients are in bricks; 0: one of them is missing. */
static int octo_world_in_bricks(const double *own, const int *first, octo_world_rows *rows) {
  const size_t y_bricks = (size_t)own[8], z_bricks = (size_t)own[9];
  const int x = first[0] & 7, y = first[1] & 7, z = first[2] & 7, beyond = z > 4;
  const double *entry = own + 14 + (((size_t)first[0] >> 3) * y_bricks + ((size_t)first[1] >> 3)) * z_bricks + ((size_t)first[2] >> 3);
  const double *low[4], *high[4];
  for (int a = 0; a <= (x > 4); a++)
    for (int b = 0; b <= (y > 4); b++) {
      const double *at = entry + (a * y_bricks + b) * z_bricks;
      const double one = at[0], other = at[beyond];
      if (one == 0.0 || other == 0.0) return 0;
      low[2 * a + b] = own + (size_t)one + z;
      high[2 * a + b] = own + (size_t)other + z - 8 * beyond;
    }
  for (int a = 0; a < 4; a++)
    for (int b = 0; b < 4; b++) {
      const int brick = 2 * ((x + a) >> 3) + ((y + b) >> 3), place = 64 * ((x + a) & 7) + 8 * ((y + b) & 7);
      rows->row[a][b] = low[brick] + place;
      rows->next[a][b] = high[brick] + place;
    }
  rows->count = beyond ? 8 - z : 4;
  return 1;
}

/* Where they are in the coarse grid. */
static void octo_world_in_coarse(const double *own, const int *first, octo_world_rows *rows) {
  const int y = (int)own[11] + 4, z = (int)own[12] + 4;
  const double *from = own + (size_t)own[13] + ((size_t)first[0] * y + first[1]) * z + first[2];
  for (int a = 0; a < 4; a++)
    for (int b = 0; b < 4; b++) rows->row[a][b] = rows->next[a][b] = from + ((size_t)a * y + b) * z;
  rows->count = 4;
}

/* Four numbers: the first ``count`` of one row, then of the other one. */
static inline void octo_world_joined(const double *row, const double *next, int count, octo_world_four *four) {
#ifdef __CUDACC_RTC__
  for (int c = 0; c < 4; c++) (*four)[c] = c < count ? row[c] : next[c];
#else
  const octo_world_four place = {0.0, 1.0, 2.0, 3.0}, none = {0.0};
  const octo_world_mask own = (place - (double)count) < none;
  *four = *(const octo_world_four *)row;
  *four = (octo_world_four)(((octo_world_mask)*four & own) | ((octo_world_mask)*(const octo_world_four *)next & ~own));
#endif
}

/* The jet: sums over x, then over y, each of four numbers along z side by side, then over z. ``order`` is a constant. */
static inline void octo_world_sums(const octo_world_rows *rows, const octo_world_four *weights, int order, double *jet) {
  octo_world_four sums[10] = {{0.0}};
  OCTO_WORLD_UNROLLED
  for (int b = 0; b < 4; b++) {
    octo_world_four over_x[4] = {{0.0}};
    OCTO_WORLD_UNROLLED
    for (int a = 0; a < 4; a++) {
      octo_world_four four;
      octo_world_joined(rows->row[a][b], rows->next[a][b], rows->count, &four);
      OCTO_WORLD_UNROLLED
      for (int f = 0; f <= order; f++) over_x[f] += four * weights[4 * a + f][0];
    }
    OCTO_WORLD_UNROLLED
    for (int f = 0; f <= order; f++) {
      OCTO_WORLD_UNROLLED
      for (int e = 0; e <= order - f; e++) sums[(f + e) * (f + e + 1) / 2 + e] += over_x[f] * weights[4 * b + e][1];
    }
  }
  OCTO_WORLD_UNROLLED
  for (int total = 0; total <= order; total++) {
    OCTO_WORLD_UNROLLED
    for (int f = total; f >= 0; f--) {
      OCTO_WORLD_UNROLLED
      for (int e = total - f; e >= 0; e--) {
        const octo_world_four *w = weights + (total - f - e), *sum = sums + (f + e) * (f + e + 1) / 2 + e;
        *jet++ = (*sum)[0] * w[0][2] + (*sum)[1] * w[4][2] + (*sum)[2] * w[8][2] + (*sum)[3] * w[12][2];
      }
    }
  }
}

static void octo_world_grid(const double *own, const double *point, int order, double *jet) {
  octo_world_four weights[16];
  octo_world_rows rows;
  double image[3][4], u[3], at[3], t[3], inverse = own[3];
  int first[3], inside = 1;
  for (int axis = 0; axis < 3; axis++) {
    at[axis] = u[axis] = (point[axis] - own[4 + axis]) * inverse;
    inside &= u[axis] >= 0.0 && u[axis] <= own[axis] - 1.0;
  }
  for (int axis = 0; axis < 3 && !inside; axis++) {
    octo_world_image(u[axis], own[axis], image[axis]);
    at[axis] = image[axis][0];
  }
  for (int axis = 0; axis < 3; axis++) {
    const int cell = octo_world_cell(at[axis], own[axis]);
    t[axis] = at[axis] - cell;
    first[axis] = cell + 1;
  }
  if (!octo_world_in_bricks(own, first, &rows)) {
    inverse *= 0.25;
    for (int axis = 0; axis < 3; axis++) {
      const double coarse = 0.25 * at[axis];
      const int cell = octo_world_cell(coarse, own[10 + axis]);
      t[axis] = coarse - cell;
      first[axis] = cell + 1;
    }
    octo_world_in_coarse(own, first, &rows);
  }
  const octo_world_four place = {t[0], t[1], t[2], 0.0};
  octo_world_basis(&place, inverse, weights);
  for (int axis = 0; axis < 3 && !inside; axis++)
    if (image[axis][1] != 1.0) octo_world_chain(image[axis], own[3], axis, weights);
  switch (order) {
    case 0: octo_world_sums(&rows, weights, 0, jet); break;
    case 1: octo_world_sums(&rows, weights, 1, jet); break;
    case 2: octo_world_sums(&rows, weights, 2, jet); break;
    default: octo_world_sums(&rows, weights, 3, jet);
  }
  /* outside: and how far the point is from its image, summed over the axes */
  const int pure[3][4] = {{0, 1, 4, 10}, {0, 2, 7, 16}, {0, 3, 9, 19}};
  for (int axis = 0; axis < 3 && !inside; axis++) {
    if (u[axis] >= 0.0 && u[axis] <= own[axis] - 1.0) continue;
    const double side = u[axis] < 0.0 ? -1.0 : 1.0;
    jet[0] += side * (u[axis] - image[axis][0]) / own[3];
    if (order > 0) jet[pure[axis][1]] += side * (1.0 - image[axis][1]);
    if (order > 1) jet[pure[axis][2]] -= side * image[axis][2] * own[3];
    if (order > 2) jet[pure[axis][3]] -= side * image[axis][3] * own[3] * own[3];
  }
}
