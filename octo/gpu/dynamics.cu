/* Kernels over the nodes and the time steps of a batch, after the text of the dynamics (phases.c) and common.cuh.
 *
 * A node and a step have a block each, their work areas in dynamic shared memory: grids (steps + 2, batch) and (steps, batch). */

/* Doubles of a step's work area and of a node's kinematics, for whoever launches. */
extern "C" __global__ void octo_work_size(int *size) {
  if (threadIdx.x == 0) size[0] = WORK, size[1] = KIN;
}

/* kin (KIN) of each node, bodies of one level of the tree at a time; shared: 2 NX + KIN doubles. A world is looked up by a
 * kernel of its own. */
extern "C" __global__ void __launch_bounds__(WARP, 8)
octo_kin_of_nodes(const double *nodes, double *kin) {
#if KIN > 0
  SHARED(turn);
  double *own = turn + 2 * NX;
  size_t node = (size_t)blockIdx.y * gridDim.x + blockIdx.x;
  const double *x = nodes + node * NX;
  EACH(j, NX) octo_turn(j, x, turn + 2 * j);
  BARRIER;
  for (int level = 0; level < LEVELS; ++level) {
    EACH(b, NB)
      if (octo_body_level[b] == level) octo_pose(b, x, turn, own);
    BARRIER;
  }
  EACH(k, KIN) kin[node * KIN + k] = own[k];
#endif
}

template <int order>
static __device__ __forceinline__ void octo_step_of_block(int steps, const double *nodes, const double *kin, const double *p, const double *lam,
                                                          double *fd, double *jac, double *hess) {
  SHARED(octo_shared);
  size_t step = blockIdx.x, member = blockIdx.y, item = member * steps + step, node = member * (steps + 2) + step;
  const double *x = nodes + node * NX, *k = kin + node * KIN;
  octo_step(x + 2 * NX, x + NX, x, k + 2 * KIN, k + KIN, k, p + member * NP, order < 2 ? 0 : lam + item * NX, order, fd + item * NX,
            order < 1 ? 0 : jac + item * 3 * NX * NX, order < 2 ? 0 : hess + item * CURVATURE * NX * NX, octo_shared);
}

extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_value(int steps, const double *nodes, const double *kin, const double *p, double *fd) {
  octo_step_of_block<0>(steps, nodes, kin, p, 0, fd, 0, 0);
}

extern "C" __global__ void octo_jacobian(int steps, const double *nodes, const double *kin, const double *p, double *fd, double *jac) {
  octo_step_of_block<1>(steps, nodes, kin, p, 0, fd, jac, 0);
}

extern "C" __global__ void octo_curvature(int steps, const double *nodes, const double *kin, const double *p, const double *lam, double *fd,
                                          double *jac, double *hess) {
  octo_step_of_block<2>(steps, nodes, kin, p, lam, fd, jac, hess);
}
