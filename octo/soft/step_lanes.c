/* A soft body with a time step in every lane, after touch.c: every number of jac and hess has a slot, behind the zero. */

#define JAC_SLOTS (1 + 3 * NX * NX)
#define HESS_SLOTS (1 + CURVATURE * NX * NX)
#define NCOUPLED 0
#define octo_kin octo_frame

static inline void octo_work_begin(octo_work *s) {}
typedef struct { char none; } octo_last_looks;
#define octo_last_begin(last)

static int octo_step(const octo_input *in, real *fd, real *jac, real *hess, octo_work *s) {
  octo_all(in, s, fd, jac + 1, hess + 1);
  return 0;
}
