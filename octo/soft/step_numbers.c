/* A soft body, one time step of numbers, after touch.c: the interface of phases.c. */

static void octo_step(const double *x_next, const double *x, const double *x_prev, const double *kin_next, const double *kin,
                      const double *kin_prev, const double *p, const double *lam, int order, double *fd, double *jac, double *hess, double *work) {
#ifdef __CUDACC_RTC__
  if (threadIdx.x > 0) return; /* one thread a step */
#endif
  const octo_input in = {{x_next, x, x_prev}, {kin_next, kin, kin_prev}, p, lam, order};
  octo_all(&in, (octo_work *)work, fd, jac, hess);
}
