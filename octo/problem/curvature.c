/* Exact second derivatives of terms over the state (curvature.py): hess += [I; U]ᵀ S [I; U], U the slopes of the torques. After
 * the tables of the costs and scatter.c, before assemble.c, and only where NS, the numbers of S's upper triangle, is not 0. */

/* rows i of hess (W3, LD) += one_i other + other_i one, from the node's diagonal block on. */
static void octo_bend_pair(const double *one, const double *other, double *hess) {
  for (int i = 0; i < W3; ++i) {
    double f = one[i], g = other[i], *line = hess + i * LD;
    if (f == 0.0 && g == 0.0) continue;
    for (int j = i / NX * NX; j < W3; ++j) line[j] += f * other[j] + g * one[j];
  }
}

/* Nodes' blocks of hess (W3, LD) from the diagonal ones on; second (NS), jac (NX, W3) of FD. */
static void octo_bend(const double *second, const double *jac, double *hess) {
  double pulled[NU + 1][W3]; /* of each torque: what stands beside its slopes */
  char found[NU + 1] = {0};
  for (int z = 0; z < NS; ++z) {
    int a = octo_bend_row[z], b = octo_bend_column[z], torque = b - W3;
    double value = second[z];
    if (torque < 0) {
      hess[a * LD + b] += value;
      if (a != b && a / NX == b / NX) hess[b * LD + a] += value;
      continue;
    }
    if (!found[torque]) memset(pulled[torque], 0, sizeof pulled[torque]);
    found[torque] = 1;
    if (a < W3) {
      pulled[torque][a] += value;
      continue;
    }
    const double *slopes = jac + octo_actuated[a - W3] * W3;
    if (a == b) value *= 0.5; /* the pair has it twice */
    for (int j = 0; j < W3; ++j) pulled[torque][j] += value * slopes[j];
  }
  for (int torque = 0; torque < NU; ++torque)
    if (found[torque]) octo_bend_pair(jac + octo_actuated[torque] * W3, pulled[torque], hess);
}
