"""FD, its Jacobian and its curvature, a step; and the same as CasADi's whole expression.

All of them go through the steps in runs of ``RUN``, whose numbers one run after the other writes to
the same place: as in a solve, where they are used while they are in the cache and never stored for
all steps.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np

import octo
from octo import native
from octo.bench.iteration import MICRO, walk
from octo.bench.monolithic import Monolithic
from octo.bench.plan import Plan
from octo.bench.timing import Records, Say, interleaved
from octo.dynamics import codegen
from octo.dynamics.evaluate import RobotDynamics
from octo.model.quantities import Array
from octo.starts import first_nodes

AGREE = 1e-11  # of the largest entry
ORDERS = ("fd", "fd_jacobian", "curvature")  # the last one: all three
RUN = 40  # steps


class TreeSweep:
    """octo's own dynamics of all steps, written into memory that is in use; ``single``: by the text
    for one step."""

    def __init__(self, dynamics: RobotDynamics, nodes: Array, p: Array, single: bool = False):
        library = dynamics._library
        if single:
            library = native.load(dynamics.text() + codegen.batch_source())
        assert library is not None
        self.library, self.count, n = library, min(RUN, len(nodes) - 2), dynamics.nx
        assert (len(nodes) - 2) % self.count == 0
        lam = np.random.default_rng(0).standard_normal((self.count, n))
        self.fd, self.jac = np.zeros((self.count, n)), np.zeros((self.count, n, 3 * n))
        blocks = np.zeros((self.count, dynamics.curvature_blocks, n, n))
        self.held = (nodes, p, lam, self.fd, self.jac, blocks)
        self.written = sum(array.nbytes for array in self.held[3:]) / self.count  # bytes a step
        places = range(0, len(nodes) - 2, self.count)
        self.firsts = [ctypes.c_void_p(nodes[k:].ctypes.data) for k in places]
        self.others = [ctypes.c_void_p(array.ctypes.data) for array in self.held[1:]]

    def run(self, order: int) -> Callable[[], None]:
        def sweep() -> None:
            for first in self.firsts:
                self.library.octo_batch(1, self.count, order, 1, first, *self.others)

        return sweep


def _sweep(name: str, steps: int) -> tuple[TreeSweep, RobotDynamics, Array, Array]:
    problem = walk(octo.gallery.CHARACTERS[name](), steps)
    dynamics, nodes, p = problem.dynamics, first_nodes(problem, 0, None), problem.p.copy()
    assert isinstance(dynamics, RobotDynamics)
    return TreeSweep(dynamics, nodes, p), dynamics, nodes, p


def measure(records: Records, plan: Plan, say: Say) -> None:
    """us a step of the gallery's characters.

    ``one_step`` is FD and its Jacobian without lanes, as on the machine of the first measurements
    (spider 6 us, humanoid 16): the limits of an iteration hold in proportion to it, so that a
    faster kernel does not make them stricter.
    """
    runs: dict[str, Callable[[], None]] = {}
    degrees, written = {}, {}
    for name in plan.robots:
        say(name)
        tree, dynamics, nodes, p = _sweep(name, plan.steps)
        runs |= {f"dynamics.{name}.{label}": tree.run(k) for k, label in enumerate(ORDERS)}
        single = TreeSweep(dynamics, nodes, p, single=True)
        runs[f"dynamics.{name}.one_step.fd_jacobian"] = single.run(1)
        degrees[name], written[name] = dynamics.nx, tree.written
    say("all of them, interleaved")
    for label, timing in interleaved(runs, 3 * plan.rounds).items():
        records.add_timing(label, timing.per(plan.steps), MICRO, "us/step")
    for name, n in degrees.items():
        records.add(f"dynamics.{name}.dof", n, "")
        took = records[f"dynamics.{name}.curvature"] / MICRO  # s a step
        records.add(f"dynamics.{name}.curvature.written", written[name] / took / 1e9, "GB/s")
        pair = [f"dynamics.{name}.{label}" for label in ("curvature", "fd_jacobian")]
        records.ratio(f"dynamics.{name}.curvature/fd_jacobian", *pair)


def compare_symbolic(records: Records, plan: Plan, say: Say) -> None:
    """The tree pass over CasADi's expression: with its common subexpressions found, and the plain
    way."""
    for name in plan.symbolic:
        tree, dynamics, nodes, p = _sweep(name, plan.steps)
        runs, forms = {"octo": tree.run(1)}, {}
        for label, plain in (("expression", False), ("plain", True)):
            say(f"{name}, {label}: minutes of gcc the first time")
            form = Monolithic(dynamics, plain)
            fd, jac, runs[label] = form.sweep(nodes, p, tree.count)
            forms[label] = (form, fd, jac)
        best = interleaved(runs, plan.rounds)
        for label, (form, fd, jac) in forms.items():
            pairs = ((fd, tree.fd), (form.dense(jac), tree.jac))
            error = max(np.abs(one - other).max() / np.abs(one).max() for one, other in pairs)
            if not error < AGREE:
                raise ArithmeticError(
                    f"{name}: the tree pass and the symbolic form differ by {error:.1e}"
                )
            took = best[label].per(plan.steps)
            records.add_timing(f"symbolic.{name}.{label}", took, MICRO, "us/step")
            records.add(f"symbolic.{name}.{label}.operations", form.operations, "")
            records.add(f"symbolic.{name}.octo/{label}", best["octo"].least / best[label].least, "")
