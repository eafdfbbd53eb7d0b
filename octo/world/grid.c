/* A grid of signed distances in bricks of 8 x 8 x 8 coefficients, with a coarse grid where there are none and, around sharp edges,
   parts: bricks of a grid of a quarter of the cell, 4 x 4 x 4 in the place of one.
   own: size_x size_y size_z 1/cell x y z bricks_x bricks_y bricks_z coarse_x coarse_y coarse_z
   coarse_place | table, of each brick its place, and that of the table of its parts' places; 0: there is none | tables of parts |
   coarse coefficients | bricks | parts. */
typedef struct {
  const double *row[4][4], *next[4][4]; /* of x and y: where the four coefficients along z are in one brick and in the next one */
  int count;                            /* how many of the four are in the first */
} octo_world_rows;

/* The entry of a brick by its number along each axis. */
static inline const double *octo_world_entry(const double *own, int x, int y, int z) {
  return own + 14 + 2 * ((x * (long long)own[8] + y) * (long long)own[9] + z);
}

/* The place of a brick, or of a part; 0: there is none. A signed number is made of a double in one instruction. */
static inline long long octo_world_brick(const double *own, int parts, int x, int y, int z) {
  if (!parts) return (long long)octo_world_entry(own, x, y, z)[0];
  const long long table = (long long)octo_world_entry(own, x >> 2, y >> 2, z >> 2)[1];
  return table == 0 ? 0 : (long long)own[table + 16 * (x & 3) + 4 * (y & 3) + (z & 3)];
}

/* Where a cell's coefficients are in bricks, or in parts; 0: one of them is missing. */
static inline int octo_world_in_bricks(const double *own, int parts, const int *first, octo_world_rows *rows) {
  const int x = first[0] & 7, y = first[1] & 7, z = first[2] & 7, beyond = z > 4;
  const double *low[4], *high[4];
  for (int a = 0; a <= (x > 4); a++)
    for (int b = 0; b <= (y > 4); b++) {
      const int along[3] = {(first[0] >> 3) + a, (first[1] >> 3) + b, first[2] >> 3};
      const long long one = octo_world_brick(own, parts, along[0], along[1], along[2]);
      const long long other = beyond ? octo_world_brick(own, parts, along[0], along[1], along[2] + 1) : one;
      if (one == 0 || other == 0) return 0;
      low[2 * a + b] = own + one + z;
      high[2 * a + b] = own + other + z - 8 * beyond;
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

/* Whether a cell's quarter around a place is in parts, and then where, with the place in it. One whose coefficients are has a part
 * in the brick of the cell's first one. */
static inline int octo_world_in_parts(const double *own, int inside, const int *first, double *t, octo_world_rows *rows) {
  if (octo_world_entry(own, first[0] >> 3, first[1] >> 3, first[2] >> 3)[1] == 0.0 || !inside) return 0;
  int quarter[3], from[3];
  for (int axis = 0; axis < 3; axis++) {
    quarter[axis] = (int)(4.0 * t[axis]);
    from[axis] = 4 * first[axis] - 3 + quarter[axis];
  }
  if (!octo_world_in_bricks(own, 1, from, rows)) return 0;
  for (int axis = 0; axis < 3; axis++) t[axis] = 4.0 * t[axis] - quarter[axis];
  return 1;
}

/* The first of a cell's four coefficients along each axis, and the place in the cell, on a lattice of ``scale`` cells in one. */
static inline void octo_world_taps(const double *at, double scale, const double *size, int *first, double *t) {
  for (int axis = 0; axis < 3; axis++) {
    const double place = scale * at[axis];
    const int cell = octo_world_cell(place, size[axis]);
    t[axis] = place - cell;
    first[axis] = cell + 1;
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
  octo_world_taps(at, 1.0, own, first, t);
  if (octo_world_in_parts(own, inside, first, t, &rows)) inverse *= 4.0;
  else if (!octo_world_in_bricks(own, 0, first, &rows)) {
    inverse *= 0.25;
    octo_world_taps(at, 0.25, own + 10, first, t);
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
