/* User-written dynamics with a time step in every lane (lanes.c): every number of jac and hess has a slot, behind the zero. */

#define JAC_SLOTS (1 + 3 * NX * NX)
#define HESS_SLOTS (1 + CURVATURE * NX * NX)
#define NCOUPLED 0

typedef struct { char none; } octo_work;
static inline void octo_work_begin(octo_work *s) {}
typedef struct { const real *x[3], *kin[3]; const double *p; const real *lam; int order; } octo_input;

static void octo_kin(const real *x, real *kin) {}
typedef struct { char none; } octo_last_looks;
#define octo_last_begin(last)
#define octo_look(p, order, kin, last)

static int octo_step(const octo_input *in, real *fd, real *jac, real *hess, octo_work *s) {
  const void *arg[5] = {in->x[0], in->x[1], in->x[2], in->p, in->lam};
  real *res[3] = {fd, jac + 1, hess + 1};
  if (in->order == 0) STAGE(octo_fd0, arg, res);
  else if (in->order == 1) STAGE(octo_fd1, arg, res);
  else STAGE(octo_fd2, arg, res);
  return 0;
}
