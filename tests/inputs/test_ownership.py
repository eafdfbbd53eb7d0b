"""Who owns which numbers: copies of what is given, threads on one problem, what outlives what,
pickles, memory given back."""

from __future__ import annotations

import copy
import gc
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.dynamics.evaluate import CustomDynamics
from octo.errors import ShapeError
from octo.model.character import Character
from octo.problem.compiled import CompiledProblem
from octo.solver import blas, elimination

MAMMAL = octo.gallery.mammal()
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
QUICK: dict[str, Any] = {"max_iterations": 3, "passes": 1, "device": "cpu"}


def problem(**changes: Any) -> octo.Problem:
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort(), octo.FrictionCone()]
    return octo.Problem(MAMMAL, **{"steps": 12, "dt": 0.025, "costs": costs, **changes})


def integrator(**changes: Any) -> octo.Problem:
    """A mass on a line."""
    dynamics = CustomDynamics(
        lambda x_next, x, x_prev, p: p["mass"] * (x_next - 2 * x + x_prev), 1, [0], {"mass": 2.0}
    )
    return octo.Problem(
        dynamics, **{"steps": 6, "dt": 0.1, "costs": [octo.Effort()], "x0": np.zeros(1), **changes}
    )


# -- what was given stays the giver's --------------------------------------------------------------


def _changed(value: Any) -> None:
    if isinstance(value, float):
        return
    if isinstance(value, dict):
        for entry in value.values():
            _changed(entry)
        value["new"] = 7.0
    elif isinstance(value, list):
        value.append(7.0)
    else:
        value[...] = 7.0


START = np.array(octo.simulate(MAMMAL, problem().start, steps=1, dt=0.01).x[1])
FIELDS: dict[str, Any] = {
    "x0": START,
    "v0": np.zeros(MAMMAL.nx),
    "x_end": START,
    "v_end": np.zeros(MAMMAL.nx),
    "displacement": np.zeros(MAMMAL.nx),
    "pose": START,
    "parameters": {"gravity_z": -3.0},
    "costs": [octo.Effort()],
}


@pytest.mark.parametrize("name", FIELDS)
def test_a_problem_keeps_what_it_was_given(name: str) -> None:
    given = FIELDS[name].copy()
    more = {"x_end": START} if name == "v_end" else {}
    made = problem(**{name: given}, **more)
    before = copy.deepcopy(getattr(made, name))
    replaced = made.replace(dt=0.03)
    _changed(given)
    for one in (made, replaced):
        kept = getattr(one, name)
        assert len(kept) == len(before)
        if name != "costs":
            assert kept == before if isinstance(before, dict) else np.array_equal(kept, before)


TERMS: dict[str, tuple[Callable[[Any], octo.Cost], str, Any]] = {
    "velocity": (lambda v: octo.CenterOfMassVelocity(v), "velocity", np.zeros(3)),
    "weights": (lambda v: octo.Effort(weight=v), "weight", np.ones(12)),
    "a list": (lambda v: octo.PointPosition(target=v), "target", [0.0, 1.0, 2.0]),
    "rows": (lambda v: octo.BaseHeight(height=v), "height", np.ones(12)),
    "names": (lambda v: octo.Slip(contacts=v), "contacts", ["front_left"]),
    "values": (
        lambda v: octo.CustomCost(lambda step, p: p["a"] * step.u, v),
        "values",
        {"a": np.ones(1), "b": [1.0], "c": {"d": [2.0]}},
    ),
    "a pose": (lambda v: octo.PoseTarget(target=v), "target", np.zeros(MAMMAL.nx)),
    "a float32 array": (
        lambda v: octo.Posture(joints=v),
        "joints",
        np.ones(MAMMAL.nu, dtype=np.float32),
    ),
    "a view": (lambda v: octo.JointVelocity(v), "velocity", np.zeros((2, 12))[0]),
    "CasADi's matrix": (lambda v: octo.CenterOfMassVelocity(v), "velocity", ca.DM([1.0, 2.0, 3.0])),
}


@pytest.mark.parametrize("name", TERMS)
def test_a_term_keeps_what_it_was_given(name: str) -> None:
    make, field, value = TERMS[name]
    given = copy.deepcopy(value)
    term = make(given)
    if isinstance(given, ca.DM):
        given[0] = 7.0
    else:
        _changed(given)
    kept = getattr(term, field)
    if isinstance(value, dict):
        assert (
            kept.keys() == value.keys()
            and kept["a"] == 1.0
            and kept["b"] == [1.0]
            and kept["c"] == {"d": [2.0]}
        )
    else:
        assert np.array_equal(np.asarray(kept), np.asarray(value))


def test_other_things_keep_what_they_were_given() -> None:
    parameters, actuated, pairs = {"height": 1.0}, np.array([0]), {"left": "right"}
    terrain = octo.Terrain(lambda point, p: point[2] - p["height"], parameters)
    dynamics = CustomDynamics(lambda a, b, c, p: a - 2 * b + c, 1, actuated, {})  # type: ignore[arg-type]
    cycle = octo.Cycle(speed=0.5, mirror=pairs)
    parameters["height"], actuated[0], pairs["more"] = 3.0, 5, "names"
    assert (
        terrain.parameters == {"height": 1.0}
        and dynamics.actuated.tolist() == [0]
        and cycle.mirror == {"left": "right"}
    )


def test_a_callback_gets_copies() -> None:
    kept: list[Any] = []

    def spoil(at: Any) -> None:
        kept.append((at.nodes.copy(), at.energy.copy()))
        for array in (
            at.nodes,
            at.energy,
            at.violation,
            at.at.C,
            at.at.nodes,
            at.at.fd,
            at.at.unknowns,
        ):
            array[...] = np.nan

    quiet = octo.solve(problem(), **{**QUICK, "max_iterations": 6})
    spoiled = octo.solve(problem(), callback=spoil, **{**QUICK, "max_iterations": 6})
    assert (
        np.array_equal(quiet.x, spoiled.x)
        and spoiled.status is quiet.status
        and len(kept) == quiet.iterations
    )
    assert np.isfinite(kept[-1][0]).all() and not np.array_equal(kept[0][0], kept[-1][0])


def test_a_guide_gets_copies() -> None:
    from octo.mpc import Controller, walking_problem

    described = walking_problem(MAMMAL, 8, 0.04)
    plans = []
    for spoil in (False, True):

        def guide(controller: Controller, t: float, x: np.ndarray, spoil: bool = spoil) -> None:
            if spoil:
                x[:] = 5.0

        controller = Controller(described, guide=guide)
        q, v = controller.convention.from_octo(described.start, np.zeros(MAMMAL.nx))
        controller.reset(q, v, 0.0)
        controller.step(0.01, q, v)
        plans.append(controller.plan.x.copy())
    assert np.array_equal(*plans)


# -- threads ---------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_threads_on_one_compiled_problem(basis: str, threads: int) -> None:
    shared = CompiledProblem([problem(basis=basis, steps=40)] * 2, threads)
    rng = np.random.default_rng(3)
    places = [0.1 * rng.standard_normal((2, shared.K, shared.nc)) for _ in range(4)]
    lam = [rng.standard_normal((2, shared.K, shared.ma)) for _ in range(4)]

    def all_of(k: int) -> tuple[np.ndarray, ...]:
        at = shared.evaluate(places[k])
        model = shared.linearize(at, lam[k])
        return at.C, at.terms, model.H, model.A, model.b

    alone = [all_of(k) for k in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for k, found in enumerate(pool.map(all_of, list(range(4)) * 15)):
            for a, b in zip(found, alone[k % 4], strict=True):
                np.testing.assert_array_equal(a, b)
    assert len(shared.steps_code._free_tasks) <= 4


def test_threads_that_solve_one_problem() -> None:
    described = problem()
    alone = octo.solve(described, **QUICK)
    with ThreadPoolExecutor(3) as pool:
        for found in pool.map(lambda _: octo.solve(described, **QUICK), range(6)):
            assert np.array_equal(found.x, alone.x)


@needs_compiler
def test_threads_that_share_memories_of_factors() -> None:
    rng = np.random.default_rng(0)
    H = np.zeros((1, 6, 3, 4, 4))
    H[:, :, 0] = np.eye(4)
    A, rhs = rng.standard_normal((1, 6, 3, 2, 4)), rng.standard_normal((1, 6, 4))
    alone = elimination.factorize(H, A).solve(rhs)[0]

    def work(_: int) -> bool:
        same = all(
            np.array_equal(elimination.factorize(H, A).solve(rhs)[0], alone) for _ in range(50)
        )
        elimination.release()
        return same

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(12)))


@pytest.fixture
def blas_threads() -> Iterator[Callable[[], list[int]]]:
    """How many threads each BLAS has now, 3 at first: of those that products use, not the one that
    comes with IPOPT."""
    threadpoolctl = pytest.importorskip("threadpoolctl")
    own = {pool["filepath"] for pool in blas._controller().info()}

    def found() -> list[int]:
        pools = threadpoolctl.threadpool_info()
        return [
            pool["num_threads"]
            for pool in pools
            if pool["user_api"] == "blas" and pool["filepath"] in own
        ]

    with threadpoolctl.threadpool_limits(3, user_api="blas"):
        if not found() or 3 not in found():
            pytest.skip("this BLAS has no threads")
        yield found


def test_limits_of_blas_that_overlap(blas_threads: Callable[[], list[int]]) -> None:
    from octo.reference.run import one_core

    before = blas_threads()
    for first, second in (
        (blas.one_thread, blas.one_thread),
        (one_core, blas.one_thread),
        (blas.one_thread, one_core),
    ):
        a, b = first(), second()
        a.__enter__()
        b.__enter__()
        a.__exit__(None, None, None)
        assert set(blas_threads()) == {1}
        b.__exit__(None, None, None)
        assert blas_threads() == before
    with pytest.raises(ZeroDivisionError), blas.one_thread(), blas.one_thread():
        raise ZeroDivisionError
    assert blas_threads() == before


def test_solves_that_overlap_leave_blas_as_it_was(blas_threads: Callable[[], list[int]]) -> None:
    before, options = blas_threads(), octo.SqpOptions(linear_solver="cyclic_reduction")
    few = {**QUICK, "options": options, "max_iterations": 1}
    solves = [
        threading.Thread(target=octo.solve, args=(problem(steps=4),), kwargs=few) for _ in range(3)
    ]
    for thread in solves:
        thread.start()
    for thread in solves:
        thread.join()
    assert blas_threads() == before


# -- what outlives what ----------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("name", ["nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l"])
def test_a_function_outlives_its_library(name: str) -> None:
    from octo.reference.layout import octo_layout
    from octo.reference.library import Library
    from octo.reference.program import nlp

    reference = nlp(problem(steps=5))
    library = Library(reference.compiled, octo_layout(reference.compiled))
    function = library.function(name)
    more = {"nlp_hess_l": [1.0, np.ones(reference.g.numel())]}.get(name, [])
    x, p = reference.start + 0.01, reference.parameters
    alive = function.call([x, p, *more])
    del library
    gc.collect()
    rubbish = [np.full(2000, 2**31 - 1, dtype=np.int32) for _ in range(300)]
    function.call([x + 1.0, p, *more])
    for a, b in zip(alive, function.call([x, p, *more]), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    assert rubbish


# -- other kinds of numbers ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["float32", "int", "fortran", "every other", "list"])
def test_multipliers_and_nodes_of_other_kinds(kind: str) -> None:
    compiled = CompiledProblem([problem()])
    rng = np.random.default_rng(1)
    lam = np.round(4.0 * rng.standard_normal((1, compiled.K, compiled.ma)))
    at = compiled.evaluate(np.zeros((1, compiled.K, compiled.nc)))
    other = {
        "float32": lambda a: a.astype(np.float32),
        "int": lambda a: a.astype(int),
        "fortran": np.asfortranarray,
        "every other": lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
        "list": lambda a: a.tolist(),
    }[kind]
    np.testing.assert_array_equal(
        compiled.linearize(at, other(lam)).H, compiled.linearize(at, lam).H
    )
    nodes = np.round(8.0 * at.nodes) / 8.0
    if kind != "int":
        found = compiled.evaluate_nodes(at.unknowns, other(nodes))
        np.testing.assert_array_equal(found.fd, compiled.evaluate_nodes(at.unknowns, nodes).fd)


def test_what_native_code_would_read_beyond_its_end_is_refused() -> None:
    compiled = CompiledProblem([problem()])
    at = compiled.evaluate(np.zeros((1, compiled.K, compiled.nc)))
    for shape in [(1, 2, compiled.ma), (compiled.K, compiled.ma), (2, compiled.K, compiled.ma), ()]:
        with pytest.raises(ShapeError, match="lam has shape"):
            compiled.linearize(at, np.zeros(shape))
    with pytest.raises(ShapeError, match="nodes has shape"):
        compiled.evaluate_nodes(at.unknowns, at.nodes[:, :-1])


def test_a_start_with_float32_multipliers() -> None:
    from dataclasses import replace

    first = octo.solve(problem(), **QUICK)
    half = replace(first, multipliers=first.multipliers.astype(np.float32))
    whole = replace(first, multipliers=half.multipliers.astype(float))
    assert np.array_equal(
        *(octo.solve(problem(), start=start, **QUICK).x for start in (half, whole))
    )


# -- pickles and copies ----------------------------------------------------------------------------

KINDS: dict[str, Callable[[], octo.Problem]] = {
    "robot": problem,
    "hermite": lambda: problem(basis="hermite", steps=20),
    "an end": lambda: problem(displacement=np.zeros(MAMMAL.nx)),
    "a cycle": lambda: octo.Problem(
        MAMMAL, costs=[octo.Effort()], cycle=octo.Cycle(speed=0.5), steps=8
    ),
    "user-written": integrator,
    "another law": lambda: problem(
        law=octo.laws.Smooth(friction=octo.laws.Coulomb(mu=0.7)), terrain=octo.Plane(slope=0.1)
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_problem_pickles_after_a_solve(kind: str) -> None:
    described = KINDS[kind]()
    before = octo.solve(described, **QUICK)
    for again in (pickle.loads(pickle.dumps(described)), copy.deepcopy(described)):
        assert np.array_equal(octo.solve(again, **QUICK).x, before.x)
        assert [term.label for term in again.costs] == [term.label for term in described.costs]
        assert np.array_equal(again.replace(dt=described.dt).start, described.start)
        if described.cycle is not None:
            # the anchor is still known as the problem's own
            assert len(again.replace(cycle=None).costs) == 1


def test_solutions_and_robots_pickle_after_a_solve() -> None:
    solution = octo.solve(problem(), **QUICK)
    assert solution.gait is not None
    again = pickle.loads(pickle.dumps(solution))
    assert (
        np.array_equal(again.x, solution.x)
        and isinstance(again.character, Character)
        and str(again) == str(solution)
    )
    assert np.array_equal(
        octo.solve(problem(), start=again, **QUICK).x,
        octo.solve(problem(), start=solution, **QUICK).x,
    )


# -- memory ----------------------------------------------------------------------------------------


def resident() -> float:
    """MB of this process."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


@needs_compiler
def test_a_batch_gives_its_memory_back() -> None:
    octo.solve(problem(steps=100), **{**QUICK, "max_iterations": 1})
    gc.collect()
    before = resident()
    octo.solve(problem(steps=100), seeds=16, **{**QUICK, "max_iterations": 1})
    gc.collect()
    assert elimination._pool == {}
    assert resident() - before < 40.0  # 130 with the pools
