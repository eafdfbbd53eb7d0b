/* Crowds, after tree.c: many contacts of one body, of which those near the ground are evaluated (crowd.py).
 *
 * A crowd's entries are spheres around its points and the points themselves, each sphere before what is in it: where it is out
 * of reach in every lane, the walk goes on behind that. A point is a contact sphere. In a world lanes that are at nearly one place,
 * as neighbouring steps are, are looked up together; otherwise each alone, and none below a sphere that is out of its reach.
 * Where a walk ended, its front, is kept with how far each of its entries was out of reach: the next groups of steps look only at
 * those that may have come into reach since, for no point has moved farther than the body's displacement. */

#if NCROWD > 0

#ifdef STEPS
#define CROWD_LANES STEPS
#define OF_LANE(value, k) ((value)[k])
#define SET_LANE(mask, k) ((mask)[k] = -1)
#define KEPT(mask, value) WHERE(mask, value)
#else
#define CROWD_LANES 1
#define OF_LANE(value, k) (value)
#define SET_LANE(mask, k) ((mask) = 1)
#define KEPT(mask, value) ((mask) ? (value) : 0.0)
#endif

typedef struct {
  double spare;  /* of φ: how far the entry was out of reach; negative: it was not, or nobody knows */
  double coarse; /* m, see the walk */
  int entry, behind; /* the first one, and the one behind the last: several where they follow each other in reach */
} octo_crowd_end;

/* Where a walk over a crowd ended: what is below these entries is all that there is. */
typedef struct {
  double pose[12]; /* of the body, in the first lane */
  int count, full; /* entries; how many were looked at to find them */
} octo_crowd_front;

typedef struct {
  octo_crowd_front front[NCROWD];
  octo_crowd_end end[NENTRY];
} octo_crowd_fronts;

typedef struct {
  const octo_input *in;
  const real *pose; /* of the body */
  double steepest, first[12]; /* the pose in the first lane */
  int entry, end, looked; /* how many entries */
  octo_crowd_front *front; /* or NULL */
  octo_crowd_end *ends;
  double moved, spare; /* of φ, at most: since the front was found; of the entry that was looked at last */
  int next;            /* of the front; -1: it is being found */
#ifdef WORLD
  const double *world;
  double apart;           /* m, how far the points in another lane are from those in the first one, at most */
  double reach, coarse;   /* m; the radius of the sphere that was asked last */
  int until[CROWD_LANES]; /* the entry from which on a lane takes part */
#endif
} octo_crowd_walk;

static inline void octo_crowd_forget(octo_crowd_fronts *fronts) {
  for (int q = 0; q < NCROWD; ++q) fronts->front[q].count = 0;
}

/* How far from a pose of numbers the points of a sphere are in any lane, m, at most. */
static inline double octo_crowd_way(const octo_crowd_walk *w, const double *from, int entry) {
  const double *sphere = octo_crowd_sphere + 4 * entry;
  double most = 0.0;
  real center[3], shifted = ZERO, turned = ZERO;
  octo_place(w->pose, sphere, center);
  for (int r = 0; r < 3; ++r) {
    const real by = center[r] - (octo_dot(from + 3 * r, sphere) + from[9 + r]);
    shifted += by * by;
  }
  for (int e = 0; e < 9; ++e) turned += (w->pose[e] - from[e]) * (w->pose[e] - from[e]);
  for (int k = 0; k < CROWD_LANES; ++k) {
    const double way = sqrt(OF_LANE(shifted, k)) + sqrt(OF_LANE(turned, k)) * octo_crowd_around[entry];
    if (way > most || way != way) most = way; /* a NaN stays */
  }
  return most;
}

/* Go on from the front of an earlier walk, or find one: where there is none, and where the body has moved by more than its size. */
static inline void octo_crowd_resume(octo_crowd_walk *w, octo_crowd_front *front, octo_crowd_end *ends) {
  w->front = front, w->ends = ends, w->next = -1;
  if (front->count > 0) {
    const double way = octo_crowd_way(w, front->pose, w->entry);
    w->moved = w->steepest * way;
    if (way <= octo_crowd_around[w->entry]) w->next = 0;
  }
  if (w->next == 0) {
    w->end = w->entry;
    return;
  }
  front->count = 0;
  for (int e = 0; e < 12; ++e) front->pose[e] = w->first[e];
}

/* Over crowd q where its body is at a node: 0 next, 1 now. ``fronts``, or NULL: of the groups of steps before. */
static inline void octo_crowd_begin(octo_crowd_walk *w, const octo_input *in, int node, int q, octo_crowd_fronts *fronts) {
  w->in = in, w->pose = in->kin[node] + 12 * octo_crowd_body[q];
  w->entry = octo_crowd_start[q], w->end = octo_crowd_start[q + 1];
  w->looked = 0, w->front = 0;
  for (int e = 0; e < 12; ++e) w->first[e] = OF_LANE(w->pose[e], 0);
#ifndef WORLD
  w->steepest = octo_crowd_steepest[0];
#else
  const double *arg[1] = {in->p};
  double *res[1] = {&w->reach};
  octo_reach(arg, res);
  w->world = (const double *)(size_t)in->p[WORLD];
  w->steepest = w->world[OCTO_WORLD_STEEPEST];
  for (int k = 0; k < CROWD_LANES; ++k) w->until[k] = w->entry;
  w->coarse = 0.0;
  w->apart = CROWD_LANES > 1 ? octo_crowd_way(w, w->first, w->entry) : 0.0;
#endif
  if (fronts) octo_crowd_resume(w, fronts->front + q, fronts->end + w->entry);
}

#ifdef WORLD
/* Whether something of an entry may be in reach in any lane, from one look-up where it is in the first one; -1 where the others are
 * too far from there for that to say enough. */
static inline int octo_crowd_together(octo_crowd_walk *w, int e, double radius) {
  if (octo_crowd_around[e] > 0.0) w->coarse = octo_crowd_around[e];
  if (!(w->apart <= 0.5 * w->coarse)) return -1; /* nor where it is a NaN */
  const double *sphere = octo_crowd_sphere + 4 * e, beyond = radius + w->steepest * w->apart + w->reach;
  double at[3], phi;
  for (int r = 0; r < 3; ++r) at[r] = octo_dot(w->first + 3 * r, sphere) + w->first[9 + r];
  octo_world_within(w->world, at, beyond, 0, &phi);
  w->spare = phi - radius - w->reach;
  return !(phi >= beyond);
}
#endif

/* In which lanes something of an entry may be in reach; a NaN is. */
static inline octo_mask octo_crowd_near(octo_crowd_walk *w, int e) {
  const double *sphere = octo_crowd_sphere + 4 * e;
  const double radius = sphere[3] + w->steepest * octo_crowd_around[e];
  real center[3];
  w->spare = -1.0;
#ifdef WORLD
  octo_mask near = {0};
  const int together = CROWD_LANES > 1 ? octo_crowd_together(w, e, radius) : -1;
  if (together == 0) return near;
  if (together > 0 && octo_crowd_member[e] < 0) return NOT(near);
  octo_place(w->pose, sphere, center);
  for (int k = 0; k < CROWD_LANES; ++k) {
    if (e < w->until[k]) continue;
    double at[3] = {OF_LANE(center[0], k), OF_LANE(center[1], k), OF_LANE(center[2], k)}, phi;
    octo_world_within(w->world, at, radius + w->reach, 0, &phi);
    if (k == 0) w->spare = phi - radius - w->reach;
    if (phi >= radius + w->reach) w->until[k] = octo_crowd_skip[e];
    else SET_LANE(near, k);
  }
  return near;
#else
  octo_place(w->pose, sphere, center);
  real gap, *depth[1] = {&gap};
  const ARGUMENT *place[3] = {center, &radius, w->in->p};
  STAGE(octo_gap, place, depth);
  w->spare = -OF_LANE(gap, 0);
  return NOT(gap <= 0.0);
#endif
}

/* Whether there is another entry of the front that may have come into reach. A front that spares less than half of the looks is
 * forgotten. */
static inline int octo_crowd_advance(octo_crowd_walk *w) {
  octo_crowd_front *front = w->front;
  if (!front) return 0;
  if (w->next < 0) {
    front->full = w->looked;
    return 0;
  }
  for (; w->next < front->count; ++w->next) {
    const octo_crowd_end *end = w->ends + w->next;
    if (end->spare > w->moved) continue;
    w->entry = end->entry, w->end = end->behind;
#ifdef WORLD
    w->coarse = end->coarse;
#endif
    ++w->next;
    return 1;
  }
  if (2 * w->looked > front->full) front->count = 0;
  return 0;
}

/* An entry at which a walk that finds a front does not go down. */
static inline void octo_crowd_ended(octo_crowd_walk *w, int e, double spare) {
  if (!w->front || w->next >= 0) return;
  octo_crowd_end *end = w->ends + w->front->count;
  if (spare < 0.0 && w->front->count > 0 && end[-1].spare < 0.0 && end[-1].behind == e) {
    end[-1].behind = octo_crowd_skip[e];
    return;
  }
  ++w->front->count;
  end->spare = spare, end->entry = e, end->behind = octo_crowd_skip[e];
#ifdef WORLD
  end->coarse = w->coarse;
#endif
}

/* The next point that may be in reach, and in which lanes; -1 behind the last one. */
static inline int octo_crowd_next(octo_crowd_walk *w, octo_mask *near) {
  while (w->entry < w->end || octo_crowd_advance(w)) {
    const int e = w->entry;
    *near = octo_crowd_near(w, e);
    ++w->looked;
    if (!ANY(*near)) {
      octo_crowd_ended(w, e, w->spare);
      w->entry = octo_crowd_skip[e];
      continue;
    }
    ++w->entry;
    if (octo_crowd_member[e] < 0) continue;
    octo_crowd_ended(w, e, -1.0);
    return e;
  }
  return -1;
}

#ifdef WORLD
/* φ and its derivatives at a contact sphere where it is near, elsewhere something that is out of reach. */
static inline void octo_crowd_look(const octo_crowd_walk *w, const double *sphere, octo_mask near, int order, real *jet) {
  real center[3];
  octo_place(w->pose, sphere, center);
  for (int k = 0; k < CROWD_LANES; ++k) {
    double at[3] = {OF_LANE(center[0], k), OF_LANE(center[1], k), OF_LANE(center[2], k)}, own[JET] = {0.0};
    const double beyond = sphere[3] + w->reach;
    if (OF_LANE(near, k)) octo_world_within(w->world, at, beyond, order, own);
    else own[0] = beyond + 1.0;
    for (int d = 0; d < octo_world_size(order); ++d) OF_LANE(jet[d], k) = own[d];
  }
}
#endif

/* Wrench and blocks of crowd q on a link of virtual twist V: the sums over its members that are active, in each lane.
 * ``members``, or NULL, gets of each member the lanes in which it is, a bit each; ``fronts``: see octo_crowd_begin. */
static void octo_crowd(const octo_input *in, int q, const real *V, octo_touch_blocks *sum, unsigned char *members,
                       octo_crowd_fronts *fronts) {
  const int size = in->order == 0 ? 6 : in->order == 1 ? 78 : 186;
  octo_crowd_walk w;
  octo_mask near, none = {0};
  octo_touch_blocks one;
  real jet[JET], *total = sum->W, *part = one.W; /* what an order has follows W */
  for (int k = 0; k < size; ++k) total[k] = ZERO;
  for (int m = octo_crowd_first[q]; members && m < octo_crowd_first[q + 1]; ++m) members[m] = 0;
  octo_crowd_begin(&w, in, 0, q, fronts);
  sum->active = none;
  for (int e; (e = octo_crowd_next(&w, &near)) >= 0;) {
    const double *sphere = octo_crowd_sphere + 4 * e;
#ifdef WORLD
    octo_crowd_look(&w, sphere, near, in->order + 1, jet);
#endif
    octo_contact_at(in, octo_crowd_body[q], sphere, jet, V, &one);
    one.active &= near;
    sum->active |= one.active;
    if (!ANY(one.active)) continue;
    for (int k = 0; k < size; ++k) total[k] += KEPT(one.active, part[k]);
    for (int k = 0; members && k < CROWD_LANES; ++k)
      members[octo_crowd_member[e]] |= (unsigned char)((OF_LANE(one.active, k) != 0) << k);
  }
}

/* In which lanes each member is in reach at a node, a bit each. */
static inline void octo_crowd_mark(const octo_input *in, int node, unsigned char *members) {
  for (int m = 0; m < NMEMBER; ++m) members[m] = 0;
  for (int q = 0; q < NCROWD; ++q) {
    octo_crowd_walk w;
    octo_mask near;
    octo_crowd_begin(&w, in, node, q, 0);
    for (int e; (e = octo_crowd_next(&w, &near)) >= 0;)
      for (int k = 0; k < CROWD_LANES; ++k)
        members[octo_crowd_member[e]] |= (unsigned char)((OF_LANE(near, k) != 0) << k);
  }
}
#endif
