/* User-written dynamics: the interface of phases.c over CasADi's functions octo_fd0 (FD), octo_fd1 (and its Jacobian) and
 * octo_fd2 (and the curvature of lamᵀFD: H00, H01, H02, H11, H22, H12). There are no bodies: a node's kinematics is empty. */

static void octo_kin(const double *x, double *kin) {}
#define octo_look(p, order, kin, last)

static void octo_step(const double *x_next, const double *x, const double *x_prev, const double *kin_next, const double *kin,
                      const double *kin_prev, const double *p, const double *lam, int order, double *fd, double *jac, double *hess, double *work) {
#ifdef __CUDACC_RTC__
  if (threadIdx.x > 0) return; /* one thread a step: CasADi's text is serial */
#endif
  const double *arg[5] = {x_next, x, x_prev, p, lam};
  double *res[3] = {fd, jac, hess};
  if (order == 0) octo_fd0(arg, res, 0, work, 0);
  else if (order == 1) octo_fd1(arg, res, 0, work, 0);
  else octo_fd2(arg, res, 0, work, 0);
}
