"""What ``python -m tests.sanitize`` runs under the sanitizers: every entry of octo's native code,
in small problems.

Robots with contacts and sphere pairs that touch, user-written dynamics, both bases, cycles, terms
over two steps in a row, batches of 1, 3 and 7 on 1 and 3 threads; controllers, and the compiled
problem behind IPOPT.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

import octo
from octo import native
from octo.dynamics.evaluate import CustomDynamics
from octo.model.character import Character
from octo.mpc import Controller, walking_problem
from octo.problem.basis import Nodes
from octo.problem.compiled import CompiledProblem
from octo.reference.layout import octo_layout, stage_layout
from octo.reference.library import Library
from octo.reference.program import parameter_vector
from octo.solver.sqp import run

BATCHES, THREADS = (1, 3, 7), (1, 3)
FAULTS = {  # what is planted in the text that is compiled: what is right in it, what is wrong
    "an overrun": ("octo_spread(s->fd, NX, fd, count);", "octo_spread(s->fd, NX + 1, fd, count);"),
    "a read beyond the end": (
        "t->nodes + (size_t)member * (t->steps + 2)",
        "t->nodes + (size_t)member * (t->steps + 4)",
    ),
    "an overflow": (
        "octo_run_of_steps *runs =",
        "volatile int big = 2147483647; big = big + batch; octo_run_of_steps *runs =",
    ),
}


def crowded(robot: Character) -> Character:
    """The robot with spheres so large that pairs and contacts are at work."""
    contacts = tuple(
        replace(sphere, radius=1.5 * sphere.radius + 0.02) for sphere in robot.contacts
    )
    return replace(robot, contacts=contacts)


def problems(robot: Character) -> Iterator[tuple[str, octo.Problem]]:
    costs = [
        octo.CenterOfMassVelocity((0.5, 0.0, 0.0)),
        octo.Effort(),
        octo.FrictionCone(),
        octo.Slip(),
        octo.Posture(),
    ]
    start = np.array(
        octo.simulate(
            robot, octo.Problem(robot, steps=1, dt=0.01, costs=costs).start, steps=1, dt=0.01
        ).x[1]
    )
    yield "nodes", octo.Problem(robot, steps=11, dt=0.025, costs=costs, x0=start)
    smooth = [*costs, octo.NeighbourCost(lambda c, after, p: ca.sin(after) * after[0] - c)]
    yield (
        "hermite",
        octo.Problem(robot, steps=20, dt=0.025, costs=smooth, basis="hermite", x0=start),
    )
    rates = [*costs, octo.TorqueRate(loss=octo.Huber(0.1), curvature="exact")]
    yield "torque rates", octo.Problem(robot, steps=25, dt=0.025, costs=rates, x0=start)
    if robot.base == "floating":
        cycle = octo.Cycle(speed=0.4, mirror=False)
        yield "cycle", octo.Problem(robot, steps=7, costs=costs, cycle=cycle)
        yield "torque rates in a cycle", octo.Problem(robot, steps=7, costs=rates, cycle=cycle)


def user_written() -> octo.Problem:
    """Two masses on a spring, one of them driven."""

    def fd(x_next: Any, x: Any, x_prev: Any, p: Any) -> Any:
        pull = p["stiffness"] * (x_next[1] - x_next[0])
        a = (x_next - 2 * x + x_prev) / p["dt"] ** 2
        return ca.vertcat(a[0] - pull, a[1] + pull)

    dynamics = CustomDynamics(fd, 2, [0], {"stiffness": 3.0})
    return octo.Problem(dynamics, steps=9, dt=0.05, costs=[octo.Effort()], x0=np.zeros(2))


def optimised(name: str, problem: octo.Problem) -> None:
    """Evaluations, models and two iterations of both rules, from places in and out of the
    ground."""
    rng = np.random.default_rng(0)
    for batch in BATCHES:
        for threads in THREADS:
            compiled = CompiledProblem([problem] * batch, threads)
            unknowns = 0.1 * rng.standard_normal((batch, compiled.K, compiled.nc))
            at = compiled.evaluate(unknowns)
            for lam in (None, rng.standard_normal((batch, compiled.K, compiled.ma))):
                compiled.linearize(at, lam)
            for options in (octo.SqpOptions(), octo.SqpOptions.paper()):
                run(compiled, unknowns, None, replace(options, max_iterations=2))
            nodes = rng.standard_normal((batch, problem.steps + 2, compiled.n))
            lam = rng.standard_normal((batch, problem.steps, compiled.n))
            for order in (0, 1, 2):
                compiled.dynamics.evaluate(nodes, compiled.p, lam, order, threads)
    print(f"  {name}: {len(BATCHES) * len(THREADS)} batches", flush=True)


def controlled(robot: Character) -> None:
    """Controllers with both curvatures, single calls and refined ones."""
    for words in ({}, {"iterations": 2}, {"curvature": "exact"}):
        controller = Controller(walking_problem(robot, 6, 0.04), **words)
        q, v = controller.convention.from_octo(controller.problem.start, np.zeros(robot.nx))
        for k in range(1, 4):
            command = controller.step(0.01 * k, q, v)
            controller.command(0.01 * k + 0.004, q, v)
            assert command.K.shape == (robot.nu, 2 * controller.convention.nv)
    print("  controllers", flush=True)


def referred(problem: octo.Problem) -> None:
    """The functions that IPOPT and fatrop call."""
    compiled = CompiledProblem([problem], exact=True)
    layouts = [
        octo_layout(compiled),
        *([stage_layout(compiled)] if isinstance(compiled.basis, Nodes) else []),
    ]
    for layout in layouts:
        library = Library(compiled, layout)
        x, p = np.full(library.size, 0.05), parameter_vector(compiled)
        for name in ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g"):
            called(library, name, x, p)
        called(library, "nlp_hess_l", x, p, np.ones(1), np.ones(layout.rows))
    print(f"  {len(layouts)} references", flush=True)


def called(library: Library, name: str, *given: np.ndarray) -> None:
    """One of CasADi's functions, called by its C interface: CasADi itself cannot load a library
    under a sanitizer."""
    sparsity = getattr(library.handle, f"{name}_sparsity_out")
    sparsity.restype = ctypes.POINTER(ctypes.c_longlong)
    sparsity.argtypes = [ctypes.c_longlong]
    results = []
    for k in range(getattr(library.handle, f"{name}_n_out")()):
        columns = sparsity(k)[1]
        results.append(np.empty(sparsity(k)[2 + columns]))  # as many as there are nonzeros
    arguments, out = (
        (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        for arrays in (given, results)
    )
    assert getattr(library.handle, name)(arguments, out, None, None, 0) == 0
    assert all(np.isfinite(result).all() for result in results)


def plant(fault: str) -> None:
    """Break octo's texts before they are compiled."""
    (right, wrong), load = FAULTS[fault], native.load
    native.load = lambda text, flags=(): load(text.replace(right, wrong), flags)


def main(names: list[str]) -> None:
    for name in names:
        if name in FAULTS:
            plant(name)
            continue
        print(name, flush=True)
        if name == "user-written":
            optimised(name, user_written())
            continue
        robot = crowded(octo.load(name))
        assert robot.pairs and robot.terrain_contacts
        for kind, problem in problems(robot):
            optimised(kind, problem)
            referred(problem)
        if robot.base == "floating":
            controlled(robot)
    print("clean", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
