"""A rule written outside octo, that octo's line search asks: compiled, without a compiler, on a
device."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extending.acceptance_rule import L1Merit

import octo
from octo import native
from octo.errors import ProblemError, UnknownNameError, ValueRangeError
from octo.gpu.backend import DeviceBackend
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import HEURISTICS, SqpOptions
from octo.starts import first_nodes
from tests.emulator import EmulatedDevice

OPTIONS = SqpOptions(acceptance=L1Merit(), linear_solver="cyclic_reduction", max_iterations=6)


class Never(octo.Acceptance):
    def accepts(self, at, trial, step):
        return np.zeros(len(at.energy), dtype=bool)


@pytest.fixture(scope="module")
def stand():
    """A robot that holds itself up, and minds being elsewhere than at its start."""
    costs = [octo.Effort(), octo.Posture(), octo.Upright()]
    return octo.Problem(octo.gallery.mammal(), steps=20, dt=0.025, costs=costs)


def run(problem, options, count=2, device=None):
    compiled = CompiledProblem([problem] * count)
    nodes = np.stack([first_nodes(problem, seed, None) for seed in range(count)])
    if device is None:
        return sqp.run(compiled, compiled.unknowns(nodes), None, options)
    placed, backend = DeviceProblem(compiled, device), DeviceBackend(device)
    return sqp.run(placed, placed.unknowns(nodes), None, options, None, backend)


def test_it_finds_the_same_motion(stand):
    expected = octo.solve(stand, device="cpu", passes=1)
    found = octo.solve(
        stand, device="cpu", passes=1, options=SqpOptions(acceptance=L1Merit()), max_iterations=400
    )
    assert expected.converged and found.converged
    assert found.energy == pytest.approx(expected.energy, rel=1e-3)
    assert found.iterations != expected.iterations or not np.array_equal(found.x, expected.x)


def test_it_is_one_short_file():
    text = Path(__file__).with_name("acceptance_rule.py").read_text()
    assert text.count("\n") <= 80 and "octo." in text and "octo.solver" not in text


def test_it_decides(stand):
    """A rule that takes nothing leaves the line search nothing but to restore the constraints."""
    kept = tuple(name for name in HEURISTICS if name != "restoration")
    found = run(stand, SqpOptions(acceptance=Never(), heuristics=kept, max_iterations=9))
    assert [status.name for status in found.status] == ["STALLED"] * 2
    assert all((history["taken"] == 0.0).all() for history in found.history)


def test_members_do_not_disturb_each_other(stand):
    both = run(stand, replace(OPTIONS, max_iterations=15), 3)
    alone = run(stand, replace(OPTIONS, max_iterations=15), 1)
    np.testing.assert_array_equal(both.at.unknowns[0], alone.at.unknowns[0])


def test_one_rule_serves_many_solves(stand):
    rule = L1Merit()
    options = replace(OPTIONS, acceptance=rule)
    one, other = run(stand, options), run(stand, options)
    np.testing.assert_array_equal(one.at.unknowns, other.at.unknowns)
    assert not hasattr(rule, "rho")


def test_without_a_compiler(stand, monkeypatch):
    expected = run(stand, OPTIONS, 1)
    monkeypatch.setattr(native, "compiler", lambda: None)
    again = octo.Problem(octo.gallery.mammal(), steps=20, dt=0.025, costs=list(stand.costs))
    assert CompiledProblem([again]).library is None
    same(expected, run(again, OPTIONS, 1))


def test_on_a_device(stand):
    same(run(stand, OPTIONS), run(stand, OPTIONS, device=EmulatedDevice(xp=strict_arrays())))


def strict_arrays():
    """Arrays as strict as a device's."""
    place = Path(__file__).parents[1] / "gpu" / "strict.py"
    made = importlib.util.spec_from_file_location("strict", place)
    module = importlib.util.module_from_spec(made)
    sys.modules.setdefault("strict", module)
    if sys.modules["strict"] is module:
        made.loader.exec_module(module)
    return sys.modules["strict"]


def same(expected, found):
    for one, other in zip(expected.history, found.history, strict=True):
        np.testing.assert_array_equal(one["ratio"], other["ratio"])
        np.testing.assert_allclose(one["energy"], other["energy"], rtol=1e-6)


def test_wrong_options():
    with pytest.raises(ProblemError, match="acceptance is .* must be an octo.Acceptance"):
        SqpOptions(acceptance=L1Merit)
    with pytest.raises(UnknownNameError, match="extrapolation"):
        SqpOptions(heuristics=("extrapolatoin",))
    with pytest.raises(ValueRangeError, match="heuristics is .* must be a tuple"):
        SqpOptions(heuristics="extrapolation")


@pytest.mark.parametrize("name", HEURISTICS)
def test_each_heuristic_can_be_switched_off(stand, name):
    kept = tuple(other for other in HEURISTICS if other != name)
    found = octo.solve(
        stand, device="cpu", passes=1, options=SqpOptions(heuristics=kept), max_iterations=400
    )
    assert found.converged
