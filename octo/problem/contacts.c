/* E over contacts: its gradient and its blocks to the twists of a contact's body (problem/contact_model.py), a time step in every
 * lane. The blocks that FD's curvature has too are added to a link's composite (lanes_step.c); the others are summed from the leaves
 * of the tree on here, and paired with the joints' twists. Stands before assemble.c. */

#if NFC > 0
#define BLOCKS 6 /* 00 01 02 11 22 12: the last one FD does not have, its slots are kept for it */
#define COMMON (36 * (BLOCKS - 1))
#define TOUCHED (18 + 36 * BLOCKS)
#ifdef WORLD
#define GIVEN_TO_CONTACT 9 /* inputs of the terms: poses, sphere, p, q, of a world its jets, and use */
#else
#define GIVEN_TO_CONTACT 7
#endif

/* Which contacts touched the ground in the step before the group's first one; nobody knows before the first group. */
typedef struct {
  char known[NFC], touched[NFC];
  int apart;
#if NCROWD > 0
  unsigned char members[NMEMBER]; /* of crowds, the lanes in which they touch the ground at x, in the step that was the ``marked``-th */
  int marked;
#endif
} octo_rests;

/* apart: no step is the one before another. */
static void octo_rests_begin(octo_rests *s, int apart) {
  memset(s->known, 0, sizeof s->known);
  s->apart = apart;
#if NCROWD > 0
  s->marked = -1;
#endif
}

static int octo_touches_now(const octo_input *in, int c) {
  const double *sphere = octo_cost_contact_data + 4 * c;
  real center[3], gap, *depth[1] = {&gap};
  octo_place(in->kin[1] + 12 * octo_cost_contact_body[c], sphere, center);
#if NG > 0
  const ARGUMENT *place[4] = {center, sphere + 3, in->p, LOOKED(in->kin[1], octo_cost_contact_ground[c])};
#else
  const ARGUMENT *place[3] = {center, sphere + 3, in->p};
#endif
  STAGE(octo_gap, place, depth);
  return ANY(NOT(gap <= 0.0)); /* a NaN is not skipped */
}

#if NCROWD > 0
/* The same of a member of a crowd. */
static int octo_member_rests(octo_rests *s, const octo_work *work, const octo_input *in, int c, int member) {
  if (!s->known[c] && s->marked != work->evaluated) {
    octo_crowd_mark(in, 1, s->members);
    s->marked = work->evaluated;
  }
  int before = s->known[c] ? s->touched[c] : s->members[member] != 0;
  s->known[c] = !s->apart;
  s->touched[c] = work->members[member] >> (STEPS - 1) & 1;
  return !before && !work->members[member];
}
#endif

/* Whether a contact's terms are zero: it carries nothing in any lane, in this step and in the one before. To be asked once a group,
 * when the dynamics have evaluated the contact's link. */
static int octo_rest(octo_rests *s, const octo_work *work, const octo_input *in, int c) {
  int contact = octo_cost_contact_resting[c];
  if (contact < 0) return 0;
#if NCROWD > 0
  if (contact >= NC) return octo_member_rests(s, work, in, c, contact - NC);
#endif
  int before = s->known[c] ? s->touched[c] : octo_touches_now(in, c);
  s->known[c] = !s->apart;
  s->touched[c] = work->active[contact][STEPS - 1] != 0;
  return !before && !ANY(work->active[contact]);
}

/* ``looked`` is for what a world says of a member of a crowd. */
static void octo_contact_arguments(const octo_input *in, const real *q, int c, real (*looked)[JET], const void **arg) {
  for (int node = 0; node < 3; ++node) arg[node] = in->kin[node] + 12 * octo_cost_contact_body[c];
  arg[3] = octo_cost_contact_data + 4 * c, arg[4] = in->p, arg[5] = q;
#ifdef WORLD
  for (int node = 0; node < 2; ++node)
    arg[6 + node] = octo_looked(in->p, in->kin[node], octo_cost_contact_ground[c], octo_cost_contact_body[c],
                                octo_cost_contact_data + 4 * c, in->order + 1, looked[node]);
#endif
  arg[GIVEN_TO_CONTACT - 1] = octo_cost_contact_use + CR * c;
}

/* Adds each term's share of E over contacts to terms (NTERM). */
static void octo_sum_contacts(octo_rests *s, const octo_work *work, const octo_input *in, const real *q, real *terms) {
  for (int c = 0; c < NFC; ++c) {
    const void *arg[GIVEN_TO_CONTACT];
    real r[CR], looked[2][JET], *res[1] = {r};
    if (octo_rest(s, work, in, c)) continue;
    octo_contact_arguments(in, q, c, looked, arg);
    octo_contact_cost(arg, res);
    for (int k = 0; k < CR; ++k) {
      if (octo_cost_contact_use[c * CR + k] == 0.0) continue;
      real weight = q[octo_contact_row_term[k]], own = WHERE(weight != 0.0, r[k]); /* what is left out may be not finite */
      terms[octo_contact_row_term[k]] += weight * own * own;
    }
  }
}

/* carried: gradient, block 12 and, where there is no composite, the other blocks of what a link carries. */
typedef struct {
  real carried[NSLOT][TOUCHED], one[TOUCHED];
  char found[NLINK];
  int exact;
  octo_rests *rests; const octo_work *work; const real *q;
  real *gradient, *hess;
} octo_touched;

/* Derivatives of what link l carries, those of FD's blocks into common (COMMON) or where they are carried: whether there is something. */
static int octo_touch_carried(octo_touched *s, const octo_input *in, int l, real *common) {
  real *to = s->carried[octo_link_slot[l]];
  const int size = common ? TOUCHED - COMMON : TOUCHED;
  int any = 0;
  for (int child = NLINK - 1; child > l; --child) {
    if (octo_link_parent[child] != l || !s->found[child]) continue;
    const real *from = s->carried[octo_link_slot[child]];
    if (any) octo_add(size, from, to);
    else memcpy(to, from, size * sizeof(real));
    any = 1;
  }
  for (int k = octo_cost_contact_start[l]; k < octo_cost_contact_start[l + 1]; ++k) {
    const int c = octo_cost_contact_order[k];
    const void *arg[GIVEN_TO_CONTACT];
    real looked[2][JET], *res[1] = {s->one};
    if (octo_rest(s->rests, s->work, in, c)) continue;
    octo_contact_arguments(in, s->q, c, looked, arg);
    if (s->exact) octo_contact_exact(arg, res);
    else octo_contact_model(arg, res);
    if (!any) memset(to, 0, size * sizeof(real));
    octo_add(18, s->one, to);
    octo_add(36, s->one + 18 + COMMON, to + 18);
    octo_add(COMMON, s->one + 18, common ? common : to + 54);
    any = 1;
  }
  return any;
}

/* Adds what joint j and its ancestors make of a block to the slots that ``at`` stands in, of rows of j's ancestors in the newer node,
 * and ``back``, in the older one. */
static inline void octo_touch_block(const octo_input *in, const real *block, int j, int newer, int older, real *at, real *back) {
  const real *new_twist = in->kin[newer] + 12 * NB, *old_twist = in->kin[older] + 12 * NB;
  real down[6] = {ZERO}, up[6] = {ZERO};
  octo_apply(block, old_twist + 6 * j, down);
  if (newer != older) octo_apply_transposed(block, new_twist + 6 * j, up);
  for (int i = j; i >= 0; i = octo_before[i], ++at, ++back) {
    *at += octo_along(new_twist + 6 * i, down);
    if (newer != older) *back += octo_along(old_twist + 6 * i, up);
  }
}

/* What a link carries: the blocks of FD's curvature to its composite ``to``, or without one to hess. */
static void octo_touch_link(void *from, const octo_input *in, int l, octo_link_blocks *to) {
  static const int kind[BLOCKS] = {7, 0, 1, 2, 5, 6}, back[BLOCKS] = {8, 0, 3, 4, 5, 6}; /* runs of slots (lanes_step.c) */
  static const int newer[BLOCKS] = {1, 0, 0, 0, 1, 2}, older[BLOCKS] = {2, 0, 1, 2, 1, 2};
  octo_touched *s = from;
  const real *carried = s->carried[octo_link_slot[l]];
  s->found[l] = octo_touch_carried(s, in, l, to ? to->T[0] : 0);
  for (int j = octo_link_first[l]; s->found[l] && j <= octo_link_last[l]; ++j) {
    for (int node = 0; node < 3; ++node) s->gradient[node * NX + j] += octo_along(in->kin[node] + 12 * NB + 6 * j, carried + 6 * node);
    real *at = s->hess + 1 + octo_path_start[j];
    for (int b = 0; s->hess && b < (to ? 1 : BLOCKS); ++b)
      octo_touch_block(in, carried + 18 + 36 * b, j, newer[b], older[b], at + kind[b] * NRELATED, at + back[b] * NRELATED);
  }
}

/* Before a group: its second derivatives, ``exact`` or by Gauss and Newton, come with the curvature of FD, to which gradient and block
 * 12 are added. */
static void octo_touch_begin(octo_touched *s, octo_rests *rests, octo_lanes *lanes, const real *q, int exact, real *gradient) {
  memset(lanes->hess + 1 + 7 * NRELATED, 0, 2 * NRELATED * sizeof(real));
  s->rests = rests, s->work = &lanes->work, s->q = q, s->exact = exact, s->gradient = gradient, s->hess = lanes->hess;
  lanes->work.adder = octo_touch_link, lanes->work.adds = s;
}

/* The same where FD has no curvature: alone in hess, if any. */
static void octo_touch_alone(octo_touched *s, const octo_input *in) {
  if (s->hess) memset(s->hess, 0, (HESS_SLOTS - NCOUPLED) * sizeof(real));
  for (int l = NLINK - 1; l >= 0; --l) octo_touch_link(s, in, l, 0);
}
#endif
