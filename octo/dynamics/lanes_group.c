/* The steps of one problem, a group of STEPS after the other: each node's poses and twists are evaluated once, in the lanes
 * of its neighbours. Lanes behind the last step repeat the last node. */

#include <stdlib.h>
#include <string.h>

#define NODE (NX + KIN)

typedef struct {
  real nodes[2][NODE], now[NODE], next[NODE]; /* x and kin: of the nodes from the previous one on, and one, two further */
  real lam[NX], fd[NX], jac[JAC_SLOTS], hess[HESS_SLOTS];
  octo_work work;
  octo_last_looks looks;
  const double *from; /* the problem's nodes */
  int node, last;     /* the first node of ``nodes[ring]``, the last one there is */
  int apart;          /* the steps share no nodes */
  int fresh;          /* nothing is loaded yet */
  int ring, touching; /* the pairs have written into slots that are zero otherwise */
} octo_lanes;

/* Where the STEPS numbers from e on are written: the last ones of a row again, for it may end between them. */
static inline int octo_start(int e, int size) { return e + STEPS <= size ? e : size - STEPS; }

/* Of STEPS numbers of jac or hess, 0: some are written, 1: by pairs alone, 2: always zero. */
static char octo_jac_use[3 * NX * NX / STEPS + 1], octo_hess_use[CURVATURE * NX * NX / STEPS + 1];

static void octo_find_use(const octo_slot *slot, int size, int coupled, char *use) {
  for (int e = 0; e < size; e += STEPS) {
    use[e / STEPS] = 2;
    for (int at = size < STEPS ? 0 : octo_start(e, size); at < size && at < e + STEPS; ++at) {
      int kind = slot[at] == 0 ? 2 : slot[at] >= coupled;
      if (kind < use[e / STEPS]) use[e / STEPS] = kind;
    }
  }
}

__attribute__((constructor)) static void octo_find_uses(void) {
  octo_find_use(octo_jac_slot, 3 * NX * NX, JAC_SLOTS - NCOUPLED, octo_jac_use);
  octo_find_use(octo_hess_slot, CURVATURE * NX * NX, HESS_SLOTS - NCOUPLED, octo_hess_use);
}

/* ``size`` numbers of every step out of their slots (slot 0 is zero) to the first ``count`` steps, STEPS at a time. Those
 * whose ``use`` is beyond ``most`` are zero, and beyond ``kept`` they are so already. */
static inline void octo_scatter(const real *from, const octo_slot *slot, int size, const char *use, int most, int kept,
                                double *const *to, int count) {
  for (int e = 0; e < size && size < STEPS; ++e)
    for (int k = 0; k < count; ++k) to[k][e] = from[slot[e]][k];
  for (int e = 0; e < size && size >= STEPS; e += STEPS) {
    int at = octo_start(e, size);
    if (use[e / STEPS] > kept) continue;
    if (use[e / STEPS] > most) {
      for (int k = 0; k < count; ++k) *(octo_real_anywhere *)(to[k] + at) = ZERO;
      continue;
    }
    real v[STEPS];
    for (int k = 0; k < STEPS; ++k) v[k] = from[slot[at + k]];
    octo_transpose(v);
    if (count == STEPS) {
      for (int k = 0; k < STEPS; ++k) *(octo_real_anywhere *)(to[k] + at) = v[k];
      continue;
    }
    real rows[STEPS]; /* beside the registers, for their count varies */
    for (int k = 0; k < STEPS; ++k) rows[k] = v[k];
    for (int k = 0; k < count; ++k) *(octo_real_anywhere *)(to[k] + at) = rows[k];
  }
}

static void octo_lanes_load(octo_lanes *s, int first, const double *p, int order, real *out) {
  const double *from[STEPS];
  for (int k = 0; k < STEPS; ++k) from[k] = s->from + (size_t)(first + k < s->last ? first + k : s->last) * NX;
  octo_gather(from, NX, out);
  octo_kin(out, out + NX);
  octo_look(p, order + 1, out + NX, &s->looks);
}

/* Start at step ``first`` of a problem's nodes (.., NX), the last of which is ``last``. */
static void octo_lanes_begin(octo_lanes *s, const double *nodes, int first, int last) {
  s->from = nodes, s->node = first, s->last = last, s->ring = s->apart = 0, s->fresh = 1;
  octo_work_begin(&s->work);
  octo_last_begin(&s->looks);
}

/* Start at step ``first``, the last is ``last``, of steps with three nodes of their own each, (.., 3, NX), x_next first. */
static void octo_lanes_begin_apart(octo_lanes *s, const double *nodes, int first, int last) {
  s->from = nodes, s->node = first, s->last = last, s->apart = 1;
  octo_work_begin(&s->work);
  octo_last_begin(&s->looks);
}

static octo_input octo_lanes_turn_apart(octo_lanes *s, const double *p, int order) {
  real *own[3] = {s->next, s->now, s->nodes[0]};
  for (int node = 0; node < 3; ++node) {
    const double *from[STEPS];
    for (int k = 0; k < STEPS; ++k) from[k] = s->from + ((size_t)(s->node + k < s->last ? s->node + k : s->last) * 3 + node) * NX;
    octo_gather(from, NX, own[node]);
    octo_kin(own[node], own[node] + NX);
    octo_look(p, order + 1, own[node] + NX, &s->looks);
  }
  s->node += STEPS;
  return (octo_input){{own[0], own[1], own[2]}, {own[0] + NX, own[1] + NX, own[2] + NX}, p, s->lam, order};
}

/* The next group; ``ring`` has turned after it. */
static octo_input octo_lanes_turn(octo_lanes *s, const double *p, int order) {
  if (s->apart) return octo_lanes_turn_apart(s, p, order);
  const real *previous = s->nodes[s->ring];
  if (s->fresh) octo_lanes_load(s, s->node, p, order, s->nodes[s->ring]);
  s->fresh = 0;
  s->node += STEPS;
  octo_lanes_load(s, s->node, p, order, s->nodes[!s->ring]);
  const real *after = s->nodes[!s->ring];
#if NG > 0
  const int jets = NODE - NG * JET; /* of a jet what its order has */
  octo_following(previous, after, jets, s->now, s->next);
  for (int at = jets; at < NODE; at += JET)
    octo_following(previous + at, after + at, octo_world_size(order + 1), s->now + at, s->next + at);
#else
  octo_following(previous, after, NODE, s->now, s->next);
#endif
  s->ring = !s->ring;
  return (octo_input){{s->next, s->now, previous}, {s->next + NX, s->now + NX, previous + NX}, p, s->lam, order};
}

/* What octo_lanes_run finds at zero. */
static void octo_lanes_clear(octo_lanes *s) {
  s->touching = 0;
  s->jac[0] = s->hess[0] = ZERO;
  memset(s->jac + JAC_SLOTS - NCOUPLED, 0, NCOUPLED * sizeof(real));
  memset(s->hess + HESS_SLOTS - NCOUPLED, 0, NCOUPLED * sizeof(real));
}

/* FD, J and H of a group into their slots; what the pairs wrote the last time is cleared before. */
static void octo_lanes_run(octo_lanes *s, const octo_input *in) {
  if (s->touching) octo_lanes_clear(s);
  s->touching = octo_step(in, s->fd, s->jac, s->hess, &s->work);
}
