/* What a linearisation keeps of the bounded rows of a step, and its products with a step of the nodes and with weights
 * of the rows: the mathematics of problem/row_products.c. After gather.cu and the tables of problem/row_products.py, and only where there are bounded rows. */

#define KEPT_ROOM (NKEPT + NPULLED)

/* kept (KEPT_ROOM) of each step, before a cycle carries jac back; grid (steps, batch). */
extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_keep_rows(int steps, const double *q, const double *cost_jac, const double *jac, double *kept) {
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  q += item * NQ; cost_jac += item * NZ; jac += item * NX * W3; kept += item * KEPT_ROOM;
  EACH(e, KEPT_ROOM) {
    int z = e < NKEPT ? octo_kept_entry[e] : 0, k = e - NKEPT;
    if (e >= NKEPT) kept[e] = jac[octo_actuated[octo_pulled_motor[k]] * W3 + octo_pulled_column[k]];
    else kept[e] = octo_row_weight(q, octo_state_entry_row[z]) != 0.0 ? cost_jac[z] : 0.0;
  }
}

/* products (NBOUNDED) = R Δ of each step, moved (batch, steps + 2, NX) the step of the nodes, oldest first; grid (steps, batch); shared:
 * W3 + MOTORS doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_row_products(int steps, const double *kept, const double *moved, double *products) {
  SHARED(window);
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  kept += item * KEPT_ROOM; moved += (item + 2 * (size_t)blockIdx.y) * NX; products += item * NBOUNDED;
  EACH(j, W3) window[j] = moved[(2 - j / NX) * NX + j % NX];
  BARRIER;
  EACH(k, MOTORS) {
    double sum = 0.0;
#pragma unroll 8
    for (int e = octo_pulled_first[k]; e < octo_pulled_first[k + 1]; ++e) sum += kept[NKEPT + e] * window[octo_pulled_column[e]];
    window[W3 + k] = sum;
  }
  BARRIER;
  EACH(row, NBOUNDED) {
    double sum = 0.0;
    for (int z = octo_kept_first[row]; z < octo_kept_first[row + 1]; ++z) sum += kept[z] * window[octo_kept_column[z]];
    products[row] = sum;
  }
}

/* window (W3) = Rᵀ w of each step, on its nodes or, of a cycle's first two steps, on what these are of: weights w (NBOUNDED), carry
 * (NX, NX) or none; grid (steps, batch); shared: W3 + MOTORS doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_row_forces(int steps, const double *kept, const double *weights, const double *carry, double *window) {
  SHARED(held);
  int step = blockIdx.x;
  size_t item = (size_t)blockIdx.y * steps + step;
  kept += item * KEPT_ROOM; weights += item * NBOUNDED; window += item * W3;
  EACH(j, W3 + MOTORS) {
    double sum = 0.0;
    for (int e = octo_turned_first[j]; e < octo_turned_first[j + 1]; ++e) sum += kept[octo_turned_entry[e]] * weights[octo_turned_row[e]];
    held[j] = sum;
  }
  BARRIER;
  EACH(j, W3) {
    double sum = held[j];
#pragma unroll 8
    for (int e = octo_back_first[j]; e < octo_back_first[j + 1]; ++e) sum += kept[NKEPT + octo_back_entry[e]] * held[W3 + octo_back_motor[e]];
    held[j] = sum; /* nobody else's */
  }
  BARRIER;
  EACH(j, W3) {
    int node = j / NX;
    double sum = held[j];
    if (carry && node > step) {
      const double *own = carry + (size_t)blockIdx.y * NX * NX + j % NX;
      sum = 0.0;
      for (int k = 0; k < NX; ++k) sum += held[node * NX + k] * own[k * NX];
    }
    window[j] = sum;
  }
}

/* forces (units, parts NX) = Sᵀ window; tables of b; grid (units, batch). */
extern "C" __global__ void __launch_bounds__(SMALL, 8)
octo_gather_forces(int steps, int parts, const int *first, const int *source, const double *value, const double *window, double *forces) {
  int unit = blockIdx.x;
  window += (size_t)blockIdx.y * steps * W3; forces += ((size_t)blockIdx.y * gridDim.x + unit) * parts * NX;
  EACH(c, NX) {
    if (parts == 1) octo_gather_parts<1>(first + unit, source, value, window, c, forces);
#ifdef FOUR_PARTS
    else if (parts == 4) octo_gather_parts<4>(first + unit, source, value, window, c, forces);
#endif
    else octo_gather_parts<2>(first + unit, source, value, window, c, forces);
  }
}
