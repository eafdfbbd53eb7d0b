/* What a linearisation keeps of the bounded rows of a step, and their products with a step of the nodes: the mathematics of
 * problem/row_products.c. After model.cu and the tables of problem/row_products.py, and only where there are bounded rows. */

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
