/* A step's rows over the state, residuals scaled by the root of twice their coefficient: what they add to E, to its gradient and to
 * H. Sums are formed with a time step in every lane; what is left for each step is to write out the rows that are not of few
 * entries (lane_tables.py says which are). Stands before contacts.c. */

#define SLOPED (NFC > 0 || NFEW > 0) /* E has a gradient beside that of the rows written out */

/* square: of the rows of few entries, by place in H. single_*: of the rows of one torque alone, by torque, as one row of FD.
 * root, value, slope: of the other rows, scaled. */
#define ROW_SUMS(type) \
  type square[NPLACE + 1], single_root[NU + 1], single_value[NU + 1], root[NDENSE + 1], value[NDENSE + 1], slope[NENTRY + 1]
typedef struct { ROW_SUMS(real); } octo_row_sums;
typedef struct { ROW_SUMS(double); } octo_step_sums;

/* rows (count, LD) of d residual / d (x_next, x, x_prev), scaled; value of each row. */
typedef struct { double row[NDENSE + NU + 1][LD] __attribute__((aligned(64))); double value[NDENSE + NU + 1]; int count; } octo_rows;

/* Each term's share of E but for terms over contacts: terms (NTERM). */
static void octo_sum_rows(const real *q, const real *r, real *terms) {
  for (int k = 0; k < NTERM; ++k) terms[k] = ZERO;
  for (int row = 0; row < SQUARES; ++row) {
    real c = q[octo_state_row_term[row]], own = WHERE(c != 0.0, r[row]); /* a step that a term leaves out may have no finite residual */
    terms[octo_state_row_term[row]] += c * own * own;
  }
}

/* Sums of residuals r and their slopes, the multipliers of FD's curvature through the torques as pull (NU), and the gradient (W3) of the rows of few entries. */
static void octo_derive_rows(const real *q, const real *r, real *slopes, octo_row_sums *out, real *pull, real *gradient) {
  real weight[NR + 1], shift[NR + 1], single[NU + 1];
  for (int row = 0; row < NR; ++row) {
    weight[row] = octo_row_weight(q, row);
    shift[row] = WHERE(weight[row] != 0.0, octo_row_shift(q, row, r[row]));
  }
#if NBOUNDED > 0
  real multiplier[NR];
  for (int row = 0; row < NR; ++row) multiplier[row] = WHERE(weight[row] != 0.0, octo_row_multiplier(q, row, r[row]));
#else
  const real *multiplier = shift;
#endif
  for (int j = 0; j < NU; ++j) pull[j] = single[j] = out->single_value[j] = ZERO;
  for (int k = 0; k < NPLACE; ++k) out->square[k] = ZERO;
  for (int j = 0; j < W3; ++j) gradient[j] = ZERO;
  for (int z = 0; z < NZ; ++z) {
    int row = octo_state_entry_row[z], u = octo_state_entry_column[z] - W3;
    slopes[z] = WHERE(weight[row] != 0.0, slopes[z]);
    if (u >= 0) pull[u] += multiplier[row] * slopes[z];
  }
  for (int k = 0; k < NFEW; ++k) {
    int z = octo_few_entry[k];
    gradient[octo_state_entry_column[z]] += shift[octo_state_entry_row[z]] * slopes[z];
  }
  for (int k = 0; k < NPRODUCT; ++k) {
    const int *at = octo_product + 3 * k;
    out->square[at[2]] += weight[octo_state_entry_row[at[0]]] * slopes[at[0]] * slopes[at[1]];
  }
  for (int k = 0; k < NALONE; ++k) {
    int z = octo_single_entry[k], row = octo_state_entry_row[z], u = octo_state_entry_column[z] - W3;
    single[u] += weight[row] * slopes[z] * slopes[z];
    out->single_value[u] += shift[row] * slopes[z];
  }
  for (int j = 0; j < NU; ++j) {
    out->single_root[j] = octo_sqrt(single[j]);
    out->single_value[j] = WHERE(single[j] != 0.0, out->single_value[j] / out->single_root[j]);
  }
  for (int k = 0; k < NDENSE; ++k) {
    int row = octo_dense_row[k];
    out->root[k] = octo_sqrt(weight[row]);
    out->value[k] = WHERE(weight[row] != 0.0, shift[row] / out->root[k]);
    for (int e = octo_dense_start[k]; e < octo_dense_start[k + 1]; ++e) out->slope[e] = out->root[k] * slopes[octo_dense_entry[e]];
  }
}

/* The rows of a step that are written out; jac is that of FD. */
static void octo_build_rows(const octo_step_sums *s, const double *jac, octo_rows *rows) {
  rows->count = 0;
  for (int k = 0; k < NDENSE; ++k) {
    if (s->root[k] == 0.0) continue;
    double *out = rows->row[rows->count];
    for (int j = 0; j < LD; ++j) out[j] = 0.0;
    for (int e = octo_dense_start[k]; e < octo_dense_start[k + 1]; ++e) {
      int column = octo_state_entry_column[octo_dense_entry[e]];
      if (column < W3) { out[column] += s->slope[e]; continue; }
      const double *source = jac + octo_actuated[column - W3] * W3;
      for (int j = 0; j < W3; ++j) out[j] += s->slope[e] * source[j];
    }
    rows->value[rows->count++] = s->value[k];
  }
  for (int u = 0; u < NU && NALONE > 0; ++u) {
    if (s->single_root[u] == 0.0) continue;
    double *out = rows->row[rows->count];
    const double *source = jac + octo_actuated[u] * W3;
    for (int j = 0; j < W3; ++j) out[j] = s->single_root[u] * source[j];
    for (int j = W3; j < LD; ++j) out[j] = 0.0;
    rows->value[rows->count++] = s->single_value[u];
  }
}

/* hess (W3, LD), from the nodes' diagonal blocks on, += the products of the rows of few entries. */
static void octo_add_squares(const octo_step_sums *s, double *hess) {
  for (int k = 0; k < NPLACE; ++k) hess[octo_square_place[2 * k] * LD + octo_square_place[2 * k + 1]] += s->square[k];
}
