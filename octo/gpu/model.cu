/* E, C and their model (Eq. 9) over the steps of a batch: the mathematics of assemble.c and scatter.c, gathered instead of
 * scattered, so that every number has one writer and its sum one order.
 *
 * After the texts of the dynamics and of the costs (codegen.py), common.cuh and dynamics.cu. Grids are (steps or units, batch)
 * unless a kernel says otherwise. A step's Hessian is its six blocks 00 01 02 11 22 12 of (next, now, previous), as HESS of phases.c. */

#define W3 (3 * NX)
#define TOUCH (NFC * CR * 18)

/* x_j = constant_j + sum over its slots (basis.py); over count = batch (steps + 2) NX numbers. */
extern "C" __global__ void octo_nodes(int count, int steps, int units, int slots, int parts, const int *slot_unit, const int *slot_part,
                                      const double *slot_value, const double *constant, const double *unknowns, double *nodes) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int c = e % NX, node = e / NX % (steps + 2), member = e / NX / (steps + 2);
    double sum = constant[e];
    for (int s = node * slots; s < (node + 1) * slots; ++s)
      if (slot_unit[s] >= 0) sum += slot_value[s] * unknowns[(((size_t)member * units + slot_unit[s]) * parts + slot_part[s]) * NX + c];
    nodes[e] = sum;
  }
}

typedef struct { const double *x[3], *kin[3], *p, *q; double *u; } octo_place_of_step; /* u: (NU), then sine and cosine of ANGLES */

static __device__ inline octo_place_of_step octo_place_at(int steps, size_t member, size_t step, const double *nodes, const double *kin,
                                                          const double *p, const double *q, double *u) {
  size_t node = member * (steps + 2) + step;
  octo_place_of_step at;
  for (int k = 0; k < 3; ++k) {
    at.x[k] = nodes + (node + 2 - k) * NX;
    at.kin[k] = kin + (node + 2 - k) * KIN;
  }
  at.p = p + member * NP; at.q = q + (member * steps + step) * NQ; at.u = u;
  return at;
}

/* Residuals r and, with jac and touch, their derivatives: a warp for each piece, over contacts a thread for each of them. */
static __device__ inline void octo_costs_of_step(const octo_place_of_step *at, const double *fd, double *r, double *jac, double *touch) {
  double *sines = at->u + NU;
  EACH(j, NU) at->u[j] = fd[octo_actuated[j]];
  EACH(k, ANGLES) {
    const double *source = octo_angle_input[k] < 3 ? at->x[octo_angle_input[k]] : at->q;
    double angle = source[octo_angle_element[k]] + octo_angle_offset[k];
    sines[2 * k] = sin(angle);
    sines[2 * k + 1] = cos(angle);
  }
  BARRIER;
  const double *arg[8];
  double *res[1];
  int pieces = jac ? PIECES : VALUES, own = jac ? CONTACT_PIECES : CONTACT_VALUES, warp = LANE / 32;
  for (int k = warp; k < pieces + own; k += (LANES + 31) / 32) {
    if (k < pieces) {
      if (LANE % 32 != 0) continue;
      arg[0] = at->x[0]; arg[1] = at->x[1]; arg[2] = at->x[2]; arg[3] = at->u; arg[4] = at->p; arg[5] = at->q; arg[6] = sines;
      res[0] = (k < VALUES ? r : jac) + octo_piece_at[k];
      octo_piece(k, arg, res);
      continue;
    }
#if NFC > 0
    int piece = k - pieces, lanes = LANES - 32 * warp < 32 ? LANES - 32 * warp : 32;
    for (int c = LANE % 32; c < NFC; c += lanes) {
      for (int node = 0; node < 3; ++node) arg[node] = at->kin[node] + 12 * octo_cost_contact_body[c];
      arg[3] = octo_cost_contact_data + 4 * c; arg[4] = at->p; arg[5] = at->q;
      res[0] = (piece < CONTACT_VALUES ? r + NR + c * CR : touch + c * CR * 18) + octo_contact_piece_at[piece];
      octo_contact_piece(piece, arg, res);
    }
#endif
  }
  BARRIER;
}

/* Each step's share of each term; shared: MROWS + NU + 2 ANGLES doubles. */
extern "C" __global__ void octo_terms(int steps, const double *nodes, const double *kin, const double *p, const double *q, const double *fd,
                                      double *terms) {
  SHARED(r);
  double *u = r + MROWS;
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  octo_place_of_step at = octo_place_at(steps, blockIdx.y, blockIdx.x, nodes, kin, p, q, u);
  octo_costs_of_step(&at, fd + item * NX, r, 0, 0);
  EACH(k, NTERM) {
    double sum = 0.0;
    for (int row = 0; row < MROWS; ++row) {
      if (octo_row_term(row) != k) continue;
      double c = octo_coefficient(at.q, row);
      if (c != 0.0) sum += c * r[row] * r[row]; /* a step that a term leaves out may have no finite residual */
    }
    terms[item * NTERM + k] = sum;
  }
}

/* E, ‖C‖₁, ‖C‖∞ and ‖C‖₂² of each member; rows are the entries of C; grid (batch); shared: 4 PARTS doubles. */
extern "C" __global__ void octo_summary(int steps, int rows, const double *terms, const double *c, double *summary) {
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
extern "C" __global__ void octo_constraints(int count, int steps, int rows, const int *first, const int *test_step, const double *test_value,
                                            const double *row_scale, const double *fd, double *c) {
#if MU > 0
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int r = e % MU, row = e / MU % rows, member = e / MU / rows;
    double sum = 0.0;
    for (int t = first[row]; t < first[row + 1]; ++t)
      sum += test_value[t] * row_scale[member * MU + r] * fd[((size_t)member * steps + test_step[t]) * NX + octo_unactuated[r]];
    c[e] = sum;
  }
#endif
}

/* Residuals r (MROWS), their derivatives jac (NZ) and touch (TOUCH), and the multipliers lam (NX) of a step's FD: dE/du on the
 * actuated rows, Sᵀ multipliers on the others (none without multipliers). Shared: NU + 2 ANGLES doubles. */
extern "C" __global__ void octo_cost_derivatives(int steps, int rows, int tests, const int *test_row, const double *test_value,
                                                 const double *nodes, const double *kin, const double *p, const double *q,
                                                 const double *row_scale, const double *fd, const double *multipliers, double *r, double *jac,
                                                 double *touch, double *lam) {
  SHARED(u);
  size_t member = blockIdx.y, step = blockIdx.x, item = member * steps + step;
  octo_place_of_step at = octo_place_at(steps, member, step, nodes, kin, p, q, u);
  r += item * MROWS; jac += item * NZ; touch += item * TOUCH; lam += item * NX;
  octo_costs_of_step(&at, fd + item * NX, r, jac, touch);
  EACH(j, NU) {
    double sum = 0.0;
#if NR > 0
    for (int z = NZ - 1; z >= 0 && octo_state_entry_column[z] >= W3; --z) { /* those of u are last */
      int row = octo_state_entry_row[z];
      double c = at.q[octo_state_row_term[row]];
      if (octo_state_entry_column[z] - W3 == j && c != 0.0) sum += 2.0 * c * r[row] * jac[z];
    }
#endif
    lam[octo_actuated[j]] = sum;
  }
#if MU > 0
  EACH(k, MU) {
    double sum = 0.0;
    for (int t = (int)step * tests; multipliers && t < ((int)step + 1) * tests; ++t)
      if (test_row[t] >= 0) sum += test_value[t] * row_scale[member * MU + k] * multipliers[(member * rows + test_row[t]) * MU + k];
    lam[octo_unactuated[k]] = sum;
  }
#endif
}

/* The stacked rows d residual / d (next, now, previous), scaled by the root of twice their coefficient (0: left out). */
static __device__ inline void octo_stack_rows(const octo_place_of_step *at, const double *cost_jac, const double *touch, const double *jac,
                                              const double *scale, double *rows) {
  EACH(e, MROWS * W3) rows[e] = 0.0;
  BARRIER;
#if NR > 0
  EACH(z, NZ) {
    int row = octo_state_entry_row[z], column = octo_state_entry_column[z];
    if (column < W3 && scale[row] != 0.0) rows[row * W3 + column] = scale[row] * cost_jac[z];
  }
#endif
#if NFC > 0
  for (int row = NR; row < MROWS; ++row) {
    if (scale[row] == 0.0) continue;
    int body = octo_cost_contact_body[(row - NR) / CR], begin = octo_cost_path_start[body], length = octo_cost_path_start[body + 1] - begin;
    EACH(e, 3 * length) {
      int node = e / length, j = octo_cost_path[begin + e % length];
      const double *xi = at->kin[node] + 12 * NB + 6 * j, *g = touch + (row - NR) * 18 + 6 * node;
      rows[row * W3 + node * NX + j] =
          scale[row] * (g[0] * xi[0] + g[1] * xi[1] + g[2] * xi[2] + g[3] * xi[3] + g[4] * xi[4] + g[5] * xi[5]);
    }
  }
#endif
  BARRIER;
#if NR > 0
  for (int z = NZ - 1; z >= 0 && octo_state_entry_column[z] >= W3; --z) {
    int row = octo_state_entry_row[z];
    if (scale[row] == 0.0) continue;
    const double *source = jac + octo_actuated[octo_state_entry_column[z] - W3] * W3, value = scale[row] * cost_jac[z];
    EACH(j, W3) rows[row * W3 + j] += value * source[j];
  }
#endif
  BARRIER;
}

/* hess (6, NX, NX) = curvature (0: none) + rowsᵀ rows, gradient (W3) = rowsᵀ values. Shared: 2 MROWS, and MROWS W3 doubles of
 * rows unless global memory ``spill`` is given for them. */
extern "C" __global__ void octo_step_model(int steps, const double *nodes, const double *kin, const double *p, const double *q, const double *r,
                                           const double *cost_jac, const double *touch, const double *jac, const double *curvature,
                                           double *spill, double *hess, double *gradient) {
  SHARED(scale);
  double *value = scale + MROWS;
  size_t member = blockIdx.y, step = blockIdx.x, item = member * steps + step;
  double *rows = spill ? spill + item * MROWS * W3 : value + MROWS;
  octo_place_of_step at = octo_place_at(steps, member, step, nodes, kin, p, q, 0);
  EACH(row, MROWS) {
    double c = octo_coefficient(at.q, row);
    scale[row] = c != 0.0 ? sqrt(2.0 * c) : 0.0;
    value[row] = c != 0.0 ? scale[row] * r[item * MROWS + row] : 0.0;
  }
  BARRIER;
  octo_stack_rows(&at, cost_jac + item * NZ, touch + item * TOUCH, jac + item * NX * W3, scale, rows);
  const int newer[6] = {0, 0, 0, 1, 2, 1}, older[6] = {0, 1, 2, 1, 2, 2};
  EACH(e, 6 * NX * NX) {
    int block = e / (NX * NX), i = newer[block] * NX + e / NX % NX, j = older[block] * NX + e % NX;
    double sum = curvature && block < CURVATURE ? curvature[item * CURVATURE * NX * NX + e] : 0.0;
    for (int row = 0; row < MROWS; ++row)
      if (scale[row] != 0.0) sum += rows[row * W3 + i] * rows[row * W3 + j];
    hess[item * 6 * NX * NX + e] = sum;
  }
  EACH(j, W3) {
    double sum = 0.0;
    for (int row = 0; row < MROWS; ++row)
      if (scale[row] != 0.0) sum += value[row] * rows[row * W3 + j];
    gradient[item * W3 + j] = sum;
  }
}

/* H (units, 3, NCV, NCV) = Sᵀ hess S and b (units, NCV) = Sᵀ gradient, NCV = parts NX; grid (units, 3 lags, batch).
 * first ((units 3 parts parts) + 1) are the entries of each pair of parts: a step, its two nodes 3 a + b, their coefficient;
 * b_first likewise for each part of a unit. Units that nothing moves (dummy) are the identity. */
extern "C" __global__ void octo_gather_hessian(int steps, int parts, const int *first, const int *entry_step, const int *entry_nodes,
                                               const double *entry_value, const int *b_first, const int *b_step, const int *b_node,
                                               const double *b_value, const int *dummy, const double *hess, const double *gradient, double *h,
                                               double *b) {
  int unit = blockIdx.x, lag = blockIdx.y, units = gridDim.x, nc = parts * NX;
  size_t member = blockIdx.z;
  const double *own = hess + member * steps * 6 * NX * NX, *slope = gradient + member * steps * W3;
  const int block_of[9] = {0, 1, 2, 1, 3, 5, 2, 5, 4};
  double *out = h + ((member * units + unit) * 3 + lag) * nc * nc;
  EACH(e, nc * nc) {
    int i = e / nc, j = e % nc, r = i % NX, c = j % NX, at = ((unit * 3 + lag) * parts + i / NX) * parts + j / NX;
    double sum = dummy[unit] && lag == 0 && i == j ? 1.0 : 0.0;
    for (int t = first[at]; t < first[at + 1]; ++t) {
      const double *block = own + ((size_t)entry_step[t] * 6 + block_of[entry_nodes[t]]) * NX * NX;
      sum += entry_value[t] * (entry_nodes[t] / 3 <= entry_nodes[t] % 3 ? block[r * NX + c] : block[c * NX + r]);
    }
    out[e] = sum;
  }
  if (lag == 0)
    EACH(i, nc) {
      int at = unit * parts + i / NX;
      double sum = 0.0;
      for (int t = b_first[at]; t < b_first[at + 1]; ++t) sum += b_value[t] * slope[(size_t)b_step[t] * W3 + b_node[t] * NX + i % NX];
      b[(member * units + unit) * nc + i] = sum;
    }
}

/* A (units, 3, parts MU, parts NX) = Sᵀ U_/J S, scaled; grid (units, 3 lags, batch). Entries: a step and its node, by the part of
 * the row and of the unit. */
extern "C" __global__ void octo_gather_constraints(int steps, int parts, const int *first, const int *entry_step, const int *entry_node,
                                                   const double *entry_value, const double *row_scale, const double *jac, double *a) {
#if MU > 0
  int unit = blockIdx.x, lag = blockIdx.y, units = gridDim.x, nc = parts * NX, ma = parts * MU;
  size_t member = blockIdx.z;
  const double *own = jac + member * steps * NX * W3;
  double *out = a + ((member * units + unit) * 3 + lag) * ma * nc;
  EACH(e, ma * nc) {
    int i = e / nc, j = e % nc, at = ((unit * 3 + lag) * parts + i / MU) * parts + j / NX;
    double sum = 0.0, scale = row_scale[member * MU + i % MU];
    for (int t = first[at]; t < first[at + 1]; ++t)
      sum += entry_value[t] * own[((size_t)entry_step[t] * NX + octo_unactuated[i % MU]) * W3 + entry_node[t] * NX + j % NX];
    out[e] = scale * sum;
  }
#endif
}
