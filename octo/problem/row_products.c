/* What a linearisation keeps of the bounded rows of a step, and its products with a step of the nodes and with weights
 * of the rows: after scatter.c and the tables of row_products.py, before assemble.c, and only where there are bounded rows. Kept are
 * NKEPT slopes, sorted by row, then NPULLED numbers of FD's Jacobian, by the MOTORS that they look at. Of a row whose weight D is 0 the
 * slopes are 0. */

#define KEPT_ROOM (NKEPT + NPULLED)
#define PRODUCT_STEPS 64 /* of an item of work */

static double *octo_kept(const octo_task *t, int member, int i) { return t->kept + ((size_t)member * t->steps + i) * KEPT_ROOM; }

static octo_slot octo_pulled_slot[NPULLED + 1];
static char octo_pulled_use[NPULLED / STEPS + 1];

__attribute__((constructor)) static void octo_find_pulled(void) {
  for (int e = 0; e < NPULLED; ++e) octo_pulled_slot[e] = octo_jac_slot[octo_actuated[octo_pulled_motor[e]] * W3 + octo_pulled_column[e]];
  octo_find_use(octo_pulled_slot, NPULLED, JAC_SLOTS - NCOUPLED, octo_pulled_use);
}

/* Of ``count`` steps from i on, in lanes: slopes (NZ), and the Jacobian of FD before a cycle carries it back. */
static void octo_keep_rows(const octo_task *t, int member, int i, int count, const real *slopes, const octo_lanes *lanes) {
  real own[NKEPT + 1];
  double *to[STEPS], *pulled[STEPS];
  if (!t->kept) return;
  for (int z = 0; z < NKEPT; ++z) own[z] = slopes[octo_kept_entry[z]];
  for (int k = 0; k < count; ++k) {
    to[k] = octo_kept(t, member, i + k);
    pulled[k] = to[k] + NKEPT;
  }
  octo_spread(own, NKEPT, to, count);
  octo_scatter(lanes->jac, octo_pulled_slot, NPULLED, octo_pulled_use, lanes->touching, 2, pulled, count);
}

typedef struct { int steps, items; const double *kept, *moved; double *products; } octo_product_call;

static void octo_products_of_steps(void *shared, int item) {
  const octo_product_call *call = shared;
  int member = item / call->items, first = item % call->items * PRODUCT_STEPS, last = first + PRODUCT_STEPS;
  for (int i = first; i < last && i < call->steps; ++i) {
    size_t step = (size_t)member * call->steps + i;
    const double *kept = call->kept + step * KEPT_ROOM, *moved = call->moved + (step + 2 * member) * NX;
    double window[W3 + MOTORS + 1], *out = call->products + step * NBOUNDED;
    for (int node = 0; node < 3; ++node) memcpy(window + node * NX, moved + (2 - node) * NX, NX * sizeof(double));
    for (int k = 0; k < MOTORS; ++k) {
      double sum = 0.0;
      for (int e = octo_pulled_first[k]; e < octo_pulled_first[k + 1]; ++e) sum += kept[NKEPT + e] * window[octo_pulled_column[e]];
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

typedef struct { const octo_task *task; int items; const double *kept, *weights; double *window, *forces; } octo_force_call;

static void octo_forces_of_steps(void *shared, int item) { /* window (W3) = Rᵀ w of each step, on its nodes or what these are of */
  const octo_force_call *call = shared;
  int steps = call->task->steps, member = item / call->items, first = item % call->items * PRODUCT_STEPS, last = first + PRODUCT_STEPS;
  for (int i = first; i < last && i < steps; ++i) {
    size_t step = (size_t)member * steps + i;
    const double *kept = call->kept + step * KEPT_ROOM, *weights = call->weights + step * NBOUNDED;
    double window[W3 + MOTORS + 1] = {0.0};
    for (int row = 0; row < NBOUNDED; ++row)
      for (int z = octo_kept_first[row]; z < octo_kept_first[row + 1]; ++z) window[octo_kept_column[z]] += kept[z] * weights[row];
    for (int k = 0; k < MOTORS; ++k)
      for (int e = octo_pulled_first[k]; e < octo_pulled_first[k + 1]; ++e) window[octo_pulled_column[e]] += kept[NKEPT + e] * window[W3 + k];
    if (call->task->carry && i < 2) octo_carry_line(call->task->carry + (size_t)member * NX * NX, 1 + i, window);
    memcpy(call->window + step * W3, window, W3 * sizeof(double));
  }
}

static void octo_forces_of_member(void *shared, int member) { /* forces (units, nc), of the windows */
  const octo_force_call *call = shared;
  const octo_task *t = call->task;
  const double *window = call->window + (size_t)member * t->steps * W3;
  double *forces = call->forces + (size_t)member * t->units * t->nc;
  memset(forces, 0, (size_t)t->units * t->nc * sizeof(double));
  for (int j = 0; j < t->steps + 2; ++j) {
    double own[NX] = {0.0};
    for (int node = 0, i = j - 2; node < 3; ++node, ++i)
      if (i >= 0 && i < t->steps)
        for (int c = 0; c < NX; ++c) own[c] += window[(size_t)i * W3 + node * NX + c];
    for (int s = j * t->slots; s < (j + 1) * t->slots; ++s) {
      if (t->slot_unit[s] < 0) continue;
      double *to = forces + (size_t)t->slot_unit[s] * t->nc + t->slot_part[s] * NX;
      for (int c = 0; c < NX; ++c) to[c] += t->slot_value[s] * own[c];
    }
  }
}

/* forces (batch, units, nc) = Rᵀ w; kept as of octo_row_products, weights w (batch, steps, NBOUNDED), window (batch, steps, W3) room. */
void octo_row_forces(const octo_task *t, const double *kept, const double *weights, double *window, double *forces, int threads) {
  octo_force_call call = {t, (t->steps + PRODUCT_STEPS - 1) / PRODUCT_STEPS, kept, weights, window, forces};
  octo_parallel_for(octo_forces_of_steps, &call, t->batch * call.items, threads);
  octo_parallel_for(octo_forces_of_member, &call, t->batch, threads);
}
