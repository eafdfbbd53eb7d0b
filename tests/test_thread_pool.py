"""The pool of threads of native code: every item once, worker numbers that no two threads have at
once, calls at the same time, after a fork."""

from __future__ import annotations

import ctypes
import os
import threading

import numpy as np
import pytest

from octo import native

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

TEXT = """
typedef struct { int *times, *inside, *clashes; } counts;
static void busy(void) { for (volatile int k = 0; k < 20000; ++k) {} }
static void one(void *shared, int item) {
  busy();
  __atomic_add_fetch((int *)shared + item, 1, __ATOMIC_RELAXED);
}
void pool_items(int *times, int items, int threads) {
  octo_parallel_for(one, times, items, threads);
}
static void own(const void *shared, ptrdiff_t item, int worker) {
  const counts *c = shared;
  int inside = __atomic_add_fetch(c->inside + worker, 1, __ATOMIC_RELAXED);
  if (inside > 1) __atomic_add_fetch(c->clashes, 1, __ATOMIC_RELAXED);
  busy();
  c->times[item]++;
  __atomic_add_fetch(c->inside + worker, -1, __ATOMIC_RELAXED);
}
void pool_workers(int *times, int items, int threads, int *inside, int *clashes) {
  counts c = {times, inside, clashes};
  octo_parallel_for_workers(own, &c, items, threads);
}
"""


@pytest.fixture(scope="module")
def pool() -> ctypes.CDLL:
    library = native.load(native.threads() + TEXT)
    assert library is not None
    return library


def at(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def once(pool: ctypes.CDLL, items: int, threads: int) -> bool:
    """Whether a call does each item once."""
    times = np.zeros(items, dtype=np.int32)
    pool.pool_items(at(times), items, threads)
    return bool((times == 1).all())


@pytest.mark.parametrize("threads", [1, 2, 3, 8, 100])
def test_every_item_once(pool, threads):
    for items in (0, 1, 2, 7, 300):
        assert all(once(pool, items, threads) for _ in range(20))


@pytest.mark.parametrize("threads", [1, 2, 5, 100])
def test_a_worker_is_one_thread_at_a_time(pool, threads):
    """Also with helpers left over from calls with more threads."""
    for items in (0, 1, 3, 200):
        times, clashes = np.zeros(items, dtype=np.int32), np.zeros(1, dtype=np.int32)
        inside = np.zeros(threads + 1, dtype=np.int32)
        pool.pool_workers(at(times), items, threads, at(inside), at(clashes))
        assert (times == 1).all() and clashes[0] == 0 and not inside.any()


def test_calls_at_the_same_time(pool):
    """One has the helpers, the others work alone."""
    good: list[bool] = []
    callers = [
        threading.Thread(target=lambda: good.extend(once(pool, 40, 3) for _ in range(30)))
        for _ in range(4)
    ]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert good == [True] * 120


def test_after_a_fork(pool):
    """The child has no helpers, and gets its own."""
    assert once(pool, 40, 4)
    child = os.fork()
    if child == 0:
        os._exit(0 if all(once(pool, 40, 4) for _ in range(10)) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert once(pool, 40, 4)
