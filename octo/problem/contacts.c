/* E over contacts: its gradient and its blocks to the twists of a contact's body (problem/contact_model.py), summed from the leaves of
 * the tree on and paired with the joints' twists, a time step in every lane. Stands before assemble.c. */

#if NFC == 0
#define BLOCKS CURVATURE
#else
#define BLOCKS 6 /* 00 01 02 11 22 12: the last one, which FD does not have, is kept beside the slots of lanes_step.c */
#define TOUCHED (18 + 36 * BLOCKS)

typedef struct { real carried[NSLOT][TOUCHED], one[TOUCHED], past[1 + 2 * NRELATED], gradient[W3]; } octo_touched;

static char octo_past_use[NX * NX / STEPS + 1];
__attribute__((constructor)) static void octo_find_past_use(void) {
  octo_find_use(octo_past_slot, NX * NX, 1 + 2 * NRELATED, octo_past_use);
}

/* Whether a contact's terms are zero: it carries nothing in any lane, in this step and in the one before. */
static int octo_rests(const octo_input *in, int c) {
  const double *sphere = octo_cost_contact_data + 4 * c;
  if (!octo_cost_contact_resting[c]) return 0;
  for (int node = 0; node < 2; ++node) {
    real center[3], gap, *depth[1] = {&gap};
    octo_place(in->kin[node] + 12 * octo_cost_contact_body[c], sphere, center);
    const ARGUMENT *place[3] = {center, sphere + 3, in->p};
    STAGE(octo_gap, place, depth);
    if (ANY(NOT(gap <= 0.0))) return 0; /* a NaN is not skipped */
  }
  return 1;
}

static void octo_contact_arguments(const octo_input *in, const real *q, int c, const void **arg) {
  for (int node = 0; node < 3; ++node) arg[node] = in->kin[node] + 12 * octo_cost_contact_body[c];
  arg[3] = octo_cost_contact_data + 4 * c, arg[4] = in->p, arg[5] = q, arg[6] = octo_cost_contact_use + CR * c;
}

/* Residuals r (NFC, CR). */
static void octo_contact_values(const octo_input *in, const real *q, real *r) {
  for (int c = 0; c < NFC; ++c) {
    const void *arg[7];
    real *res[1] = {r + c * CR};
    octo_contact_arguments(in, q, c, arg);
    if (octo_rests(in, c)) memset(res[0], 0, CR * sizeof(real));
    else octo_contact_cost(arg, res);
  }
}

/* Derivatives of what link l carries: whether there is something. */
static int octo_touch_link(octo_touched *s, const octo_input *in, const real *q, int exact, int l, const char *found) {
  real *to = s->carried[octo_link_slot[l]];
  int any = 0;
  for (int c = 0; c < NFC; ++c) {
    int joint = octo_cost_contact_joint[c];
    const void *arg[7];
    if (joint < 0 || octo_link_of[joint] != l || octo_rests(in, c)) continue;
    octo_contact_arguments(in, q, c, arg);
    real *res[1] = {any ? s->one : to};
    if (exact) octo_contact_exact(arg, res);
    else octo_contact_model(arg, res);
    if (any) octo_add(TOUCHED, s->one, to);
    any = 1;
  }
  for (int child = NLINK - 1; child > l; --child) {
    if (octo_link_parent[child] != l || !found[child]) continue;
    if (any) octo_add(TOUCHED, s->carried[octo_link_slot[child]], to);
    else memcpy(to, s->carried[octo_link_slot[child]], TOUCHED * sizeof(real));
    any = 1;
  }
  return any;
}

/* Adds what joint j and its ancestors make of it to their slots of hess and of the block 12. */
static void octo_touch_joint(octo_touched *s, const octo_input *in, const real *touched, int j, real *hess) {
  static const int kind[BLOCKS] = {0, 1, 2, 5, 6, 0}, newer[BLOCKS] = {0, 0, 0, 1, 2, 1}, older[BLOCKS] = {0, 1, 2, 1, 2, 2};
  const real *twist[3];
  for (int node = 0; node < 3; ++node) {
    twist[node] = in->kin[node] + 12 * NB;
    s->gradient[node * NX + j] = octo_along(twist[node] + 6 * j, touched + 6 * node);
  }
  for (int b = 0; hess && b < BLOCKS; ++b) {
    const real *block = touched + 18 + 36 * b;
    real down[6] = {ZERO}, up[6] = {ZERO}; /* the row of j's ancestors in the newer node, and in the older one */
    real *at = (b < 5 ? hess + 1 + kind[b] * NRELATED : s->past + 1) + octo_path_start[j], *back = b < 5 ? at + 2 * NRELATED : at + NRELATED;
    octo_apply(block, twist[older[b]] + 6 * j, down);
    if (newer[b] != older[b]) octo_apply_transposed(block, twist[newer[b]] + 6 * j, up);
    for (int i = j; i >= 0; i = octo_before[i], ++at, ++back) {
      *at += octo_along(twist[newer[b]] + 6 * i, down);
      if (newer[b] != older[b]) *back += octo_along(twist[older[b]] + 6 * i, up);
    }
  }
}

/* Adds the second derivatives of a group, ``exact`` or by Gauss and Newton, to hess, if any, and writes block 12 and the gradient. */
static void octo_touch(octo_touched *s, const octo_input *in, const real *q, int exact, real *hess) {
  char found[NLINK];
  memset(s->past, 0, sizeof s->past);
  memset(s->gradient, 0, sizeof s->gradient);
  for (int l = NLINK - 1; l >= 0; --l) {
    found[l] = octo_touch_link(s, in, q, exact, l, found);
    for (int j = octo_link_first[l]; found[l] && j <= octo_link_last[l]; ++j)
      octo_touch_joint(s, in, s->carried[octo_link_slot[l]], j, hess);
  }
}
#endif
