/* What a linearisation keeps of the bounded rows of a step, and their products with a step of the nodes: after scatter.c and the
 * tables of row_products.py, before assemble.c, and only where there are bounded rows. Kept are NKEPT slopes, sorted by row, then
 * the rows of FD's Jacobian of the NPULLED motors that they look at. Of a row whose weight D is 0 the slopes are 0. */

#define KEPT_ROOM (NKEPT + NPULLED * W3)
#define PRODUCT_STEPS 64 /* of an item of work */

static double *octo_kept(const octo_task *t, int member, int i) { return t->kept + ((size_t)member * t->steps + i) * KEPT_ROOM; }

/* slopes (NZ) of ``count`` steps from i on, in lanes. */
static void octo_keep_slopes(const octo_task *t, int member, int i, int count, const real *slopes) {
  real own[NKEPT + 1];
  double *to[STEPS];
  if (!t->kept) return;
  for (int z = 0; z < NKEPT; ++z) own[z] = slopes[octo_kept_entry[z]];
  for (int k = 0; k < count; ++k) to[k] = octo_kept(t, member, i + k);
  octo_spread(own, NKEPT, to, count);
}

/* jac (NX, W3) of the FD of step i, before a cycle carries it back. */
static void octo_keep_torques(const octo_task *t, int member, int i, const double *jac) {
  if (!t->kept) return;
  double *to = octo_kept(t, member, i) + NKEPT;
  for (int k = 0; k < NPULLED; ++k) memcpy(to + k * W3, jac + octo_actuated[octo_kept_motor[k]] * W3, W3 * sizeof(double));
}

typedef struct { int steps, items; const double *kept, *moved; double *products; } octo_product_call;

static void octo_products_of_steps(void *shared, int item) {
  const octo_product_call *call = shared;
  int member = item / call->items, first = item % call->items * PRODUCT_STEPS, last = first + PRODUCT_STEPS;
  for (int i = first; i < last && i < call->steps; ++i) {
    size_t step = (size_t)member * call->steps + i;
    const double *kept = call->kept + step * KEPT_ROOM, *moved = call->moved + (step + 2 * member) * NX;
    double window[W3 + NPULLED + 1], *out = call->products + step * NBOUNDED;
    for (int node = 0; node < 3; ++node) memcpy(window + node * NX, moved + (2 - node) * NX, NX * sizeof(double));
    for (int k = 0; k < NPULLED; ++k) {
      const double *jac = kept + NKEPT + k * W3;
      double sum = 0.0;
      for (int j = 0; j < W3; ++j) sum += jac[j] * window[j];
      window[W3 + k] = sum;
    }
    for (int row = 0; row < NBOUNDED; ++row) {
      double sum = 0.0;
      for (int z = octo_kept_first[row]; z < octo_kept_first[row + 1]; ++z) sum += kept[z] * window[octo_kept_column[z]];
      out[row] = sum;
    }
  }
}

/* products (batch, steps, NBOUNDED) = R Δ; kept (batch, steps, KEPT_ROOM) out of octo_linearize, moved (batch, steps + 2, NX) the step
 * of the nodes, oldest first. */
void octo_row_products(int batch, int steps, const double *kept, const double *moved, double *products, int threads) {
  octo_product_call call = {steps, (steps + PRODUCT_STEPS - 1) / PRODUCT_STEPS, kept, moved, products};
  octo_parallel_for(octo_products_of_steps, &call, batch * call.items, threads);
}
