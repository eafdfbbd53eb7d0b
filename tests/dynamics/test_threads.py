"""phases.c as a block of threads, the GPU's way, with POSIX threads and barriers on the CPU: the
same numbers as in serial."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from test_tree_pass import TERRAINS, harden, inflate, sink, trajectory

from octo import native
from octo.dynamics.evaluate import RobotDynamics, unfold
from octo.model.gallery import CHARACTERS

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

BLOCK = """
#include <pthread.h>
static __thread int octo_lane;
static int octo_lanes;
static pthread_barrier_t octo_barrier;
#define LANE octo_lane
#define LANES octo_lanes
#define BARRIER pthread_barrier_wait(&octo_barrier)
"""

ENTRY = """
#include <stdlib.h>
typedef struct { int lane, order; const double **in; double **out; } octo_thread;

static void *octo_run_thread(void *argument) {
  octo_thread *t = argument;
  octo_lane = t->lane;
  const double **in = t->in;
  double **out = t->out;
  octo_step(in[0], in[1], in[2], in[3], in[4], in[5], in[6], in[7], t->order, out[0], out[1],
    out[2], out[3]);
  return 0;
}

void octo_block(int threads, int order, const double *nodes, const double *p, const double *lam,
  double *fd, double *jac,
                double *hess) {
  double *kin = malloc(3 * KIN * sizeof(double)), *work = malloc(WORK * sizeof(double));
  for (int k = 0; k < 3; ++k) octo_kin(nodes + k * NX, kin + k * KIN);
  const double *in[8] = {nodes + 2 * NX, nodes + NX, nodes, kin + 2 * KIN, kin + KIN, kin, p, lam};
  double *out[4] = {fd, jac, hess, work};
  pthread_t handles[64]; octo_thread run[64];
  octo_lanes = threads;
  pthread_barrier_init(&octo_barrier, 0, threads);
  for (int k = 0; k < threads; ++k) {
    octo_thread one = {k, order, in, out};
    run[k] = one;
    pthread_create(&handles[k], 0, octo_run_thread, &run[k]);
  }
  for (int k = 0; k < threads; ++k) pthread_join(handles[k], 0);
  pthread_barrier_destroy(&octo_barrier);
  free(kin); free(work);
}
"""


@pytest.mark.parametrize("name", ["mammal", "humanoid"])
def test_a_block_of_threads_gives_the_serial_numbers(name):
    rng = np.random.default_rng(11)
    character = harden(CHARACTERS[name](), rng)
    nodes = trajectory(character, rng, count=3)
    character = inflate(character, nodes)
    assert sink(character, nodes, TERRAINS["slope"]).any()
    dynamics = RobotDynamics(character, terrain=TERRAINS["slope"])
    p = dynamics.layout.pack()
    lam = rng.standard_normal((1, 1, character.nx))
    library = native.load(BLOCK + dynamics.text() + ENTRY)
    for order in (0, 1, 2):
        serial = dynamics.evaluate(nodes, p[None], lam, order=order)
        for threads in (1, 5, 13):
            found = [np.zeros_like(a) if a is not None else np.zeros(1) for a in serial[:2]]
            found.append(np.zeros((1, 1, dynamics.curvature_blocks, character.nx, character.nx)))
            pointers = [ctypes.c_void_p(a.ctypes.data) for a in (nodes, p, lam, *found)]
            library.octo_block(threads, order, *pointers)
            found[2] = unfold(found[2])
            for a, b in zip(found, serial, strict=True):
                if b is not None:
                    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13 * np.abs(b).max())
