/* The way to φ and its derivatives at a point: which shapes are near, what each says, and their smooth minimum. Before it stand the
 * functions of each kind of shape, octo_world_of_kind (query.py), those of jets (jet.py, blend.py) and the places in World.data
 * (layout.py). No state, no heap, no recursion: threads of CPU and GPU call it. */

/* The shapes within reach of the nearest one, by distance: those that the minimum feels, and perhaps a few more. */
typedef struct {
  double reach, value[OCTO_WORLD_NEAR]; /* m */
  double limit; /* m²: the square of the largest distance from a box at which its shapes may still matter */
  int shape[OCTO_WORLD_NEAR], count;
} octo_world_near;

/* How many numbers a jet has. */
static int octo_world_size(int order) { return order == 0 ? 1 : order == 1 ? 4 : order == 2 ? 10 : 20; }

/* The jet of one shape in world axes. On a GPU it is compiled once, and not for each of its calls. */
#ifdef __CUDACC_RTC__
__attribute__((noinline))
#endif
static void octo_world_of_shape(const double *world, int shape, const double *point, int order, double *jet) {
  const double *record = world + (int)world[OCTO_WORLD_RECORDS] + OCTO_WORLD_RECORD * shape;
  const double *own = world + (int)record[OCTO_WORLD_OWN];
  const double *position = record + OCTO_WORLD_POSITION, *rotation = record + OCTO_WORLD_ROTATION;
  double p[3], made[20];
  for (int k = 0; k < 3; ++k) p[k] = point[k] - position[k];
  const int kind = (int)record[OCTO_WORLD_KIND];
  if (record[OCTO_WORLD_TURNED] == 0.0) {
    octo_world_of_kind(kind, own, p, order, jet);
    return;
  }
  const double *arg[] = {rotation, made};
  double *res[] = {jet}, q[3];
  for (int k = 0; k < 3; ++k) q[k] = rotation[k] * p[0] + rotation[3 + k] * p[1] + rotation[6 + k] * p[2];
  octo_world_of_kind(kind, own, q, order, made);
  octo_world_turned(order, arg, res);
}

/* Put a shape among those that are near, in its place, where it is. */
static void octo_world_consider(const double *world, int shape, const double *point, octo_world_near *near) {
  double value;
  octo_world_of_shape(world, shape, point, 0, &value);
  int k = near->count;
  if (k > 0 && value > near->value[0] + near->reach) return;
  if (k == OCTO_WORLD_NEAR && !(value < near->value[--k])) return; /* of so many at one place the nearest ones */
  for (; k > 0 && value < near->value[k - 1]; --k) {
    near->value[k] = near->value[k - 1];
    near->shape[k] = near->shape[k - 1];
  }
  near->value[k] = value;
  near->shape[k] = shape;
  if (near->count < OCTO_WORLD_NEAR) ++near->count;
  const double farthest = near->value[0] + near->reach; /* φ outside a box is at least a fraction of the distance from it */
  while (near->value[near->count - 1] > farthest) --near->count;
  const double limit = farthest > 0.0 ? farthest / OCTO_WORLD_FRACTION : 0.0;
  near->limit = fmin(limit * limit, OCTO_WORLD_FAR);
}

/* The squares of the distances from the boxes of a node's children. */
static void octo_world_beyond(const double *node, const double *point, double *squares) {
  for (int k = 0; k < OCTO_WORLD_WIDTH; ++k) {
    double sum = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
      const double *low = node + OCTO_WORLD_WIDTH * axis, *high = low + 3 * OCTO_WORLD_WIDTH;
      const double below = low[k] - point[axis], above = point[axis] - high[k];
      const double most = below > above ? below : above, beyond = most > 0.0 ? most : 0.0;
      sum += beyond * beyond;
    }
    squares[k] = sum;
  }
}

/* The shapes near a point; how many were looked at. Nearer boxes come first. */
static int octo_world_find(const double *world, const double *point, octo_world_near *near) {
  const double *endless = world + (int)world[OCTO_WORLD_ENDLESS], *tree = world + (int)world[OCTO_WORLD_TREE];
  const int bounded = (int)world[OCTO_WORLD_BOUNDED], others = (int)world[OCTO_WORLD_COUNT] - bounded;
  int stack[OCTO_WORLD_STACK], top = 0, looked = others;
  double away[OCTO_WORLD_STACK], squares[OCTO_WORLD_WIDTH];
  near->reach = OCTO_WORLD_REACH * world[OCTO_WORLD_SCALE];
  near->count = 0;
  near->limit = OCTO_WORLD_FAR;
  for (int k = 0; k < others; ++k) octo_world_consider(world, (int)endless[k], point, near);
  if (bounded > 0) {
    stack[top] = 0;
    away[top++] = 0.0;
  }
  while (top > 0) {
    const int place = stack[--top];
    if (away[top] > near->limit) continue;
    if (place < 0) {
      octo_world_consider(world, -1 - place, point, near);
      ++looked;
      continue;
    }
    const double *node = tree + 7 * OCTO_WORLD_WIDTH * place, *child = node + 6 * OCTO_WORLD_WIDTH;
    const double limit = near->limit;
    const int bottom = top;
    octo_world_beyond(node, point, squares);
    for (int k = 0; k < OCTO_WORLD_WIDTH; ++k) {
      if (squares[k] > limit) continue;
      int at = top++;
      for (; at > bottom && away[at - 1] < squares[k]; --at) {
        away[at] = away[at - 1];
        stack[at] = stack[at - 1];
      }
      away[at] = squares[k];
      stack[at] = (int)child[k];
    }
  }
  return looked;
}

/* How many of the shapes that are near the minimum feels: those with x < τ, where Σ (τ − x)² = 4 over them. */
static int octo_world_felt(const octo_world_near *near, double scale) {
  double tau = OCTO_WORLD_REACH, first = 0.0, second = 0.0;
  int count = 1;
  while (count < near->count) {
    const double x = (near->value[count] - near->value[0]) / scale;
    if (!(x < tau)) break;
    first += x;
    second += x * x;
    ++count;
    tau = (first + sqrt(first * first - count * (second - 4.0))) / count;
  }
  return count;
}

/* φ and its derivatives at a point (3) m, in world axes, of what octo_world_find found: as many numbers as a jet of the order has. */
static void octo_world_made(const double *world, const double *point, const octo_world_near *near, int order, double *jet) {
  const int felt = octo_world_felt(near, world[OCTO_WORLD_SCALE]);
  if (felt == 1) {
    octo_world_of_shape(world, near->shape[0], point, order, jet);
    return;
  }
  const double scale[3] = {near->value[0], world[OCTO_WORLD_SCALE], (double)felt};
  double sums[2][3][20] = {{{0.0}}}, one[20]; /* sums of powers of x: two, for a function must not write to what it reads */
  for (int k = 0; k < felt; ++k) {
    double (*from)[20] = sums[k % 2], (*to)[20] = sums[1 - k % 2];
    const double *arg[] = {scale, one, from[0], from[1], from[2]};
    double *res[] = {to[0], to[1], to[2]};
    octo_world_of_shape(world, near->shape[k], point, order, one);
    octo_world_add(order, arg, res);
  }
  double (*whole)[20] = sums[felt % 2];
  const double *arg[] = {scale, whole[0], whole[1], whole[2]};
  double *res[] = {jet};
  octo_world_soften(order, arg, res);
}

/* The same where nothing is known yet, and φ is less than ``beyond`` m; elsewhere the first number is a lower bound of φ that is not
 * less either, and the others are those of level ground. NaN where the point is not finite, or farther from all shapes than numbers reach. */
static void octo_world_within(const double *world, const double *point, double beyond, int order, double *jet) {
  const double place = point[0] + point[1] + point[2];
  if (place - place == 0.0 && world[OCTO_WORLD_COUNT] == 1.0 && beyond == INFINITY) { /* one map, as often */
    octo_world_of_shape(world, 0, point, order, jet);
    return;
  }
  octo_world_near near;
  near.count = 0;
  if (place - place == 0.0) octo_world_find(world, point, &near);
  if (near.count == 0) {
    for (int k = 0; k < octo_world_size(order); ++k) jet[k] = NAN;
    return;
  }
  const double least = near.value[0] - 4.0 / 3.0 * world[OCTO_WORLD_SCALE];
  if (least < beyond) {
    octo_world_made(world, point, &near, order, jet);
    return;
  }
  for (int k = 0; k < octo_world_size(order); ++k) jet[k] = k == 0 ? least : k == 3;
}

/* The same, whatever φ is. */
static void octo_world(const double *world, const double *point, int order, double *jet) {
  octo_world_within(world, point, INFINITY, order, jet);
}
