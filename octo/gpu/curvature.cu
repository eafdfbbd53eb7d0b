/* Exact second derivatives of terms over the state: the mathematics of problem/curvature.c. After their generated text
 * (curvature.py) and common.cuh. Of S's upper triangle the first STRAIGHT numbers of NS stand beside coordinates, the others
 * beside torques, those of torque octo_bend_torque[t] from octo_bend_first[t] on. */

#define W3 (3 * NX)

/* S (NS) of each step, a thread for a step and a piece; grid (steps of as many threads, pieces, batch). */
extern "C" __global__ void __launch_bounds__(WARP, 8)
octo_second(int steps, const int *curved, const double *nodes, const double *p, const double *q, const double *fd, double *second) {
  size_t member = blockIdx.z;
  if (curved && !curved[member]) return;
  for (int step = blockIdx.x * LANES + LANE; step < steps; step += gridDim.x * LANES) {
    size_t item = member * steps + step;
    const double *x = nodes + (item + 2 * member) * NX;
    double u[NU + 1];
    for (int j = 0; j < NU; ++j) u[j] = fd[item * NX + octo_bend_actuated[j]];
    const double *arg[7] = {x + 2 * NX, x + NX, x, u, p + member * NP, q + item * NQ};
#ifdef CALLS
    double v[NV];
    arg[6] = v;
    for (int k = 0; k < CALLS; ++k) octo_call(k, arg, v, 2); /* each piece's own */
#endif
    double *res[1] = {second + item * NS + octo_bend_at[blockIdx.y]};
    octo_bend_piece(blockIdx.y, arg, res);
  }
}

/* hess (6, NX, NX) += [I; U]ᵀ S [I; U], jac (NX, W3) of FD; grid (steps, batch); shared: TORQUES W3 doubles. */
extern "C" __global__ void __launch_bounds__(SMALL, 4)
octo_bend(int steps, const int *curved, const double *second, const double *jac, double *hess) {
  static const int newer[] = {0, 0, 0, 1, 2, 1}, older[] = {0, 1, 2, 1, 2, 2};
  SHARED(pulled); /* of each torque: what stands beside its slopes */
  if (curved && !curved[blockIdx.y]) return;
  size_t item = (size_t)blockIdx.y * steps + blockIdx.x;
  second += item * NS; jac += item * NX * W3; hess += item * 6 * NX * NX;
  EACH(z, STRAIGHT) {
    int a = octo_bend_row[z], b = octo_bend_column[z], i = a % NX, j = b % NX;
    int one = a / NX, other = b / NX, block = one == 0 ? other : one == 1 ? (other == 1 ? 3 : 5) : 4;
    hess[block * NX * NX + i * NX + j] += second[z];
    if (one == other && i != j) hess[block * NX * NX + j * NX + i] += second[z];
  }
#if TORQUES > 0
  EACH(e, TORQUES * W3) {
    int torque = e / W3, j = e % W3;
    double sum = 0.0;
    for (int z = octo_bend_first[torque]; z < octo_bend_first[torque + 1]; ++z) {
      int a = octo_bend_row[z];
      if (a < W3) sum += a == j ? second[z] : 0.0;
      else sum += (a == octo_bend_column[z] ? 0.5 : 1.0) * second[z] * jac[octo_bend_actuated[a - W3] * W3 + j];
    }
    pulled[e] = sum;
  }
  BARRIER;
  EACH(e, 6 * NX * NX) {
    int block = e / (NX * NX), i = newer[block] * NX + e / NX % NX, j = older[block] * NX + e % NX;
    double sum = 0.0;
    for (int torque = 0; torque < TORQUES; ++torque) {
      const double *slopes = jac + octo_bend_actuated[octo_bend_torque[torque]] * W3, *own = pulled + torque * W3;
      sum += slopes[i] * own[j] + own[i] * slopes[j];
    }
    hess[e] += sum;
  }
#endif
}
