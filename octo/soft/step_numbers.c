/* A soft body, one time step of numbers, after touch.c: the interface of phases.c. A node's kinematics are empty: a step makes
 * those of its three nodes, for CUDA keeps them in the step's work area. */

static void octo_kin(const double *x, double *kin) {}

typedef struct { octo_work own; double frame[3][FRAME]; } octo_step_work;

static void octo_step(const double *x_next, const double *x, const double *x_prev, const double *kin_next, const double *kin,
                      const double *kin_prev, const double *p, const double *lam, int order, double *fd, double *jac, double *hess, double *work) {
#ifdef __CUDACC_RTC__
  if (threadIdx.x > 0) return; /* one thread a step */
#endif
  octo_step_work *s = (octo_step_work *)work;
  const octo_input in = {{x_next, x, x_prev}, {s->frame[0], s->frame[1], s->frame[2]}, p, lam, order};
  for (int node = 0; node < 3; ++node) octo_frame(in.x[node], s->frame[node]);
  octo_all(&in, &s->own, fd, jac, hess);
}
