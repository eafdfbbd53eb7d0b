/* Crowds, after tree.c: many contacts of one body, of which those near the ground are evaluated (crowd.py).
 *
 * A crowd's entries are spheres around its points and the points themselves, each sphere before what is in it: where it is out
 * of reach in every lane, the walk goes on behind that. A point is a contact sphere. In a world lanes that are at nearly one place,
 * as neighbouring steps are, are looked up together; otherwise each alone, and none below a sphere that is out of its reach. */

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
  const octo_input *in;
  const real *pose; /* of the body */
  double steepest;
  int entry, end;
#ifdef WORLD
  const double *world;
  double first[12];       /* the pose in the first lane */
  double apart;           /* m, how far the points in another lane are from those in the first one, at most */
  double reach, coarse;   /* m; the radius of the sphere that was asked last */
  int until[CROWD_LANES]; /* the entry from which on a lane takes part */
#endif
} octo_crowd_walk;

#ifdef WORLD
static inline void octo_crowd_apart(octo_crowd_walk *w) {
  const double *sphere = octo_crowd_sphere + 4 * w->entry; /* around all points */
  real center[3];
  octo_place(w->pose, sphere, center);
  for (int e = 0; e < 12; ++e) w->first[e] = OF_LANE(w->pose[e], 0);
  for (int k = 1; k < CROWD_LANES; ++k) {
    double moved = 0.0, turned = 0.0;
    for (int r = 0; r < 3; ++r) moved += (OF_LANE(center[r], k) - OF_LANE(center[r], 0)) * (OF_LANE(center[r], k) - OF_LANE(center[r], 0));
    for (int e = 0; e < 9; ++e) turned += (OF_LANE(w->pose[e], k) - w->first[e]) * (OF_LANE(w->pose[e], k) - w->first[e]);
    const double way = sqrt(moved) + sqrt(turned) * octo_crowd_around[w->entry];
    if (way > w->apart || way != way) w->apart = way; /* a NaN stays */
  }
}
#endif

/* Over crowd q where its body is at a node: 0 next, 1 now. */
static inline void octo_crowd_begin(octo_crowd_walk *w, const octo_input *in, int node, int q) {
  w->in = in, w->pose = in->kin[node] + 12 * octo_crowd_body[q];
  w->entry = octo_crowd_start[q], w->end = octo_crowd_start[q + 1];
#ifndef WORLD
  w->steepest = octo_crowd_steepest[0];
#else
  const double *arg[1] = {in->p};
  double *res[1] = {&w->reach};
  octo_reach(arg, res);
  w->world = (const double *)(size_t)in->p[WORLD];
  w->steepest = w->world[OCTO_WORLD_STEEPEST];
  for (int k = 0; k < CROWD_LANES; ++k) w->until[k] = w->entry;
  w->coarse = w->apart = 0.0;
  octo_crowd_apart(w);
#endif
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
  return !(phi >= beyond);
}
#endif

/* In which lanes something of an entry may be in reach; a NaN is. */
static inline octo_mask octo_crowd_near(octo_crowd_walk *w, int e) {
  const double *sphere = octo_crowd_sphere + 4 * e;
  const double radius = sphere[3] + w->steepest * octo_crowd_around[e];
  real center[3];
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
    if (phi >= radius + w->reach) w->until[k] = octo_crowd_skip[e];
    else SET_LANE(near, k);
  }
  return near;
#else
  octo_place(w->pose, sphere, center);
  real gap, *depth[1] = {&gap};
  const ARGUMENT *place[3] = {center, &radius, w->in->p};
  STAGE(octo_gap, place, depth);
  return NOT(gap <= 0.0);
#endif
}

/* The next point that may be in reach, and in which lanes; -1 behind the last one. */
static inline int octo_crowd_next(octo_crowd_walk *w, octo_mask *near) {
  while (w->entry < w->end) {
    const int e = w->entry;
    *near = octo_crowd_near(w, e);
    if (!ANY(*near)) { w->entry = octo_crowd_skip[e]; continue; }
    ++w->entry;
    if (octo_crowd_member[e] >= 0) return e;
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
 * ``members``, or NULL, gets of each member the lanes in which it is, a bit each. */
static void octo_crowd(const octo_input *in, int q, const real *V, octo_touch_blocks *sum, unsigned char *members) {
  const int size = in->order == 0 ? 6 : in->order == 1 ? 78 : 186;
  octo_crowd_walk w;
  octo_mask near, none = {0};
  octo_touch_blocks one;
  real jet[JET], *total = sum->W, *part = one.W; /* what an order has follows W */
  for (int k = 0; k < size; ++k) total[k] = ZERO;
  for (int m = octo_crowd_first[q]; members && m < octo_crowd_first[q + 1]; ++m) members[m] = 0;
  octo_crowd_begin(&w, in, 0, q);
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
    octo_crowd_begin(&w, in, node, q);
    for (int e; (e = octo_crowd_next(&w, &near)) >= 0;)
      for (int k = 0; k < CROWD_LANES; ++k)
        members[octo_crowd_member[e]] |= (unsigned char)((OF_LANE(near, k) != 0) << k);
  }
}
#endif
