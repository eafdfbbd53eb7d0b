/* E, C and their model (Eq. 9) over the steps of a batch: the mathematics of assemble.c and scatter.c, gathered instead of
 * scattered, so that every number has one writer and its sum one order.
 *
 * After the texts of the dynamics and of the costs (codegen.py), common.cuh and dynamics.cu. Grids are (steps or units, batch)
 * unless a kernel says otherwise. A step's Hessian is its six blocks 00 01 02 11 22 12 of (next, now, previous), as HESS of phases.c.
 * Launch bounds name as few blocks a multiprocessor as 400 steps need: the compiler then has registers to read ahead. */

#define W3 (3 * NX)
#define AHEAD 8 /* reads of a sum that do not wait for each other */
#define BLOCKS 6
#define TOUCHED (18 * NY + 36 * BLOCKS + NY + NY * (NY + 1) / 2) /* y', bends, gradient and second derivatives of a contact, to y (pieces.py) */

/* x_j = constant_j + sum over its slots (basis.py), of a cycle's first two nodes times carry (batch, NX, NX; 0: no cycle); over
 * count = batch (steps + 2) NX numbers. */
extern "C" __global__ void __launch_bounds__(FLAT, 4)
octo_nodes(int count, int steps, int units, int slots, int parts, const int *slot_unit, const int *slot_part, const double *slot_value,
           const double *constant, const double *carry, const double *unknowns, double *nodes) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int c = e % NX, node = e / NX % (steps + 2), member = e / NX / (steps + 2);
    double sum = constant[e];
    for (int s = node * slots; s < (node + 1) * slots; ++s) {
      if (slot_unit[s] < 0) continue;
      const double *part = unknowns + (((size_t)member * units + slot_unit[s]) * parts + slot_part[s]) * NX;
      if (carry && node < 2)
#pragma unroll 4
        for (int k = 0; k < NX; ++k) sum += slot_value[s] * carry[((size_t)member * NX + c) * NX + k] * part[k];
      else sum += slot_value[s] * part[c];
    }
    nodes[e] = sum;
  }
}

/* x, kin: of the next node, those of the two before it stand before them; u: (NU), then sine and cosine of ANGLES, then what
 * stages of code give (problem/calls.py) */
typedef struct { const double *x, *kin, *p, *q; double *u; } octo_place_of_step;

#ifdef CALLS
#define ARGUMENTS (NU + 2 * ANGLES + NV)
#else
#define ARGUMENTS (NU + 2 * ANGLES)
#endif

static __device__ inline octo_place_of_step octo_place_at(int steps, size_t member, size_t step, const double *nodes, const double *kin,
                                                          const double *p, const double *q, double *u) {
  size_t node = member * (steps + 2) + step + 2;
  octo_place_of_step at = {nodes + node * NX, kin + node * KIN, p + member * NP, q + (member * steps + step) * NQ, u};
  return at;
}

/* Of the step that comes ``s`` later. */
static __device__ inline octo_place_of_step octo_place_after(const octo_place_of_step *at, int s) {
  octo_place_of_step later = {at->x + s * NX, at->kin + s * KIN, at->p, at->q + s * NQ, at->u + s * ARGUMENTS};
  return later;
}

/* A block evaluates the costs of TOGETHER steps: a piece is long, has few threads, and needs the registers of many. */
#define EACH_OF_STEPS(s, e, count, steps) /* the steps and numbers of each */ \
  for (int s##e = LANE, s, e; s##e < TOGETHER * (count) && (s = s##e % TOGETHER, e = s##e / TOGETHER, 1); s##e += LANES) if (s < (steps))

#ifdef CALLS
/* What stages of code give, one call a thread; those of a wave do not ask for one another. */
static __device__ inline void octo_calls_of_steps(const octo_place_of_step *first, int count, int order) {
  for (int wave = 0; wave < CALLS; wave = octo_call_end[wave]) {
    EACH_OF_STEPS(s, k, octo_call_end[wave] - wave, count) {
      octo_place_of_step at = octo_place_after(first, s);
      double *v = at.u + NU + 2 * ANGLES;
      const double *arg[7] = {at.x, at.x - NX, at.x - 2 * NX, at.u, at.p, at.q, v};
      octo_call(wave + k, arg, v, order);
    }
    BARRIER;
  }
}
#endif

/* Residuals r (count, MROWS); or, with jac and touch, those over the state, their derivatives, and what the terms over contacts have,
 * ``exact`` or by Gauss and Newton: a warp for each piece, over contacts a thread for each. */
static __device__ inline void octo_costs_of_steps(const octo_place_of_step *first, int count, const double *fd, int exact, double *r,
                                                  double *jac, double *touch) {
  EACH_OF_STEPS(s, j, NU, count) first->u[s * ARGUMENTS + j] = fd[s * NX + octo_actuated[j]];
  EACH_OF_STEPS(s, k, ANGLES, count) {
    octo_place_of_step at = octo_place_after(first, s);
    const double *source = octo_angle_input[k] < 3 ? at.x - octo_angle_input[k] * NX : at.q;
    double *turn = at.u + NU + 2 * k;
    sincos(source[octo_angle_element[k]] + octo_angle_offset[k], turn, turn + 1);
  }
  BARRIER;
#ifdef CALLS
  octo_calls_of_steps(first, count, jac != 0);
#endif
  const double *arg[9];
  double *res[1];
  int skipped = !jac ? 0 : CONTACT_VALUES, end = !jac ? CONTACT_VALUES : exact ? CONTACT_PIECES : CONTACT_MODEL;
  int jumped = jac && exact ? CONTACT_MODEL - CONTACT_SLOPES : 0; /* pieces of Gauss and Newton's model, after y' */
  int pieces = jac ? PIECES : VALUES, own = end - skipped - jumped, warp = LANE / 32;
  int lanes = LANES - 32 * warp < 32 ? LANES - 32 * warp : 32;
  for (int k = warp; k < pieces + own; k += (LANES + 31) / 32) {
    if (k < pieces) {
      for (int s = LANE % 32; s < count && k < pieces; s += lanes) { /* k < pieces: the compiler sees which are never called */
        octo_place_of_step at = octo_place_after(first, s);
        arg[0] = at.x; arg[1] = at.x - NX; arg[2] = at.x - 2 * NX; arg[3] = at.u; arg[4] = at.p; arg[5] = at.q; arg[6] = at.u + NU;
#ifdef CALLS
        arg[7] = at.u + NU + 2 * ANGLES;
#endif
        res[0] = (k < VALUES ? r + s * MROWS : jac + s * NZ) + octo_piece_at[k];
        octo_piece(k, arg, res);
      }
      continue;
    }
#if NFC > 0
    int piece = skipped + k - pieces;
    if (piece >= CONTACT_SLOPES) piece += jumped;
    for (int e = LANE % 32; e < count * NFC; e += lanes) {
      int s = e / NFC, c = e % NFC;
      octo_place_of_step at = octo_place_after(first, s);
      for (int node = 0; node < 3; ++node) arg[node] = at.kin - node * KIN + 12 * octo_cost_contact_body[c];
      arg[3] = octo_cost_contact_data + 4 * c; arg[4] = at.p; arg[5] = at.q;
#ifdef WORLD
      double looked[2][JET];
      for (int node = 0; node < 2; ++node)
        arg[6 + node] = octo_looked(at.p, at.kin - node * KIN, octo_cost_contact_ground[c], octo_cost_contact_body[c],
                                    octo_cost_contact_data + 4 * c, 3, looked[node]);
      arg[8] = octo_cost_contact_use + CR * c;
#else
      arg[6] = octo_cost_contact_use + CR * c;
#endif
      res[0] = (jac ? touch + (s * NFC + c) * TOUCHED : r + s * MROWS + NR + c * CR) + octo_contact_piece_at[piece];
      octo_contact_piece(piece, arg, res);
    }
#endif
  }
  BARRIER;
}

/* Each step's share of each term, and the values of the bounded rows; grid (half of the steps, batch); shared: TOGETHER (MROWS + ARGUMENTS) doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 2)
octo_terms(int steps, const double *nodes, const double *kin, const double *p, const double *q, const double *fd, double *terms,
           double *bounded) {
  SHARED(r);
  int step = TOGETHER * blockIdx.x, count = steps - step < TOGETHER ? steps - step : TOGETHER;
  size_t item = (size_t)blockIdx.y * steps + step;
  octo_place_of_step at = octo_place_at(steps, blockIdx.y, step, nodes, kin, p, q, r + TOGETHER * MROWS);
  octo_costs_of_steps(&at, count, fd + item * NX, 0, r, 0, 0);
  EACH_OF_STEPS(s, row, MROWS, count) {
    double c = octo_coefficient(at.q + s * NQ, row), *own = r + s * MROWS + row;
#if NBOUNDED > 0
    if (row >= SQUARES && row < NR) bounded[(item + s) * NBOUNDED + row - SQUARES] = *own;
#endif
    *own = c != 0.0 ? c * *own * *own : 0.0; /* a step that a term leaves out may have no finite residual */
  }
  BARRIER;
  EACH_OF_STEPS(s, k, NTERM, count) {
    const double *own = r + s * MROWS;
    double sum = 0.0;
    for (int row = 0; row < NR; ++row) sum += octo_state_row_term[row] == k ? own[row] : 0.0;
#if NFC > 0
    for (int e = 0; e < CR; ++e)
      for (int c = 0; c < NFC && octo_contact_row_term[e] == k; ++c) sum += own[NR + c * CR + e];
#endif
    terms[(item + s) * NTERM + k] = sum;
  }
}

/* E, ‖C‖₁, ‖C‖∞ and ‖C‖₂² of each member; rows are the entries of C; grid (batch); shared: 4 PARTS doubles. */
extern "C" __global__ void __launch_bounds__(PARTS, 4)
octo_summary(int steps, int rows, const double *terms, const double *c, double *summary) {
  SHARED(part);
  double *size = part + PARTS, *most = size + PARTS, *square = most + PARTS;
  const double *own = terms + (size_t)blockIdx.x * steps * NTERM, *residual = c + (size_t)blockIdx.x * rows;
  EACH(k, PARTS) {
    double sum = 0.0, all = 0.0, top = 0.0, squares = 0.0;
    for (int e = k; e < steps * NTERM; e += PARTS) sum += own[e];
    for (int e = k; e < rows; e += PARTS) {
      all += fabs(residual[e]);
      squares += residual[e] * residual[e];
      top = octo_larger(fabs(residual[e]), top);
    }
    part[k] = sum, size[k] = all, most[k] = top, square[k] = squares;
  }
  double sum = octo_block_sum(part), all = octo_block_sum(size), top = octo_block_max(most), squares = octo_block_sum(square);
  double *out = summary + 4 * (size_t)blockIdx.x;
  if (LANE == 0) out[0] = sum, out[1] = all, out[2] = top, out[3] = squares;
}

/* C = (Sᵀ ⊗ U_/) FD over count = batch units parts MU numbers; first (units parts + 1) are the tests of each part of a unit. */
extern "C" __global__ void __launch_bounds__(FLAT, 4)
octo_constraints(int count, int steps, int rows, const int *first, const int *test_step, const double *test_value, const double *row_scale,
                 const double *fd, double *c) {
#if MU > 0
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int r = e % MU, row = e / MU % rows, member = e / MU / rows;
    const double *own = fd + (size_t)member * steps * NX + octo_unactuated[r];
    double sum = 0.0;
    for (int t = first[row]; t < first[row + 1]; ++t) sum += test_value[t] * own[test_step[t] * NX];
    c[e] = row_scale[member * MU + r] * sum;
  }
#endif
}

/* Residuals r (MROWS, of the state) of a step, their derivatives jac (NZ), touch (NFC, TOUCHED), and the multipliers lam (NX) of its FD: dE/du on the
 * actuated rows, Sᵀ multipliers on the others (none without multipliers). Grid (half of the steps, batch); shared: TOGETHER
 * ARGUMENTS doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 2)
octo_cost_derivatives(int steps, int rows, int tests, const int *test_row, const double *test_value, const double *nodes,
                      const double *kin, const double *p, const double *q, const double *row_scale, const double *fd,
                      const double *multipliers, const int *curved, double *r, double *jac, double *touch, double *lam) {
  SHARED(u);
  int step = TOGETHER * blockIdx.x, count = steps - step < TOGETHER ? steps - step : TOGETHER;
  size_t member = blockIdx.y, item = member * steps + step;
  octo_place_of_step at = octo_place_at(steps, member, step, nodes, kin, p, q, u);
  r += item * MROWS; jac += item * NZ; touch += item * NFC * TOUCHED; lam += item * NX;
  octo_costs_of_steps(&at, count, fd + item * NX, multipliers && (!curved || curved[member]), r, jac, touch);
  EACH_OF_STEPS(s, j, NU, count) {
    double sum = 0.0;
#if NR > 0
#pragma unroll 8
    for (int z = NZ - NZU; z < NZ; ++z) { /* those of u */
      int row = octo_state_entry_row[z];
      double multiplier = octo_row_multiplier(at.q + s * NQ, row, r[s * MROWS + row]), slope = jac[s * NZ + z];
      sum += octo_state_entry_column[z] - W3 == j && octo_row_weight(at.q + s * NQ, row) != 0.0 ? multiplier * slope : 0.0;
    }
#endif
    lam[s * NX + octo_actuated[j]] = sum;
  }
#if MU > 0
  EACH_OF_STEPS(s, k, MU, count) {
    double sum = 0.0;
    for (int t = (step + s) * tests; multipliers && t < (step + s + 1) * tests; ++t)
      if (test_row[t] >= 0) sum += test_value[t] * row_scale[member * MU + k] * multipliers[(member * rows + test_row[t]) * MU + k];
    lam[s * NX + octo_unactuated[k]] = sum;
  }
#endif
}

/* Rows first … last − 1 of d residual / d (next, now, previous), scaled by the root of twice their coefficient (0: left out). */
static __device__ inline void octo_stack_rows(const double *cost_jac, const double *jac, const double *scale, int first, int last,
                                              double *rows) {
  EACH(e, (last - first) * W3) rows[e] = 0.0;
  BARRIER;
#if NR > 0
  EACH(z, NZ - NZU) {
    int row = octo_state_entry_row[z];
    if (row >= first && row < last && scale[row] != 0.0) rows[(row - first) * W3 + octo_state_entry_column[z]] = scale[row] * cost_jac[z];
  }
  BARRIER;
  EACH(j, W3)
    for (int z = NZ - NZU; z < NZ; z += AHEAD) { /* those of u, reads before what is written */
      double slope[AHEAD], value[AHEAD];
      int row[AHEAD];
      for (int k = 0; k < AHEAD; ++k) {
        int own = z + k < NZ ? z + k : NZ - 1;
        row[k] = octo_state_entry_row[own];
        slope[k] = cost_jac[own];
        value[k] = jac[octo_actuated[octo_state_entry_column[own] - W3] * W3 + j];
      }
      for (int k = 0; k < AHEAD; ++k)
        if (z + k < NZ && row[k] >= first && row[k] < last && scale[row[k]] != 0.0)
          rows[(row[k] - first) * W3 + j] += scale[row[k]] * slope[k] * value[k];
    }
#endif
  BARRIER;
}

/* A thread multiplies TILE neighbouring columns of a node with as many of the same or an older one. Of the PAIRS of tiles, each
 * once, a triangle of COLUMNS of them, there are as many as a rectangle of COLUMNS / 2 and COLUMNS + 1 has: its rows are two of
 * the triangle's. */
#define TILES ((NX + TILE - 1) / TILE)
#define COLUMNS (3 * TILES + TILES % 2)
#define PAIRS (COLUMNS / 2 * (COLUMNS + 1))

/* sum (TILE, TILE) to rows i … and columns j … of a block, or of its transpose, where there is that much; to curvature at first. */
static __device__ inline void octo_put_tile(const double (*sum)[TILE], int i, int j, int transposed, const double *before, double *block) {
  for (int a = 0; a < TILE && i + a < NX; ++a)
    for (int b = 0; b < TILE && j + b < NX; ++b) {
      int at = transposed ? (j + b) * NX + i + a : (i + a) * NX + j + b;
      block[at] = (before ? before[at] : 0.0) + sum[a][b];
    }
}

/* hess (6, NX, NX) = curvature (0: none) + rowsᵀ rows, gradient (W3) = rowsᵀ values, of the rows over the state, ``held`` at a time.
 * Shared: 2 NR + held W3 + TILE doubles. */
extern "C" __global__ void __launch_bounds__(TILED, 4)
octo_step_model(int steps, int held, const double *nodes, const double *kin, const double *p, const double *q, const double *r,
                const double *cost_jac, const double *jac, const double *curvature, double *hess, double *gradient) {
  SHARED(scale);
  double *value = scale + NR, *rows = value + NR;
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  octo_place_of_step at = octo_place_at(steps, blockIdx.y, blockIdx.x, nodes, kin, p, q, 0);
  hess += item * 6 * NX * NX; gradient += item * W3;
  if (curvature) curvature += item * CURVATURE * NX * NX;
  EACH(row, NR) {
    double weight = octo_row_weight(at.q, row), own = r[item * MROWS + row];
    scale[row] = weight != 0.0 ? sqrt(weight) : 0.0;
    value[row] = weight == 0.0 ? 0.0 : row < SQUARES ? scale[row] * own : octo_row_shift(at.q, row, own) / scale[row];
  }
  int first = 0, last;
  do {
    last = first + held;
    if (last > NR) last = NR;
    BARRIER;
    octo_stack_rows(cost_jac + item * NZ, jac + item * NX * W3, scale, first, last, rows);
    EACH(e, PAIRS + (W3 + TILE - 1) / TILE) {
      if (e < PAIRS) {
        int r = e / (COLUMNS + 1), c = e % (COLUMNS + 1), one = c > r ? r : COLUMNS - 1 - r, other = c > r ? c - 1 : COLUMNS - 1 - c;
        if (other >= 3 * TILES) continue;
        int newer = one / TILES, older = other / TILES, i = one % TILES * TILE, j = other % TILES * TILE;
        const double *left = rows + newer * NX + i, *right = rows + older * NX + j; /* beyond NX: computed with and not used */
        double sum[TILE][TILE] = {};
        for (int row = first; row < last; ++row, left += W3, right += W3)
          if (scale[row] != 0.0)
            for (int a = 0; a < TILE; ++a)
              for (int b = 0; b < TILE; ++b) sum[a][b] += left[a] * right[b];
        int block = newer == 0 ? older : older == 1 ? 3 : newer == 1 ? 5 : 4;
        double *out = hess + block * NX * NX;
        const double *before = first > 0 ? out : curvature && block < CURVATURE ? curvature + block * NX * NX : 0;
        octo_put_tile(sum, i, j, 0, before, out);
        if (newer == older && i != j) octo_put_tile(sum, i, j, 1, before, out);
      } else {
        int j = (e - PAIRS) * TILE;
        double sum[TILE] = {};
        for (int row = first; row < last; ++row)
          for (int b = 0; b < TILE; ++b) sum[b] += value[row] * rows[(row - first) * W3 + j + b];
        for (int b = 0; b < TILE && j + b < W3; ++b) gradient[j + b] = first > 0 ? gradient[j + b] + sum[b] : sum[b];
      }
    }
    first = last;
  } while (first < NR);
}

/* Adds the terms over contacts to hess and gradient: of each contact the blocks to twists (problem/contact_model.py) out of their
 * factors, by all threads, and a joint's part of a block or of its transpose by one. Grid (steps, batch); shared: 18 NY + 234 + 54 NX. */
extern "C" __global__ void __launch_bounds__(TILED, 4)
octo_touch(int steps, int exact, const int *curved, const double *kin, const double *touch, double *hess, double *gradient) {
#if NFC > 0
  static const int newer[] = {0, 0, 0, 1, 2, 1, 0, 0, 1}, older[] = {0, 1, 2, 1, 2, 2, 1, 2, 2}, of[] = {0, 1, 2, 3, 4, 5, 1, 2, 5};
  SHARED(half); /* ∂²E/∂y² y' (NY, 18), the gradient and the blocks, and of each joint and part what stands beside its ancestors */
  double *blocks = half + 18 * NY, *sum = blocks + 18 + 36 * BLOCKS;
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  exact = exact && (!curved || curved[blockIdx.y]);
  kin += ((size_t)blockIdx.y * (steps + 2) + blockIdx.x + 2) * KIN + 12 * NB;
  touch += item * NFC * TOUCHED; hess += item * 6 * NX * NX; gradient += item * W3;
  EACH(e, 54 * NX) sum[e] = 0.0;
  for (int c = 0; c < NFC; ++c, touch += TOUCHED) {
    const double *bend = touch + 18 * NY, *pull = bend + 36 * BLOCKS, *square = pull + NY;
    EACH(e, 18 * NY) {
      int k = e / 18, s = e % 18;
      double value = 0.0;
      for (int l = 0; l < NY; ++l) value += square[k <= l ? l * (l + 1) / 2 + k : k * (k + 1) / 2 + l] * touch[18 * l + s];
      half[e] = value;
    }
    BARRIER;
    EACH(e, 18 + 36 * BLOCKS) {
      int at = e - 18, block = at / 36, r = e < 18 ? e : 6 * newer[block] + at / 6 % 6, s = 6 * older[block] + at % 6;
      double value = e < 18 || !exact ? 0.0 : bend[at];
      for (int k = 0; k < NY; ++k) value += touch[18 * k + r] * (e < 18 ? pull[k] : half[18 * k + s]);
      blocks[e] = value;
    }
    BARRIER;
    EACH(e, 9 * NX) {
      int kind = e / NX, j = e % NX, back = kind >= BLOCKS;
      if (!octo_cost_contact_moves[c * NX + j]) continue;
      const double *xi = kin - (back ? newer[kind] : older[kind]) * KIN + 6 * j, *m = blocks + 18 + 36 * of[kind];
      for (int r = 0; r < 6; ++r)
        for (int k = 0; k < 6; ++k) sum[6 * e + r] += (back ? m[6 * k + r] : m[6 * r + k]) * xi[k];
    }
    EACH(e, W3) {
      const double *xi = kin - e / NX * KIN + 6 * (e % NX), *own = blocks + 6 * (e / NX);
      if (octo_cost_contact_moves[c * NX + e % NX])
        gradient[e] += own[0] * xi[0] + own[1] * xi[1] + own[2] * xi[2] + own[3] * xi[3] + own[4] * xi[4] + own[5] * xi[5];
    }
    BARRIER;
  }
  EACH(e, 9 * NX) {
    int kind = e / NX, j = e % NX, back = kind >= BLOCKS;
    const double *other = kin - (back ? older[kind] : newer[kind]) * KIN;
    double *out = hess + of[kind] * NX * NX;
    for (int i = j; i >= 0; i = octo_before[i]) {
      double value = 0.0;
      for (int k = 0; k < 6; ++k) value += other[6 * i + k] * sum[6 * e + k];
      if (!back) out[i * NX + j] += value;
      if (i != j && (back || newer[kind] == older[kind])) out[j * NX + i] += value;
    }
  }
#endif
}

/* A cycle's first two steps: slopes with respect to x_{-1} and x_0 become those with respect to what these are made of
 * (octo_carry_back of scatter.c). A block of threads for each block of a Hessian, for the columns of each older node in the
 * Jacobian of FD, and for those in the gradient: grid (2 steps, 10, batch); shared: NX NX doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_carry_back(int steps, const double *carry, double *jac, double *hess, double *gradient) {
  SHARED(held);
  int step = blockIdx.x, kind = blockIdx.y, line = kind >= 6, node = 1 + kind % 2; /* kinds 6 to 9 are of node 1 and node 2 */
  int newer = kind < 3 ? 0 : kind == 4 ? 2 : 1, older = line ? node : kind < 3 ? kind : kind == 3 ? 1 : 2;
  if (older <= step) return;
  size_t item = (size_t)blockIdx.z * steps + step;
  int height = kind < 8 ? NX : 1, width = kind < 6 ? NX : W3;
  double *own = kind < 6 ? hess + (item * 6 + kind) * NX * NX : (kind < 8 ? jac + item * NX * W3 : gradient + item * W3) + node * NX;
  carry += (size_t)blockIdx.z * NX * NX;
  for (int side = 0; side < 2; ++side) { /* own carry, and then carryᵀ own where its rows are of a carried node */
    if (side == 1 && (line || newer <= step)) return;
    EACH(e, height * NX) held[e] = own[e / NX * width + e % NX];
    BARRIER;
    EACH(e, height * NX) {
      int r = e / NX, c = e % NX;
      double sum = 0.0;
#pragma unroll 8
      for (int k = 0; k < NX; ++k) sum += side ? carry[k * NX + r] * held[k * NX + c] : held[r * NX + k] * carry[k * NX + c];
      own[r * width + c] = sum;
    }
    BARRIER;
  }
}
