"""The rules of the filter on numbers a person can check."""

from __future__ import annotations

from copy import deepcopy
from types import SimpleNamespace
from typing import Any

import numpy as np

from octo.solver.acceptance import Step
from octo.solver.filter import ARMIJO, CAPACITY, FilterAcceptance


def of(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


def point(violation: np.ndarray, energy: np.ndarray) -> Any:
    """What a filter looks at of an Evaluation."""
    return SimpleNamespace(size=violation, energy=energy)


def started(*violations: float) -> FilterAcceptance:
    return FilterAcceptance().started(point(of(*violations), of(*violations)))


def along(slope: np.ndarray, length: np.ndarray) -> Step:
    return Step(length, slope, length, length)


def accepts(entries: FilterAcceptance, at, trial, slope=1.0, length=1.0) -> bool:
    pair = [point(of(v), of(e)) for v, e in (at, trial)]
    return bool(entries.accepts(*pair, along(of(slope), of(length)))[0])


def test_less_violation_or_less_energy_is_enough():
    entries = started(1.0)
    assert accepts(entries, (1.0, 5.0), (0.9, 7.0))
    assert accepts(entries, (1.0, 5.0), (1.5, 4.0))
    assert not accepts(entries, (1.0, 5.0), (1.0, 5.0))
    assert not accepts(entries, (1.0, 5.0), (1.1, 5.1))


def test_an_entry_blocks_what_is_no_better_in_either():
    entries = started(1.0)
    entries.add(point(of(1.0), of(5.0)), np.array([True]))
    assert not accepts(entries, (2.0, 6.0), (1.0, 5.0))
    assert not accepts(entries, (2.0, 6.0), (1.5, 5.5))
    assert accepts(entries, (2.0, 6.0), (1.5, 4.9))
    assert accepts(entries, (2.0, 6.0), (0.9, 5.9))
    entries.restored(np.array([0]))
    assert accepts(entries, (2.0, 6.0), (1.5, 5.5))


def test_an_iterate_that_was_left_cannot_come_back():
    """Entries are a little better than the iterate they come from."""
    entries = started(1.0)
    entries.add(point(of(1.0), of(5.0)), np.array([True]))
    assert not accepts(entries, (3.0, 9.0), (1.0 - 1e-7, 5.0 - 1e-10))
    violation, energy = float(entries.violation[0, 0]), float(entries.energy[0, 0])
    assert violation < 1.0 and energy < 5.0
    assert not accepts(entries, (3.0, 9.0), (violation, energy))
    assert accepts(entries, (3.0, 9.0), (violation, energy - 1e-9)) and accepts(
        entries, (3.0, 9.0), (violation - 1e-9, energy)
    )


def test_a_steep_slope_asks_for_a_decrease_of_the_energy():
    """At feasible iterates the switching condition holds: less violation alone is no reason to go
    up."""
    entries = started(1.0)
    assert not accepts(entries, (1e-5, 5.0), (0.0, 5.1), slope=-1.0)
    assert not accepts(entries, (1e-5, 5.0), (1e-6, 5.0 - 0.1 * ARMIJO), slope=-1.0)
    assert accepts(entries, (1e-5, 5.0), (1e-4, 5.0 - 2.0 * ARMIJO), slope=-1.0)
    assert accepts(entries, (1.0, 5.0), (0.5, 5.1), slope=-10.0), (
        "far from feasible the energy may rise"
    )
    assert not entries.descends(along(of(1.0), of(1.0)), of(0.0))[0], (
        "an ascent never has to descend"
    )


def test_a_far_violation_or_nan_is_refused():
    entries = started(1.0)
    assert not accepts(entries, (1.0, 5.0), (1e5, 0.0))
    for bad in (np.nan, np.inf):
        assert not accepts(entries, (1.0, 5.0), (0.5, bad))
        assert not accepts(entries, (1.0, 5.0), (bad, 4.0))


def test_members_have_their_own_entries_and_the_oldest_is_forgotten():
    entries = started(1.0, 1.0, 1.0)
    entries.add(point(of(0.5, 0.5, 0.5), of(1.0, 1.0, 1.0)), np.array([False, True, False]))
    at, trial, one = of(1.0, 1.0, 1.0), of(0.6, 0.6, 0.6), of(1.0, 1.0, 1.0)
    pair = (point(at, 2.0 * at), point(trial, trial + 0.9))
    np.testing.assert_array_equal(entries.accepts(*pair, along(one, one)), [True, False, True])
    part = deepcopy(entries)
    part.take(np.array([1, 2]))
    two, steps = [point(p.size[:2], p.energy[:2]) for p in pair], along(one[:2], one[:2])
    np.testing.assert_array_equal(part.accepts(*two, steps), [False, True])
    for _ in range(CAPACITY):
        part.add(point(of(0.1, 0.1), of(9.0, 9.0)), np.array([True, False]))
    assert part.accepts(*two, steps).all()
    assert not entries.accepts(*pair, along(one, one))[1], "taken copies do not write to the whole"
