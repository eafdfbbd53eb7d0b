"""Exact second derivatives of terms over the state by the kernels, executed on the CPU, against the
native code."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from curved import NAMES, described
from test_solve import both, same_path
from walker import START, wiggle_near_ground

from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.solver.records import Records
from octo.starts import first_nodes
from tests.emulator import EmulatedDevice

OTHERS = [name for name in NAMES if name not in ("nodes", "hermite", "pinned")]


@lru_cache
def batch(name: str, pinned: bool = False) -> CompiledProblem:
    """Two members."""
    one = described(name, ())
    if pinned:
        one = one.replace(x_end=START + 0.01, v_end=0.1 * np.ones(9))
    if one.cycle is not None:
        return CompiledProblem([one, one.replace(parameters={"gravity_z": -12.0})], exact=True)
    return CompiledProblem([one, one.replace(x0=one.start + 0.03)], exact=True)


def close(found: np.ndarray, wanted: np.ndarray) -> None:
    scale = np.abs(wanted).max(initial=1e-300)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-11 * scale)


def agree(problem: CompiledProblem, gpu: EmulatedDevice) -> None:
    """Without multipliers, with them, and with Gauss and Newton's model of one member."""
    unknowns, other = wiggle_near_ground(problem), DeviceProblem(problem, gpu)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, own, models = problem.evaluate(unknowns), other.evaluate(gpu.array(unknowns)), []
    for multipliers, curved in ((None, None), (lam, None), (lam, np.array([True, False]))):
        members = None if curved is None else gpu.array(curved, np.int32)
        wanted = problem.linearize(at, multipliers, curved)
        found = other.linearize(own, None if multipliers is None else gpu.array(lam), members)
        for name in "HAbC":
            close(getattr(found, name), getattr(wanted, name))
        models.append(wanted.H)
    assert np.abs(models[1][1] - models[2][1]).max() > 1e-3


@pytest.mark.parametrize("threads", [1, 32])
@pytest.mark.parametrize("name", OTHERS)
def test_the_model_against_native(
    name: str, threads: int, device: Callable[..., EmulatedDevice]
) -> None:
    agree(batch(name), device(threads))


def test_pinned_controls(device: Callable[..., EmulatedDevice]) -> None:
    agree(batch("losses, hermite", pinned=True), device(5))


@pytest.mark.parametrize("name", ["cart-pole, nodes", "biped, turning"])
def test_a_solve_takes_the_same_path(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels in graphs, on arrays as strict as CuPy's; E counts as settled from the start."""
    monkeypatch.setattr(Records, "settled", lambda self, members: np.full(len(members), True))
    problem = batch(name)
    nodes = np.stack([first_nodes(one, k, None) for k, one in enumerate(problem.problems)])
    expected, found = both(problem, nodes, SqpOptions(max_iterations=6))
    same_path(expected, found, 1e-6)
    plain = sqp.run(
        CompiledProblem(problem.problems),
        problem.unknowns(nodes),
        None,
        SqpOptions(max_iterations=6),
    )
    assert not np.allclose(plain.history[0]["energy"], expected.history[0]["energy"], rtol=1e-4)
