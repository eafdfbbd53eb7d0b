/* All steps of a batch, appended to the text of the dynamics: threads take runs of neighbouring steps, so that each node's
 * poses and twists are evaluated once and shared by the three steps that use it. */

#include <stdlib.h>

typedef struct {
  int steps, order;
  const double *nodes, *p, *lam; /* (batch, steps+2, NX) (batch, NP) (batch, steps, NX) */
  double *fd, *jac, *hess;       /* (batch, steps, NX) (…, NX, 3NX) (…, CURVATURE, NX, NX) */
  long first, last;              /* of all batch·steps */
  int failed;
} octo_run_of_steps;

#ifndef STEPS
static void octo_run_steps(void *shared, int number) {
  octo_run_of_steps *run = (octo_run_of_steps *)shared + number;
  const size_t kin_size = KIN + 1;
  double *memory = malloc((3 * kin_size + WORK + 1) * sizeof(double)), *work = memory + 3 * kin_size;
  if (!memory) { run->failed = 1; return; }
  for (long item = run->first; item < run->last; ++item) {
    long member = item / run->steps, step = item % run->steps;
    const double *x_prev = run->nodes + (member * (run->steps + 2) + step) * NX, *x = x_prev + NX, *x_next = x + NX;
    double *kin[3]; /* previous, now, next in a ring */
    for (int k = 0; k < 3; ++k) kin[k] = memory + ((step + k) % 3) * kin_size;
    const double *p = run->p + member * NP;
    if (item == run->first || step == 0) {
      octo_kin(x_prev, kin[0]);
      octo_kin(x, kin[1]);
      octo_look(p, run->order + 1, kin[0], 0);
      octo_look(p, run->order + 1, kin[1], 0);
    }
    octo_kin(x_next, kin[2]);
    octo_look(p, run->order + 1, kin[2], 0);
    octo_step(x_next, x, x_prev, kin[2], kin[1], kin[0], p, run->order < 2 ? 0 : run->lam + item * NX, run->order,
              run->fd + item * NX, run->order < 1 ? 0 : run->jac + item * 3 * NX * NX, run->order < 2 ? 0 : run->hess + item * CURVATURE * NX * NX, work);
  }
  free(memory);
}
#else

static void octo_run_group(const octo_run_of_steps *run, long item, int count, const double *p, octo_lanes *s) {
  const double *lam[STEPS];
  double *fd[STEPS], *jac[STEPS], *hess[STEPS];
  for (int k = 0; k < STEPS; ++k) {
    size_t at = item + (k < count ? k : 0);
    lam[k] = run->order < 2 ? 0 : run->lam + at * NX;
    fd[k] = run->fd + at * NX;
    jac[k] = run->order < 1 ? 0 : run->jac + at * 3 * NX * NX;
    hess[k] = run->order < 2 ? 0 : run->hess + at * CURVATURE * NX * NX;
  }
  octo_input in = octo_lanes_turn(s, p, run->order);
  if (run->order == 2) octo_gather(lam, NX, s->lam);
  octo_lanes_run(s, &in);
  octo_spread(s->fd, NX, fd, count);
  if (run->order >= 1) octo_scatter(s->jac, octo_jac_slot, 3 * NX * NX, octo_jac_use, s->touching, 2, jac, count);
  if (run->order == 2) octo_scatter(s->hess, octo_hess_slot, CURVATURE * NX * NX, octo_hess_use, s->touching, 2, hess, count);
}

static void octo_run_steps(void *shared, int number) {
  octo_run_of_steps *run = (octo_run_of_steps *)shared + number;
  octo_lanes *s = aligned_alloc(64, (sizeof(octo_lanes) + 63) / 64 * 64);
  if (!s) { run->failed = 1; return; }
  octo_lanes_clear(s);
  for (long item = run->first; item < run->last;) {
    long member = item / run->steps, step = item % run->steps, end = run->steps;
    if (run->last - item < end - step) end = step + run->last - item;
    octo_lanes_begin(s, run->nodes + member * (run->steps + 2) * NX, (int)step, (int)end + 1);
    for (; step < end; step += STEPS) {
      int count = end - step < STEPS ? (int)(end - step) : STEPS;
      octo_run_group(run, item, count, run->p + member * NP, s);
      item += count;
    }
  }
  free(s);
}
#endif

int octo_batch(int batch, int steps, int order, int threads, const double *nodes, const double *p, const double *lam, double *fd,
               double *jac, double *hess) {
  long items = (long)batch * steps;
  if (threads > items) threads = items > 0 ? (int)items : 1;
  octo_run_of_steps *runs = calloc(threads, sizeof(octo_run_of_steps));
  int failed = 0;
  if (!runs) return 1;
  for (int k = 0; k < threads; ++k)
    runs[k] = (octo_run_of_steps){steps, order, nodes, p, lam, fd, jac, hess, items * k / threads, items * (k + 1) / threads, 0};
  octo_parallel_for(octo_run_steps, runs, threads, threads);
  for (int k = 0; k < threads; ++k) failed |= runs[k].failed;
  free(runs);
  return failed;
}
