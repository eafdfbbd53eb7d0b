/* Kernels over the nodes and the time steps of a batch, after the text of the dynamics (phases.c) and common.cuh.
 *
 * kin has one thread per node; a step has one block, its work area in dynamic shared memory (8·WORK bytes): grid (steps, batch). */

/* Doubles of a step's work area and of a node's kinematics, for whoever launches. */
extern "C" __global__ void octo_work_size(int *size) {
  if (threadIdx.x == 0) size[0] = WORK, size[1] = KIN;
}

extern "C" __global__ void octo_kin_of_nodes(int count, const double *nodes, double *kin) {
  for (int node = blockIdx.x * blockDim.x + threadIdx.x; node < count; node += gridDim.x * blockDim.x)
    octo_kin(nodes + (size_t)node * NX, kin + (size_t)node * KIN);
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

extern "C" __global__ void octo_value(int steps, const double *nodes, const double *kin, const double *p, double *fd) {
  octo_step_of_block<0>(steps, nodes, kin, p, 0, fd, 0, 0);
}

extern "C" __global__ void octo_jacobian(int steps, const double *nodes, const double *kin, const double *p, double *fd, double *jac) {
  octo_step_of_block<1>(steps, nodes, kin, p, 0, fd, jac, 0);
}

extern "C" __global__ void octo_curvature(int steps, const double *nodes, const double *kin, const double *p, const double *lam, double *fd,
                                          double *jac, double *hess) {
  octo_step_of_block<2>(steps, nodes, kin, p, lam, fd, jac, hess);
}
