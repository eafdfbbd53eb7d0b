/* The rows of a step's costs, those over the state before those over contacts: after the tables of the costs (codegen.py), in C
 * that is CUDA too. */

#define MROWS (NR + NFC * CR)

/* What a row's square is multiplied with in E, 0 where the row is not used. */
static inline double octo_coefficient(const double *q, int row) {
#if NFC > 0
  if (row >= NR) {
    int k = (row - NR) / CR, c = (row - NR) % CR;
    return octo_cost_contact_use[k * CR + c] * q[octo_contact_row_term[c]];
  }
#endif
  return q[octo_state_row_term[row]];
}

/* The term that a row belongs to. */
static inline int octo_row_term(int row) {
#if NFC > 0
  if (row >= NR) return octo_contact_row_term[(row - NR) % CR];
#endif
  return octo_state_row_term[row];
}
