/* The rows of a step's costs, those over the state before those over contacts: after the tables of the costs (codegen.py), in C
 * that is CUDA too. Of those over the state the last NBOUNDED are no squares of E: q ends with a weight D, a shift d and a multiplier y
 * of each. */

#define MROWS (NR + NFC * CR)

#define SQUARES (NR - NBOUNDED)

#ifdef STEPS /* a step in every lane */
typedef real octo_row_number;
#else
typedef double octo_row_number;
#endif

/* What a row's square is multiplied with in E, 0 where the row is not used. */
static inline double octo_coefficient(const double *q, int row) {
#if NFC > 0
  if (row >= NR) {
    int k = (row - NR) / CR, c = (row - NR) % CR;
    return octo_cost_contact_use[k * CR + c] * q[octo_contact_row_term[c]];
  }
#endif
#if NBOUNDED > 0
  if (row >= SQUARES) return 0.0;
#endif
  return q[octo_state_row_term[row]];
}

/* What a row over the state adds to the model: D r' r'ᵀ to H and d r' to b, of a square 2c and 2cr. */
static inline octo_row_number octo_row_weight(const octo_row_number *q, int row) {
#if NBOUNDED > 0
  if (row >= SQUARES) return q[NQ - 3 * NBOUNDED + row - SQUARES];
#endif
  return 2.0 * q[octo_state_row_term[row]];
}

static inline octo_row_number octo_row_shift(const octo_row_number *q, int row, octo_row_number r) {
#if NBOUNDED > 0
  if (row >= SQUARES) return q[NQ - 2 * NBOUNDED + row - SQUARES];
#endif
  return 2.0 * q[octo_state_row_term[row]] * r;
}

/* What the second derivatives of a row over the state, and of FD through its torques, are multiplied with: y, of a square 2cr. */
static inline octo_row_number octo_row_multiplier(const octo_row_number *q, int row, octo_row_number r) {
#if NBOUNDED > 0
  if (row >= SQUARES) return q[NQ - NBOUNDED + row - SQUARES];
#endif
  return octo_row_shift(q, row, r);
}

/* The term that a row belongs to. */
static inline int octo_row_term(int row) {
#if NFC > 0
  if (row >= NR) return octo_contact_row_term[(row - NR) % CR];
#endif
  return octo_state_row_term[row];
}
