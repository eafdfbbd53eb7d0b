/* CasADi's C interface to adapter.c, and the watch that stops IPOPT by octo's own rule. */

static void octo_copy(const double *from, int count, double *to) { if (to) memcpy(to, from, count * sizeof(double)); }

int nlp(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point(arg[0], arg[1], 0)) return 1;
  octo_copy(&at.f, 1, res[0]);
  octo_copy(T.g, T.rows, res[1]);
  return 0;
}
int nlp_f(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point(arg[0], arg[1], 0)) return 1;
  octo_copy(&at.f, 1, res[0]);
  return 0;
}
int nlp_g(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point(arg[0], arg[1], 0)) return 1;
  octo_copy(T.g, T.rows, res[0]);
  return 0;
}
int nlp_grad_f(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point(arg[0], arg[1], 1)) return 1;
#ifndef STAGEWISE
  octo_copy(&at.f, 1, res[0]);
  ++res;
#endif
  octo_copy(T.gradient, T.variables, res[0]);
  return 0;
}
int nlp_jac_g(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point(arg[0], arg[1], 1)) return 1;
#ifdef STAGEWISE
  octo_note(at.f, octo_violation(T.g));
#endif
  octo_copy(T.g, T.rows, res[0]);
  if (!res[1]) return 0;
  int count = (int)T.sparsity[JACOBIAN][2 + T.variables];
  for (int k = 0; k < count; ++k)
    res[1][k] = octo_jacobian(k);
  return 0;
}
int nlp_hess_l(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  double sigma = arg[2] ? arg[2][0] : 0.0;
#ifdef STAGEWISE
  if (res[0] && octo_point_lagrangian(arg[0], arg[1], sigma, arg[3])) return 1;
  octo_copy(T.lagrangian, T.variables, res[0]);
  ++res;
#endif
  if (!res[0]) return 0;
  if (octo_point_hessian(arg[0], arg[1], sigma, arg[3])) return 1;
  int count = (int)T.sparsity[HESSIAN][2 + T.variables];
  for (int k = 0; k < count; ++k) res[0][k] = octo_hessian(k);
  return 0;
}
int nlp_grad(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  if (octo_point_lagrangian(arg[0], arg[1], arg[2] ? arg[2][0] : 0.0, arg[3])) return 1;
  octo_copy(&at.f, 1, res[0]);
  octo_copy(T.g, T.rows, res[1]);
  octo_copy(T.lagrangian, T.variables, res[2]);
  return 0;
}

/* ---- octo's rule "acceptable": g within tolerance of its bounds, complementarity, and E has settled ---- */

#define WINDOW 64
static struct { double tolerance, change, complementarity, energies[WINDOW]; int plateau, count, settled; } watch;

void octo_watch_set(double tolerance, double change, double complementarity, int plateau) {
  watch.tolerance = tolerance; watch.change = change; watch.complementarity = complementarity; watch.count = watch.settled = 0;
  watch.plateau = plateau < WINDOW ? plateau : WINDOW - 1;
  octo_logged = 0;
  octo_began = octo_now();
}
int octo_watch_settled(void) { return watch.settled; }
int octo_log_size(void) { return octo_logged; }
const double *octo_log_rows(void) { return octo_log[0]; }

int octo_watch(const double **arg, double **res, octo_int *iw, double *w, int mem) {
  double f = arg[1] ? arg[1][0] : 0.0, violation = arg[2] ? octo_violation(arg[2]) : 0.0, low = f, high = f;
  octo_note(f, violation);
  watch.energies[watch.count++ % WINDOW] = f;
  for (int k = 1; k <= watch.plateau && k < watch.count; ++k) {
    double e = watch.energies[(watch.count - 1 - k) % WINDOW];
    low = e < low ? e : low; high = e > high ? e : high;
  }
  if (watch.count > watch.plateau && violation <= watch.tolerance && high - low <= watch.change * fabs(f))
    watch.settled = !arg[2] || !arg[4] || octo_gap(arg[2], arg[4]) <= watch.complementarity;
  if (res[0]) res[0][0] = watch.settled || octo_stopped;
  return 0;
}

/* ---- names and shapes ---- */

#define UNPACK(...) __VA_ARGS__
#define COUNT(array) ((octo_int)(sizeof(array) / sizeof(array[0])))
#define DESCRIBE(F, in, in_kind, out, out_kind) \
  static const char *const F##_in[] = {UNPACK in}; static const int F##_in_kind[] = {UNPACK in_kind}; \
  static const char *const F##_out[] = {UNPACK out}; static const int F##_out_kind[] = {UNPACK out_kind}; \
  octo_int F##_n_in(void) { return COUNT(F##_in); } \
  octo_int F##_n_out(void) { return COUNT(F##_out); } \
  const char *F##_name_in(octo_int i) { return F##_in[i]; } \
  const char *F##_name_out(octo_int i) { return F##_out[i]; } \
  const octo_int *F##_sparsity_in(octo_int i) { return T.sparsity[F##_in_kind[i]]; } \
  const octo_int *F##_sparsity_out(octo_int i) { return T.sparsity[F##_out_kind[i]]; } \
  int F##_work(octo_int *sz_arg, octo_int *sz_res, octo_int *sz_iw, octo_int *sz_w) { \
    if (sz_arg) *sz_arg = COUNT(F##_in); \
    if (sz_res) *sz_res = COUNT(F##_out); \
    if (sz_iw) *sz_iw = 0; \
    if (sz_w) *sz_w = 0; \
    return 0; \
  }

DESCRIBE(nlp, ("x", "p"), (POINT, NUMBERS), ("f", "g"), (SCALAR, ROWS))
DESCRIBE(nlp_f, ("x", "p"), (POINT, NUMBERS), ("f"), (SCALAR))
DESCRIBE(nlp_g, ("x", "p"), (POINT, NUMBERS), ("g"), (ROWS))
DESCRIBE(nlp_jac_g, ("x", "p"), (POINT, NUMBERS), ("g", "jac_g_x"), (ROWS, JACOBIAN))
DESCRIBE(nlp_grad, ("x", "p", "lam_f", "lam_g"), (POINT, NUMBERS, SCALAR, ROWS),
         ("f", "g", "grad_gamma_x", "grad_gamma_p"), (SCALAR, ROWS, POINT, NOTHING))
#ifdef STAGEWISE
DESCRIBE(nlp_grad_f, ("x", "p"), (POINT, NUMBERS), ("grad_f_x"), (POINT))
DESCRIBE(nlp_hess_l, ("x", "p", "lam_f", "lam_g"), (POINT, NUMBERS, SCALAR, ROWS),
         ("grad_gamma_x", "hess_gamma_x_x"), (POINT, HESSIAN))
#else
DESCRIBE(nlp_grad_f, ("x", "p"), (POINT, NUMBERS), ("f", "grad_f_x"), (SCALAR, POINT))
DESCRIBE(nlp_hess_l, ("x", "p", "lam_f", "lam_g"), (POINT, NUMBERS, SCALAR, ROWS), ("triu_hess_gamma_x_x"), (HESSIAN))
#endif
DESCRIBE(octo_watch, ("x", "f", "g", "lam_x", "lam_g", "lam_p"), (POINT, SCALAR, ROWS, POINT, ROWS, NUMBERS), ("stop"), (SCALAR))
