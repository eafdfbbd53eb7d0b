"""When a term acts: steps, masks and times are coefficients of q, and what is wrong is named."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem

STEPS, DT = 12, 0.05
ROBOT = octo.gallery.chain()


def problem(at: Any, **given: Any) -> octo.Problem:
    terms = [octo.Effort(), octo.Posture(at=at, weight=3.0)]
    given = {"steps": STEPS, "dt": DT, **given}
    return octo.Problem(ROBOT, costs=terms, **given)


def coefficients(*problems: octo.Problem) -> np.ndarray:
    return CompiledProblem(problems).interpreted().q[:, :, 1]


MASK = np.arange(STEPS) % 5 == 2
SOME: dict[str, tuple[Any, list[int]]] = {
    "steps": ([0, 4, -1], [0, 4, 11]),
    "an array": (np.array([3, -12]), [3, 0]),
    "a range": (range(4, 6), [4, 5]),
    "one step twice": ([7, -5], [7]),
    "a mask": (MASK, [2, 7]),
    "a list of truths": (MASK.tolist(), [2, 7]),
    "a time": (octo.At(0.35), [6]),
    "times": (octo.At([0.05, 0.3601, 0.6]), [0, 6, 11]),
    "times within half a step": (octo.At(seconds=(0.026, 0.624)), [0, 11]),
}


def test_weights_are_over_the_steps_at_which_a_term_acts():
    """In one batch: when a term acts is data. A weight for each step counts there."""
    found = coefficients(*(problem(at) for at, _ in SOME.values()), problem("all"), problem("last"))
    wanted = np.zeros((len(SOME) + 2, STEPS))
    for row, (_, steps) in zip(wanted, SOME.values(), strict=False):
        row[steps] = 3.0 / len(steps)
    wanted[-2], wanted[-1, -1] = 3.0 * (1.0 / STEPS), 3.0
    np.testing.assert_array_equal(found, wanted)
    by_step = octo.Posture(at=[1, 3], weight=np.arange(12.0))
    described = octo.Problem(ROBOT, steps=STEPS, dt=DT, costs=[octo.Effort(), by_step])
    assert coefficients(described)[0].nonzero()[0].tolist() == [1, 3]
    assert coefficients(described)[0, 3] == 1.5


def test_times_are_those_of_each_problem():
    found = coefficients(problem(octo.At(0.2)), problem(octo.At(0.2), dt=0.1))
    assert [row.nonzero()[0].tolist() for row in found] == [[3], [1]]


def test_a_keyframe_counts_where_it_stands():
    """E has the square at these steps alone, and bounded rows say where they are used."""

    class Bounded(octo.CustomCost):
        kind = "bounded"

    terms = [octo.Posture(at=[2, 5]), Bounded(lambda step, p: step.u[:2], at=octo.At([0.1]))]
    compiled = CompiledProblem(
        [octo.Problem(ROBOT, steps=STEPS, dt=DT, costs=terms, basis=Hermite(4))]
    )
    rng = np.random.default_rng(0)
    at = compiled.evaluate(0.1 * rng.standard_normal((1, compiled.K, compiled.nc)))
    assert at.terms[0, :, 0].nonzero()[0].tolist() == [2, 5]
    used = compiled.used_rows
    assert used.shape == at.rows.shape == (1, STEPS, 2)
    assert np.argwhere(used[0])[:, 0].tolist() == [1, 1]


def test_the_old_name_of_the_field():
    """It is taken over, and a change of either name is what counts then."""
    old = octo.PoseTarget(target=np.zeros(ROBOT.nx), steps="all")
    assert old.at == "all" and old.steps is None
    assert dataclasses.replace(old, at=[3]).at == [3]
    assert dataclasses.replace(old, steps="last").at == "last"
    given = [3]
    term = octo.Effort(at=given)
    given.append(4)
    assert term.at == [3]


WRONG: dict[str, tuple[Any, str]] = {
    "a word": ("first", "Posture.at 'first' is not known; did you mean last"),
    "a fraction": ([0.5], r"Posture.at is \[0.5\], must be 'all', 'last', numbers of steps"),
    "one number": (3, "Posture.at is 3, must be 'all', 'last', numbers of steps"),
    "nothing": (None, "Posture.at is None, must be 'all'"),
    "lists": ([[1, 2], [3]], "Posture.at is a list, must be"),
    "an empty list": ([], r"Posture.at is \[\], must have one step or more"),
    "an empty mask": (np.zeros(STEPS, bool), "Posture.at is .*, must have one step or more"),
    "a step too far": ([2, 12], "Posture.at has the step 12, must be between -12 and 11"),
    "a step too early": ([-13], "Posture.at has the step -13, must be between"),
    "a short mask": ([True, False], "Posture.at is a mask of 2 steps, must be of 12"),
    "the start": (octo.At([0.3, 0.0]), "Posture.at has the time 0 s, must be between 0.025 and"),
    "a late time": (octo.At(0.63), "Posture.at has the time 0.63 s, must be between .* 0.625 s"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_refused(what):
    at, said = WRONG[what]
    with pytest.raises(OctoError, match=said) as error:
        coefficients(problem(at))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("seconds", [[], "soon", [np.nan], [[0.1], [0.2]]])
def test_times_that_are_none(seconds):
    with pytest.raises(OctoError, match=r"At.seconds is"):
        octo.At(seconds)
