"""What Fig. 11 is measured by, on small problems."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import markovian
from octo import learn


def test_a_cell_of_gaits() -> None:
    small = {**markovian.REGULARISED, "training": 20, "iterations": 20}
    cell = markovian.measure_gaits("walk", 0, steps=40, rounds=2, settings=small)
    own, plain = cell["markovian"], cell["plain"]
    assert len(own["rounds"]) == 2 and len(cell["curves"]) == 2
    spent = [one["seconds"] for one in cell["more"]]
    assert cell["more"][0] == plain and sum(spent[:-1]) < own["seconds"]
    np.testing.assert_allclose(own["energy"], own["rounds"][-1]["energy"], rtol=1e-9)
    assert json.loads(json.dumps(cell, default=markovian.plain_numbers))["drawn"]


def test_distance_to_an_orbit() -> None:
    """A point beside the middle of an edge is as far as it was moved, whatever its place."""
    n = 14
    transition = learn.Transition(hidden=(4,)).started(markovian.problem("walk", 40))
    random = np.random.default_rng(0)
    orbit = np.zeros((3, 2 * n))
    orbit[1, 7] = 0.4
    orbit[2] = orbit[0]
    made = np.tile(0.5 * (orbit[:1] + orbit[1:2]), (5, 1))
    made[:, :2] = random.standard_normal((5, 2))  # the place on the ground
    made[:, 9] += 0.03
    np.testing.assert_allclose(markovian.from_orbit(transition, orbit, made), 0.03, rtol=1e-9)
    assert markovian.finite(np.array([1.0, np.inf, np.nan])) == [1.0, None, None]


def test_what_is_not_known_is_refused() -> None:
    with pytest.raises(SystemExit):
        markovian.main(["gates"])
