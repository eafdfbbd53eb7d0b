/* The low level of a controller: a plan that is read at any time, and springs and dampers to where its joints are then.
 * A plan is one block of numbers that nobody writes any more: the time of x_0, then rows of x from x_{-1} on (rows, nx),
 * then rows of torques from u_0 on (rows, nu). */
#include <math.h>

typedef struct {
    int rows, steps, nx, nu;
    double dt;
    const int *joint, *q_at; /* (nu) places of the actuated coordinates in x and v, and in q */
    const double *kp, *kd, *limit;
} low_level;

/* u (nu) at time t, where q and v are measured. A joint whose measurement is not finite follows the plan's torque. */
void octo_low_level(const low_level *r, const double *plan, double t, const double *q, const double *v, double *u) {
    double s = isfinite(t) ? fmin(fmax((t - plan[0]) / r->dt, 0.0), r->steps + 1.999) : 0.0;
    int i = (int)s;
    double f = s - i;
    const double *here = plan + 1 + (i + 1) * r->nx, *next = here + r->nx;
    const double *torque = plan + 1 + r->rows * r->nx + i * r->nu;
    for (int k = 0; k < r->nu; k++) {
        int j = r->joint[k];
        double move = next[j] - here[j];
        double planned = torque[k] + f * (torque[r->nu + k] - torque[k]);
        double spring = r->kp[k] * (here[j] + f * move - q[r->q_at[k]]);
        double sent = planned + spring + r->kd[k] * (move / r->dt - v[j]);
        if (!isfinite(sent)) sent = planned;
        u[k] = fmin(fmax(sent, -r->limit[k]), r->limit[k]);
    }
}
