/* What a world says of the contacts, after the text of the dynamics and common.cuh. */

/* The jets of each contact of each node, in kin; over count = batch nodes NG. */
extern "C" __global__ void __launch_bounds__(FLAT, 4)
octo_looks(int count, int nodes, const double *p, double *kin) {
  for (int e = blockIdx.x * blockDim.x + threadIdx.x; e < count; e += gridDim.x * blockDim.x) {
    int node = e / NG;
    octo_look_at(p + (size_t)(node / nodes) * NP, e % NG, 3, kin + (size_t)node * KIN, 0);
  }
}
