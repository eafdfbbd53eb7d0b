/* Contacts of a deforming surface, after elastic.c: a walk over the spheres that bend with it (near.py), and of every vertex that
 * is near the ground what octo_point0…2 say. */

/* y = Σ_k w_k φ_k of a vertex or of a sphere's centre, and its place. */
static inline void octo_shaped(const real *weights, const double *shapes, real *y) {
  for (int j = 0; j < 3; ++j) y[j] = ZERO;
  for (int k = 0; k < NSHAPE; ++k)
    for (int j = 0; j < 3; ++j) y[j] += weights[k] * shapes[3 * k + j];
}
static inline void octo_placed(const real *x, const real *kin, const real *y, real *place) {
  for (int i = 0; i < 3; ++i) place[i] = x[i] + ROW(kin, i, y);
}

/* In which lanes something of an entry may be in reach; a NaN is. y and place: of its centre. */
static inline octo_mask octo_near(const octo_input *in, const octo_work *s, int e, real *y, real *place) {
  const double *entry = octo_entry + (size_t)ENTRY * e;
  octo_shaped(s->weights[0], entry, y);
  octo_placed(in->x[0], in->kin[0], y, place);
#ifdef WORLD
  octo_mask near = {0};
  real radius = ZERO + entry[FLAT];
  for (int k = 0; octo_member[e] < 0 && k < NMODE; ++k) radius += ABS(in->x[0][6 + k]) * entry[FLAT + 1 + k];
  for (int k = 0; k < LOOKS; ++k) {
    const double at[3] = {OF_LANE(place[0], k), OF_LANE(place[1], k), OF_LANE(place[2], k)};
    const double beyond = s->reach + s->world[OCTO_WORLD_STEEPEST] * OF_LANE(radius, k);
    double phi;
    octo_world_within(s->world, at, beyond, 0, &phi);
    if (!(phi >= beyond)) SET_LANE(near, k);
  }
  return near;
#else
  const double none[1] = {0.0};
  real gap, *res[1] = {&gap};
  const ARGUMENT *arg[3] = {place, none, in->p};
  STAGE(octo_gap, arg, res);
  if (octo_member[e] >= 0) return NOT(gap <= 0.0);
  real radius = ZERO + entry[FLAT];
  for (int k = 0; k < NMODE; ++k) radius += ABS(in->x[0][6 + k]) * entry[FLAT + 1 + k];
  return NOT(gap + octo_steepest[0] * radius <= 0.0);
#endif
}

#ifdef WORLD
/* φ and its derivatives at a vertex where it is near, elsewhere something that is out of reach. */
static inline void octo_vertex_look(const octo_input *in, const octo_work *s, octo_mask near, const real *place, real *jet) {
  for (int k = 0; k < LOOKS; ++k) {
    const double at[3] = {OF_LANE(place[0], k), OF_LANE(place[1], k), OF_LANE(place[2], k)};
    double own[JET] = {s->reach + 1.0, 0.0, 0.0, 1.0};
    if (OF_LANE(near, k)) octo_world_within(s->world, at, s->reach, in->order + 1, own);
    for (int d = 0; d < octo_world_size(in->order + 1); ++d) OF_LANE(jet[d], k) = own[d];
  }
}
#endif

/* ∂P/∂x (3, NX) of a vertex by R and its slopes, or of R_λ. */
static inline void octo_slopes(const real *turns, const real *y, const double *shapes, real (*J)[NX]) {
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) J[i][j] = ZERO + (i == j ? 1.0 : 0.0);
    for (int a = 0; a < 3; ++a) J[i][3 + a] = ROW(SLOPE(turns, a), i, y);
    for (int k = 0; k < NMODE; ++k) J[i][6 + k] = ROW(turns, i, shapes + 3 * (1 + k));
  }
}

/* A (3, 3), rows ``wide`` apart, times sign·J. */
static inline void octo_times(const real *A, int wide, double sign, const real (*J)[NX], real (*out)[NX]) {
  for (int i = 0; i < 3; ++i) {
    const real a = sign * A[wide * i], b = sign * A[wide * i + 1], c = sign * A[wide * i + 2];
    for (int j = 0; j < NX; ++j) out[i][j] = a * J[0][j] + b * J[1][j] + c * J[2][j];
  }
}

/* out += leftᵀ right, ``count`` rows each, which is constant where this is called; columns from the diagonal on (or one
 * before), or all. */
INTO void octo_add_product_of(int count, const real (*left)[NX], const real (*right)[NX], int half, real *__restrict__ out, int stride) {
  int i = 0;
  for (; i + 1 < NX; i += 2) { /* two rows share what they read */
    real one[6], two[6];
    for (int c = 0; c < count; ++c) one[c] = left[c][i], two[c] = left[c][i + 1];
    for (int j = half ? i : 0; j < NX; ++j) {
      real a = out[i * stride + j], b = out[(i + 1) * stride + j];
      for (int c = 0; c < count; ++c) a += one[c] * right[c][j], b += two[c] * right[c][j];
      out[i * stride + j] = a;
      out[(i + 1) * stride + j] = b;
    }
  }
  for (int j = half ? i : 0; i < NX && j < NX; ++j)
    for (int c = 0; c < count; ++c) out[i * stride + j] += left[c][i] * right[c][j];
}

/* δ = J λ and −∂δ/∂x_next. */
static inline void octo_displaced(const octo_input *in, octo_work *s, const real *y, const double *shapes) {
  const real *kin = in->kin[0];
  real bent[3];
  octo_shaped(s->modal, shapes, bent);
  octo_slopes(s->along, y, shapes, s->left + 3);
  for (int i = 0; i < 3; ++i) {
    s->delta[i] = in->lam[i] + ROW(s->along, i, y) + ROW(kin, i, bent);
    for (int a = 0; a < 3; ++a) s->left[3 + i][3 + a] += ROW(SLOPE(kin, a), i, bent);
    for (int j = 0; j < NX; ++j) s->left[3 + i][j] = j < 3 ? ZERO : -s->left[3 + i][j];
  }
}

static inline void octo_add_outer(const real *force, const double *shapes, real (*F)[9]) { /* F −= force φᵀ */
  for (int k = 0; k < NSHAPE; ++k)
    for (int e = 0; e < 9; ++e) F[k][e] -= force[e / 3] * shapes[3 * k + e % 3];
}

/* What a contact adds to H beside the forces' and the pulls' share; h (6, 6). */
APART void octo_vertex_curvature(octo_work *s, const real *slopes, const real *h, real *hess) {
  for (int node = 0; node < 2; ++node) {
    real pull[3];
    for (int j = 0; j < 3; ++j) {
      pull[j] = ZERO;
      for (int i = 0; i < 3; ++i) pull[j] += slopes[9 * node + 3 * i + j] * s->delta[i];
    }
    octo_add_outer(pull, octo_entry + (size_t)s->entry * ENTRY, s->pull[node]);
  }
  /* ∂²(−δ·f): left is J and −∂δ, right h_cc J − f_cᵀ∂δ and f_c J, then h_cU J' and f_U J' */
  octo_times(h, 6, 1.0, s->left, s->right);
  octo_times(slopes, 3, 1.0, s->left, s->right + 3);
  for (int i = 0; i < 3; ++i)
    for (int j = 3; j < NX; ++j)
      s->right[i][j] += slopes[i] * s->left[3][j] + slopes[3 + i] * s->left[4][j] + slopes[6 + i] * s->left[5][j];
  octo_add_product_of(6, s->left, s->right, 1, hess, NX);
  octo_times(h + 3, 6, 1.0, s->before, s->right);
  octo_times(slopes + 9, 3, 1.0, s->before, s->right + 3);
  octo_add_product_of(6, s->left, s->right, 0, hess + NX * NX, NX);
  octo_times(h + 21, 6, 1.0, s->before, s->right);
  octo_add_product_of(3, s->before, s->right, 1, hess + 3 * NX * NX, NX);
}

/* One vertex that is near, in the lanes of ``active``; y and place at the next node. */
APART void octo_vertex(const octo_input *in, octo_work *s, octo_mask active, const real *y, const real *place, real *jac, real *hess) {
  const double *shapes = octo_entry + (size_t)s->entry * ENTRY;
  real before[3], y_now[3], force[3], slopes[18], h[36], *res[4] = {force, slopes, slopes + 9, h};
  octo_shaped(s->weights[1], shapes, y_now);
  octo_placed(in->x[1], in->kin[1], y_now, before);
  if (in->order == 2) octo_displaced(in, s, y, shapes);
#ifdef WORLD
  real jet[JET];
  for (int d = 0; d < JET; ++d) jet[d] = ZERO;
  octo_vertex_look(in, s, active, place, jet);
  const ARGUMENT *arg[5] = {place, before, in->p, s->delta, jet};
#else
  const ARGUMENT *arg[4] = {place, before, in->p, s->delta};
#endif
  if (in->order == 0) STAGE(octo_point0, arg, res);
  else if (in->order == 1) STAGE(octo_point1, arg, res);
  else STAGE(octo_point2, arg, res);
  for (int i = 0; i < 3; ++i) {
    force[i] = KEPT(active, force[i]);
    s->f[i] -= force[i];
  }
  octo_add_outer(force, shapes, s->F);
  if (in->order == 0) return;
  for (int e = 0; e < 18; ++e) slopes[e] = KEPT(active, slopes[e]);
  octo_slopes(in->kin[0], y, shapes, s->left);
  octo_slopes(in->kin[1], y_now, shapes, s->before);
  octo_times(slopes, 3, -1.0, s->left, s->right);
  octo_add_product_of(3, s->left, s->right, 0, jac, 3 * NX);
  octo_times(slopes + 9, 3, -1.0, s->before, s->right);
  octo_add_product_of(3, s->left, s->right, 0, jac + NX, 3 * NX);
  if (in->order == 1) return;
  for (int e = 0; e < 36; ++e) h[e] = KEPT(active, h[e]);
  octo_vertex_curvature(s, slopes, h, hess);
}

APART void octo_contacts(const octo_input *in, octo_work *s, real *jac, real *hess) {
  for (int e = 0; e < NENTRY;) {
    real y[3], place[3];
    const octo_mask near = octo_near(in, s, e, y, place);
    if (!ANY(near)) { e = octo_skip[e]; continue; }
    s->entry = e;
    if (octo_member[e] >= 0) octo_vertex(in, s, near, y, place, jac, hess);
    ++e;
  }
}

/* FD (NX), and by order jac (NX, 3 NX) and hess (CURVATURE, NX, NX), of which all is written. */
APART void octo_all(const octo_input *in, octo_work *s, real *fd, real *jac, real *hess) {
  for (int e = 0; in->order >= 1 && e < 3 * NX * NX; ++e) jac[e] = ZERO;
  for (int e = 0; in->order == 2 && e < CURVATURE * NX * NX; ++e) hess[e] = ZERO;
  for (int node = 0; node < 3; ++node) octo_weights(in->x[node], s->weights[node]);
#ifdef WORLD
  const double *numbers[1] = {in->p};
  double *reach[1] = {&s->reach};
  octo_reach(numbers, reach);
  s->world = (const double *)(size_t)in->p[WORLD];
#endif
  octo_forces(in, s);
  if (in->order == 2) octo_follow(in, s);
  octo_contacts(in, s, jac, hess);
  octo_write_rows(in, s, fd);
  if (in->order >= 1) octo_write_jacobian(in, s, jac);
  if (in->order == 2) octo_write_curvature(in, s, hess);
  octo_add_elastic(in, s, fd, jac, hess);
}
