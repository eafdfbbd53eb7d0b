"""Phases solved as one: the optimum of the undivided problem, IPOPT's of an independent
formulation, one motion without a jump, batches, passes, what comes out."""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo.dynamics.laws import Coulomb, Smooth
from octo.errors import DeviceError, OctoError

CART, POLE, LENGTH, GRAVITY = 1.0, 0.2, 0.5, 9.81
FIRST, SECOND = 0.05, 0.02  # s, of two phases
STEPS = (16, 30)
PUSH, PLACE = 2.5, 0.25  # N, of the second phase; m, of the first


def balance_of(q_next: Any, q: Any, q_prev: Any, dt: float) -> ca.MX:
    """(2,) N and N m: Newton's law of cart and pole, projected on the coordinates."""

    def places(q: Any) -> Any:
        return ca.vertcat(q[0], 0.0, q[0] + LENGTH * ca.sin(q[1]), LENGTH * ca.cos(q[1]))

    mass = ca.vertcat(CART, CART, POLE, POLE)
    acceleration = (places(q_next) - 2.0 * places(q) + places(q_prev)) / dt**2
    weight = ca.vertcat(0.0, GRAVITY, 0.0, GRAVITY)
    slopes = ca.vertcat(
        *(
            ca.horzcat(*row)
            for row in (
                (1.0, 0.0),
                (0.0, 0.0),
                (1.0, LENGTH * ca.cos(q_next[1])),
                (0.0, -LENGTH * ca.sin(q_next[1])),
            )
        )
    )
    return slopes.T @ (mass * (acceleration + weight))


def two_phases(cart_pole: Any) -> Any:
    """The pole is caught in a first phase on a short rail and held in a second one with a weak
    motor, finer steps and other terms."""
    first = octo.Problem(
        cart_pole,
        steps=STEPS[0],
        dt=FIRST,
        x0=np.array([0.0, 0.35]),
        v0=np.array([0.1, -0.3]),
        costs=[
            octo.CustomCost(lambda step, p: step.x_next[1], name="Angle"),
            octo.Effort(weight=1e-2, reference=1.0),
        ],
        constraints=[
            octo.CustomConstraint(
                lambda step, p: step.x_next[0], lower=-PLACE, upper=PLACE, name="Rail"
            )
        ],
    )
    second = octo.Problem(
        cart_pole,
        steps=STEPS[1],
        dt=SECOND,
        x_end=np.array([0.1, 0.0]),
        costs=[octo.Effort(weight=3e-2, reference=1.0)],
        constraints=[octo.TorqueLimits(limit=PUSH)],
    )
    return octo.phases([first, second])


def by_ipopt() -> tuple[float, np.ndarray]:
    """E and x_0 … x_N of the same, written down anew: no octo in it."""
    opti, count = ca.Opti(), sum(STEPS)
    x = opti.variable(2, count + 1)
    begin = ca.DM([0.0, 0.35])
    opti.subject_to(x[:, 0] == begin)
    duration = STEPS[0] * FIRST + STEPS[1] * SECOND
    energy = ca.MX(0.0)
    for i in range(count):
        early = i < STEPS[0]
        dt = FIRST if early else SECOND
        if i == 0:
            before = begin - FIRST * ca.DM([0.1, -0.3])
        elif i == STEPS[0]:  # the same velocity, over the other dt
            before = x[:, i] - dt / FIRST * (x[:, i] - x[:, i - 1])
        else:
            before = x[:, i - 1]
        force = balance_of(x[:, i + 1], x[:, i], before, dt)
        opti.subject_to(force[1] == 0.0)
        share = dt / duration  # of the phase over its steps
        if early:
            energy += share * (x[1, i + 1] ** 2 + 1e-2 * force[0] ** 2)
            opti.subject_to(opti.bounded(-PLACE, x[0, i + 1], PLACE))
        else:
            energy += share * 3e-2 * force[0] ** 2
            opti.subject_to(opti.bounded(-PUSH, force[0], PUSH))
    opti.subject_to(x[:, count] == ca.DM([0.1, 0.0]))
    opti.subject_to(x[:, count - 1] == x[:, count])
    opti.minimize(energy)
    opti.set_initial(x, ca.repmat(begin, 1, count + 1))
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.tol": 1e-12}
    opti.solver("ipopt", {**quiet, "ipopt.sb": "yes"})
    found = opti.solve()
    return float(found.value(energy)), np.asarray(found.value(x)).T


def test_the_optimum_is_that_of_ipopt(cart_pole):
    found = octo.solve(
        two_phases(cart_pole), options=octo.SqpOptions(tolerance=1e-10, dual_tolerance=1e-9)
    )
    energy, x = by_ipopt()
    assert found.converged
    assert found.energy == pytest.approx(energy, rel=1e-6)
    np.testing.assert_allclose(found.x[1:], x, atol=1e-4)
    # both kinds of bounds are active
    assert np.abs(found.phases[0].x[2:, 0]).max() == pytest.approx(PLACE, abs=1e-5)
    assert np.abs(found.phases[1].u).max() == pytest.approx(PUSH, abs=1e-3)
    names = [bound.name for bound in found.bounds]
    assert names == ["Rail (phase 0)", "TorqueLimits (phase 1)"]
    assert all(bound.held for bound in found.bounds)
    last = found.bounds[1]
    assert STEPS[0] <= last.step < sum(STEPS)
    assert last.time == pytest.approx(found.times[last.step + 1])


def test_a_divided_problem_has_the_optimum_of_the_whole(swing_up, turning):
    """Means over all steps in every phase, so that E is the same; the fixed end is the last
    one's."""
    whole = octo.solve(swing_up(), start=turning)
    ends = dict.fromkeys(("x_end", "v_end"))
    count = whole.steps
    first = swing_up(steps=count // 2, **ends)
    middle = swing_up(steps=7, x0=None, **ends)
    last = swing_up(steps=count - count // 2 - 7, x0=None)
    found = octo.solve(octo.phases([first, middle, last]), start=turning)
    assert whole.converged and found.converged
    assert found.energy == pytest.approx(whole.energy, rel=1e-10)
    np.testing.assert_allclose(found.x, whole.x, atol=1e-8)
    np.testing.assert_allclose(found.u, whole.u, atol=1e-6)
    assert found.terms == pytest.approx(whole.terms, rel=1e-8)
    assert found.iterations == whole.iterations


def test_position_and_velocity_go_on_through_the_joint(cart_pole):
    found = octo.solve(two_phases(cart_pole))
    one, two = found.phases
    np.testing.assert_array_equal(two.x[1], one.x[-1])
    np.testing.assert_allclose(two.v[0], one.v[-1], rtol=1e-9)
    np.testing.assert_array_equal(found.x, np.concatenate([one.x, two.x[2:]]))
    np.testing.assert_array_equal(found.u, np.concatenate([one.u, two.u]))
    np.testing.assert_allclose(
        found.times, np.concatenate([one.times, one.times[-1] + two.times[1:]])
    )
    own = [np.full(phase.steps, phase.dt) for phase in found.phases]
    np.testing.assert_array_equal(found.intervals, np.concatenate(own))  # one of each row of u
    assert one.intervals.shape == (one.steps,)
    np.testing.assert_allclose(found.v, np.concatenate([one.v, two.v[1:]]), rtol=1e-9, atol=1e-12)
    assert found.energy == pytest.approx(one.energy + two.energy, rel=1e-12)


def test_a_batch_and_a_warm_start(cart_pole):
    phases = two_phases(cart_pole)
    weaker = octo.phases(
        [
            phases.problems[0],
            phases.problems[1].replace(
                basis="nodes", constraints=[octo.TorqueLimits(limit=0.8 * PUSH)]
            ),
        ]
    )
    both = octo.solve([phases, weaker])
    alone = octo.solve(weaker)
    np.testing.assert_array_equal(both[1].x, alone.x)
    assert both[0].energy < both[1].energy
    again = octo.solve(phases, start=both[0])
    assert again.converged and again.iterations < both[0].iterations
    coarse = octo.solve(phases, start=both[0].x[1::2])  # resampled over the whole
    assert coarse.energy == pytest.approx(both[0].energy, rel=1e-6)


def test_no_gpu_takes_phases(cart_pole, monkeypatch):
    from octo.gpu.backend import DeviceBackend
    from octo.problem.phased import PhasedProblem

    backend = object.__new__(DeviceBackend)
    with pytest.raises(DeviceError, match="phases are not solved on a GPU"):
        backend.place(PhasedProblem([two_phases(cart_pole)]))


# -- a robot ---------------------------------------------------------------------------------------


def onto_ice(steps: int = 24) -> Any:
    """A mammal steps from ground with the usual friction onto one that hardly has any."""
    robot = octo.gallery.mammal()
    ground = octo.Problem(
        robot, steps=steps, dt=0.03, costs=octo.costs.robot(0.3), law=Smooth(friction=Coulomb(0.8))
    )
    ice = Smooth(friction=Coulomb(0.2))
    return octo.phases([ground, ground.replace(steps=steps, dt=0.025, law=ice)])


@pytest.mark.slow
def test_contact_laws_grow_stiff_together_and_forces_keep_to_their_ground():
    found = octo.solve(onto_ice(), passes=2)
    assert found.converged and len(found.passes) == 2
    one, two = found.phases
    assert one.friction_use > 0.25 > 0.2 >= two.friction_use - 1e-9
    assert one.parameters["contact.w_perp"] == two.parameters["contact.w_perp"] > 3e4
    assert (one.parameters["contact.mu"], two.parameters["contact.mu"]) == (0.8, 0.2)
    np.testing.assert_array_equal(
        found.contact_force, np.concatenate([one.contact_force, two.contact_force])
    )
    assert found.gait is not None and found.penetration < 0.02


def test_a_phase_whose_stiffness_is_given_stays_as_it_is():
    phases = onto_ice(8)
    own = phases.problems[1].replace(basis="nodes", parameters={"contact.w_perp": 5e4})
    found = octo.solve(octo.phases([phases.problems[0], own]), passes=2, max_iterations=60)
    assert found.phases[1].parameters["contact.w_perp"] == 5e4
    assert found.phases[0].parameters["contact.w_perp"] != 5e4


# -- what comes out --------------------------------------------------------------------------------


def test_the_file_has_the_phases(cart_pole, tmp_path):
    found = octo.solve(two_phases(cart_pole))
    found.save(tmp_path / "both.npz")
    again = octo.Solution.load(tmp_path / "both.npz")
    assert str(again) == str(found) and len(again.phases) == 2
    for one, other in zip((found, *found.phases), (again, *again.phases), strict=True):
        for field in dataclasses.fields(one):
            before, after = getattr(one, field.name), getattr(other, field.name)
            if isinstance(before, np.ndarray):
                np.testing.assert_array_equal(before, after)
            elif field.name in ("terms", "bounds", "residuals", "status", "dt"):
                assert before == after
    found.to_csv(tmp_path / "both.csv")
    times = np.loadtxt(tmp_path / "both.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_allclose(times, found.times, rtol=1e-9)


def test_a_file_whose_phases_are_not_of_its_motion_is_refused(cart_pole, tmp_path):
    found = octo.solve(two_phases(cart_pole))
    shorter = dataclasses.replace(found, phases=found.phases[:1])
    shorter.save(tmp_path / "short.npz")
    with pytest.raises(OctoError, match="phases have 16 steps, must have 46 as x has"):
        octo.Solution.load(tmp_path / "short.npz")


def test_in_words(cart_pole):
    found = octo.solve(two_phases(cart_pole))
    said = str(found)
    assert said.startswith("custom, 46 steps of 0.02 to 0.05 s in 2 phases (nodes): converged")
    assert f"  phase 1: 30 steps of 0.02 s, E = {found.phases[1].energy:.5g} (Effort" in said
    report = found.report()
    assert [part["steps"] for part in report["phases"]] == [16, 30]
    assert "Rail (phase 0) held" in str(found.explain())
