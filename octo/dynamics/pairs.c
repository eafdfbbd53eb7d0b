/* Self-collision pairs, after tree.c: a pair couples two branches and does not compose down the tree.
 *
 * Its potential Φ(ρ), ρ = ½|d|², d = c_a − c_b, does not change when a common ancestor moves, so only the loop counts:
 * the degrees of freedom that move one of the two spheres alone. With D_j = ∂d/∂q_j and, on one branch and i ⪯ j,
 * ∂D_j/∂q_i = ∂D_i/∂q_j = ω_i × D_j (zero across branches), g_j = d·D_j and h_ij = D_i·D_j + d·(ω_i × D_j):
 *   FD_j += Φ' g_j,   J_ij += Φ'' g_i g_j + Φ' h_ij,
 *   H00_ij += the derivative of J_ij along lam, written with a dot below (the pair is conservative). */

typedef struct { real phi[3], direction[3]; } octo_pair_state; /* Φ', Φ'', Φ'''; c_a − c_b, m */

typedef struct {
  octo_pair_state pair[SOME(NPAIR)];
  real loop_motion[SOME(NLOOP)][3], loop_slope[SOME(NLOOP)];                           /* ∂d/∂q_a, ∂ρ/∂q_a of the pair at hand */
  real loop_change[SOME(NLOOP)][3], loop_turn[SOME(NLOOP)][3], loop_bend[SOME(NLOOP)]; /* along lam */
} octo_loops;

/* An entry of a loop, the same from both sides, added to J of the next node and to H00. */
static inline void octo_couple_jacobian(int i, int j, real value, real *jac);
static inline void octo_couple_curvature(int i, int j, real value, real *hess);

static void octo_pairs(const octo_input *in, octo_loops *s) {
#if NPAIR > 0
  EACH_FROM(96, k, NPAIR) {
    const double *spheres = octo_pair_spheres + 7 * k;
    octo_pair_state *state = &s->pair[k];
    real first[3], second[3], rho;
    octo_place(in->kin[0] + 12 * octo_pair_body[2 * k], spheres, first);
    octo_place(in->kin[0] + 12 * octo_pair_body[2 * k + 1], spheres + 3, second);
    for (int r = 0; r < 3; ++r) state->direction[r] = first[r] - second[r];
    rho = 0.5 * octo_dot(state->direction, state->direction);
    const ARGUMENT *arg[3] = {&rho, spheres + 6, in->p};
    real *res[3] = {state->phi, state->phi + 1, state->phi + 2};
    STAGE(octo_pair, arg, res);
  }
#endif
}

#if NPAIR > 0

/* Entry a of a pair's loop: its degree of freedom, and whether it belongs to the first sphere's branch. */
typedef struct { const int *dof; int count, split; } octo_loop;

static inline octo_loop octo_loop_of(int k) {
  octo_loop loop = {octo_loop_dof + octo_loop_start[k], octo_loop_start[k + 1] - octo_loop_start[k], octo_loop_split[k]};
  return loop;
}

/* D_a and g_a. */
static void octo_loop_slopes(const octo_input *in, octo_loops *s, int k, octo_loop loop) {
  const double *spheres = octo_pair_spheres + 7 * k;
  EACH(a, loop.count) {
    int side = a < loop.split ? 0 : 1;
    const real *xi = in->kin[0] + 12 * NB + 6 * loop.dof[a];
    real center[3], *D = s->loop_motion[a];
    octo_place(in->kin[0] + 12 * octo_pair_body[2 * k + side], spheres + 3 * side, center);
    octo_cross(xi, center, D);
    for (int r = 0; r < 3; ++r) D[r] = (side == 0 ? 1.0 : -1.0) * (D[r] + xi[3 + r]);
    s->loop_slope[a] = octo_dot(s->pair[k].direction, D);
  }
}

/* Along lam: the changes of D_a, of ω_a and of g_a. */
static void octo_loop_changes(const octo_input *in, octo_loops *s, int k, octo_loop loop) {
  EACH(a, loop.count) {
    int begin = a < loop.split ? 0 : loop.split, end = a < loop.split ? loop.split : loop.count;
    const real *omega = in->kin[0] + 12 * NB + 6 * loop.dof[a];
    real above[3] = {0, 0, 0}, below[3] = {0, 0, 0}, all[3] = {0, 0, 0}, part[3];
    for (int b = 0; b < loop.count; ++b) {
      const real *xi = in->kin[0] + 12 * NB + 6 * loop.dof[b], *D = s->loop_motion[b];
      real lam = in->lam[loop.dof[b]];
      for (int r = 0; r < 3; ++r) {
        all[r] += lam * D[r];
        if (b >= begin && b <= a) above[r] += lam * xi[r];
        if (b > a && b < end) below[r] += lam * D[r];
      }
    }
    octo_cross(above, omega, s->loop_turn[a]);
    octo_cross(above, s->loop_motion[a], s->loop_change[a]);
    octo_cross(omega, below, part);
    for (int r = 0; r < 3; ++r) s->loop_change[a][r] += part[r];
    s->loop_bend[a] = octo_dot(s->loop_motion[a], all) + octo_dot(s->pair[k].direction, s->loop_change[a]);
  }
}

static void octo_loop_write(const octo_input *in, const octo_loops *s, int k, octo_loop loop, real *jac, real *hess) {
  const real *d = s->pair[k].direction, *phi = s->pair[k].phi;
  real slope = ZERO, motion[3] = {0, 0, 0}; /* of ρ and of d along lam */
  if (in->order == 2)
    for (int b = 0; b < loop.count; ++b) {
      real lam = in->lam[loop.dof[b]];
      slope += lam * s->loop_slope[b];
      for (int r = 0; r < 3; ++r) motion[r] += lam * s->loop_motion[b][r];
    }
  GRID(a, loop.count, b, loop.count) {
    if (b < a) continue;
    int i = loop.dof[a], j = loop.dof[b], same = (a < loop.split) == (b < loop.split);
    const real *omega = in->kin[0] + 12 * NB + 6 * i, *D = s->loop_motion[b];
    real g = s->loop_slope[a] * s->loop_slope[b], h = octo_dot(s->loop_motion[a], s->loop_motion[b]), bend[3];
    octo_cross(omega, D, bend);
    if (same) h += octo_dot(d, bend);
    real stiffness = phi[1] * g + phi[0] * h;
    octo_couple_jacobian(i, j, stiffness, jac);
    if (in->order < 2) continue;
    real change = octo_dot(s->loop_change[a], s->loop_motion[b]) + octo_dot(s->loop_motion[a], s->loop_change[b]);
    if (same) {
      change += octo_dot(motion, bend);
      octo_cross(s->loop_turn[a], D, bend);
      change += octo_dot(d, bend);
      octo_cross(omega, s->loop_change[b], bend);
      change += octo_dot(d, bend);
    }
    real mixed = s->loop_bend[a] * s->loop_slope[b] + s->loop_slope[a] * s->loop_bend[b];
    real curvature = phi[2] * slope * g + phi[1] * (mixed + slope * h) + phi[0] * change;
    octo_couple_curvature(i, j, curvature, hess);
  }
}

#endif

static void octo_write_pairs(const octo_input *in, octo_loops *s, real *fd, real *jac, real *hess) {
#if NPAIR > 0
  for (int k = 0; k < NPAIR; ++k) {
    if (!ANY(s->pair[k].phi[0] != 0.0)) continue; /* apart */
    octo_loop loop = octo_loop_of(k);
    BARRIER;
    octo_loop_slopes(in, s, k, loop);
    BARRIER;
    EACH(a, loop.count) fd[loop.dof[a]] += s->pair[k].phi[0] * s->loop_slope[a];
    if (in->order < 1) continue;
    if (in->order == 2) octo_loop_changes(in, s, k, loop);
    BARRIER;
    octo_loop_write(in, s, k, loop, jac, hess);
  }
#endif
}
