"""The figures of a gait, on loads, torques and joint angles whose figures are known beforehand."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

import octo
from octo.errors import ValueRangeError
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.model.feet import runs, stances
from octo.result.gait import Gait, high_share, measure_gait, rhythm
from octo.result.solution import Solution

DT, WEIGHT = 0.025, 100.0


def walker() -> Character:
    """A body with two spheres, a hinge and a rail."""
    y = np.array([0.0, 1.0, 0.0])
    hip = Joint("hip", "hinge", y, lower=-1.0, upper=0.5, torque_limit=4.0, velocity_limit=10.0)
    rail = Joint("rail", "slide", y, velocity_limit=0.5)
    body = {"mass": 1.0, "inertia": 0.01 * np.eye(3)}
    bodies = (Body("trunk", -1, floating_base(), **body), Body("leg", 0, (hip, rail), **body))
    spheres = tuple(ContactSphere(name, 1, np.zeros(3), 0.02) for name in ("left", "right"))
    return Character("walker", bodies, spheres)


def motion(force: np.ndarray, height: np.ndarray | float = 0.0, **changes) -> Solution:
    """A motion whose feet carry ``force`` (N, 2) N at ``height`` m; friction is a fifth of it."""
    steps = len(force)
    vectors = np.zeros((steps, 2, 3))
    up = vectors + [0.0, 0.0, 1.0]
    fields = {
        "name": "walker",
        "character": walker(),
        "dt": DT,
        "basis": "nodes",
        "x": np.zeros((steps + 2, 8)),
        "u": np.zeros((steps, 2)),
        "weight": WEIGHT,
        "length": 0.3,
        "torque_limit": walker().torque_limit,
        "contact_names": ("left", "right"),
        "contact_force": force[..., None] * [0.2, 0.0, 1.0],
        "contact_point": vectors,
        "contact_velocity": vectors,
        "contact_normal": up,
        "contact_depth": -height * np.ones((steps, 2)),
        "status": octo.Status.CONVERGED,
    }
    unused = {name: np.zeros(0) for name in ("unknowns", "multipliers")}
    unused |= {name: {} for name in ("terms", "ground", "history", "parameters")}
    unused |= dict.fromkeys(("iterations", "factorizations", "seconds", "setup_seconds"), 0)
    unused |= dict.fromkeys(("violation", "pointwise_residual"), 0.0)
    return Solution(**{**fields, **unused, **changes})


def trot(
    seconds: float = 8.0, stance: float = 0.5, swing: float = 0.3, load: float = 60.0
) -> np.ndarray:
    """(N, 2) N: square waves of two feet, half a stride apart."""
    period, standing = round((stance + swing) / DT), round(stance / DT)
    row = np.arange(round(seconds / DT))[:, None] + [0, period // 2]
    return np.where(row % period < standing, load, 0.0)


def gait(*words, **changes) -> Gait:
    found = motion(*words, **changes).gait
    assert found is not None
    return found


def feet(force: np.ndarray, x: np.ndarray, **changes) -> Solution:
    """The motion of a body for each of two spheres, which are x (N, 2) m ahead."""
    own = walker()
    leg = own.bodies[1]
    bodies = (own.bodies[0], leg, dataclasses.replace(leg, name="other", joints=()))
    spheres = tuple(dataclasses.replace(c, body=1 + k) for k, c in enumerate(own.contacts))
    robot = dataclasses.replace(own, bodies=bodies, contacts=spheres)
    place = x[..., None] * [1.0, 0.0, 0.0]
    return motion(force, character=robot, contact_point=place, **changes)


def test_footfalls():
    """Steps of 0.8 s and 0.4 m, then one foot alone: three whole stances, one of them late."""
    force = trot(4.0)
    x = 0.5 * DT * np.arange(len(force))[:, None] * np.ones(2)
    left, right = feet(force, x).footfalls
    assert (left.foot, right.foot) == ("leg", "other")
    np.testing.assert_allclose(left.begins, [0.8, 1.6, 2.4, 3.2])
    np.testing.assert_allclose(left.ends - left.begins, 0.5)
    for own in (left, right):
        np.testing.assert_allclose(own.periods, 0.8)
        np.testing.assert_allclose(own.lengths, 0.4)
        np.testing.assert_allclose(own.unevenness, 0.0, atol=1e-12)
    late = np.zeros((120, 2))
    for begin in (8, 40, 88):  # periods of 0.8 s and 1.2 s
        late[begin : begin + 16, 0] = 60.0
    (alone,) = feet(late, 0.5 * DT * np.arange(120)[:, None] * np.ones(2)).footfalls
    np.testing.assert_allclose(alone.periods, [0.8, 1.2])
    np.testing.assert_allclose(alone.unevenness, [0.2, 0.2])
    assert feet(late[:80], x[:80]).footfalls[0].unevenness is None


def test_heel_and_toe_are_one_foot():
    force = trot(4.0)
    (foot,) = motion(force).footfalls
    assert foot.foot == "leg" and len(foot.periods) == 0  # one of the two always stands


def test_square_waves():
    force = trot()
    rise = np.where(force > 0.0, 0.0, 0.02)
    rise[100:140] *= 3.0  # two of the twenty swings are higher: the median does not see them
    found = gait(force, rise)
    assert found.touchdowns == pytest.approx(10 / 8.0)  # of the foot that starts in the air
    assert (found.shortest_stance, found.shortest_swing) == (pytest.approx(0.5), pytest.approx(0.3))
    assert (found.median_swing, found.clearance) == (pytest.approx(0.3), pytest.approx(0.02))
    assert found.rhythm == pytest.approx(1.0)
    assert found.friction_use == pytest.approx(0.2)


def test_clearance_is_the_height_of_a_swing_not_of_a_stance():
    force = trot()
    assert gait(force, np.where(force > 0.0, 0.5, -0.001)).clearance == pytest.approx(-0.001)


def test_chatter_is_counted_and_a_wavering_load_is_not():
    steady = trot(stance=0.5, swing=0.3)
    wavering, chattering = steady.copy(), steady.copy()
    wavering[10, 0] = 2.0  # above 1 % of mg: the stance goes on
    chattering[10, 0] = 0.5
    expected, same, found = gait(steady), gait(wavering), gait(chattering)
    assert same.touchdowns == expected.touchdowns and same.shortest_swing == expected.shortest_swing
    assert found.touchdowns == pytest.approx(expected.touchdowns)  # the other foot still has most
    assert found.shortest_swing == pytest.approx(DT) and found.median_swing == expected.median_swing
    chattering[30:300:2] = 0.0
    found = gait(chattering)
    assert found.touchdowns > 8.0
    assert found.shortest_stance == found.shortest_swing == pytest.approx(DT)


def test_hysteresis():
    force = np.array([[3.0, 4.9, 5.0, 1.0, 0.9, 4.9, 6.0]]).T
    assert stances(force, WEIGHT)[:, 0].tolist() == [False, False, True, True, False, False, True]


def test_runs_begin_and_end_inside():
    on = np.array([1, 0, 1, 1, 0, 0, 1], dtype=bool)
    assert runs(on, 0, 7) == [(2, 4)] and runs(~on, 0, 7) == [(1, 2), (4, 6)]
    assert runs(on, 2, 4) == [(2, 4)] and runs(on, 3, 7) == [] and runs(on, 0, 3) == []


def test_a_window_counts_whole_strides_exactly():
    """What a cyclic motion needs: a stride more before and after changes nothing."""
    force = trot(seconds=4 * 0.8)
    for first in (0.8, 0.9, 1.15):
        found = measure_gait(motion(force), first, first + 1.6)
        assert found is not None and found.touchdowns == pytest.approx(1 / 0.8)
        assert found.rhythm == pytest.approx(1.0)
    whole = measure_gait(motion(force), 0.8, 2.4)
    assert whole is not None and whole.shortest_stance == pytest.approx(0.5)
    left = force * [1.0, 0.0]  # it touches down at 0.8 and at 1.6 s
    ends = ((0.0, 0.8), (0.8, 1.6), (0.825, 1.6), (0.825, 1.625))
    found = [measure_gait(motion(left), *pair).touchdowns for pair in ends]
    assert found == [0.0, pytest.approx(1 / 0.8), 0.0, pytest.approx(1 / 0.8)]


def test_a_window_looks_at_itself_only():
    x = np.zeros((82, 8))
    x[41:, 6] = 0.7  # in step 39, from x_39 to x_40: x[0] is x_{-1}
    u = np.zeros((80, 2))
    u[60] = 2.0
    windows = ((0.0, 0.975), (0.975, 1.5), (1.5, 2.0))
    found = [measure_gait(motion(trot(2.0), x=x, u=u), *ends) for ends in windows]
    assert [part.joint_speed for part in found] == [0.0, pytest.approx(28.0), 0.0]
    assert [part.limit_excess for part in found] == [0.0, pytest.approx(0.2), pytest.approx(0.2)]
    assert [part.torque_use for part in found] == [0.0, 0.0, 0.5]


@pytest.mark.parametrize("ends", [(1.0, 1.0), (2.0, 3.0), (-1.0, 0.01), (math.nan, 1.0)])
def test_a_window_without_a_step_is_refused(ends):
    with pytest.raises(ValueRangeError, match="^first is .* s and last is "):
        measure_gait(motion(trot(2.0)), *ends)


def test_torque_power():
    t = DT * np.arange(400)
    slow, fast = np.sin(2.0 * np.pi * t), np.sin(20.0 * np.pi * t)
    u = np.stack([3.0 + slow, 0.5 * fast], axis=1)
    assert high_share(u, DT) == pytest.approx(0.2)  # 0.25 of 1.25, over the joints together
    assert high_share(np.stack([slow, slow]).T, DT) == pytest.approx(0.0, abs=1e-12)
    assert high_share(fast[:, None], DT) == pytest.approx(1.0)
    nyquist = np.where(np.arange(400) % 2, 1.0, -1.0)  # 20 Hz, of power 1, beside a sine's 1/2
    assert high_share((slow + nyquist)[:, None], DT) == pytest.approx(2.0 / 3.0)
    assert high_share(np.full((400, 1), 0.1), DT) == 0.0
    assert high_share(u, 0.1) is None and high_share(u[:, :0], DT) is None


def test_rhythm():
    random = np.random.default_rng(0)
    noise = 30.0 + 10.0 * random.normal(size=(400, 4))
    assert rhythm(noise, DT, 0.1) < 0.2
    t = DT * np.arange(390)  # no whole number of periods
    wave = 30.0 + 20.0 * np.sin(2.0 * np.pi * t[:, None] / 0.75 + np.arange(4))
    assert rhythm(wave, DT, 0.1) == pytest.approx(1.0)
    blurred = wave + 10.0 * random.normal(size=wave.shape)
    assert 0.5 < rhythm(blurred, DT, 0.1) < 0.8  # 200 of 300 N² repeat
    assert rhythm(np.full((400, 4), 25.0), DT, 0.1) is None
    assert rhythm(wave[:15], DT, 0.1) is None and rhythm(wave[:16], DT, 0.1) is not None
    assert rhythm(wave[:, :0], DT, 0.1) is None


def test_joint_speeds_and_limits():
    x = np.zeros((162, 8))
    t = DT * np.arange(-1, 161)
    x[:, 0] = 20.0 * t  # the base is no joint
    x[:, 6] = 0.9 * np.sin(4.0 * t)
    x[:, 7] = 0.4 * t
    found = gait(trot(4.0), x=x, u=np.full((160, 2), 3.0))
    assert found.joint_speed == pytest.approx(3.6, rel=2e-3)  # rad/s: not the rail's m/s
    assert found.joint_speed_use == pytest.approx(0.8)  # of the rail
    assert found.limit_excess == pytest.approx(0.4, rel=1e-3)
    assert found.torque_use == pytest.approx(0.75)
    free = Character("free", (Body("trunk", -1, floating_base(), mass=1.0, inertia=np.eye(3)),))
    undriven = {"u": np.zeros((160, 0)), "torque_limit": np.zeros(0)}
    found = gait(trot(4.0), character=free, x=x[:, :6], **undriven)
    assert found.joint_speed is found.joint_speed_use is found.torque_high is None
    assert found.limit_excess == 0.0


def test_feet_that_carry_nothing():
    small = np.full((80, 2), 1.9)  # under 2 % of mg
    air = np.zeros((80, 2))
    for force in (small, air):
        found = gait(force)
        assert found.touchdowns is found.shortest_stance is found.clearance is found.rhythm is None
    assert gait(air).friction_use == 0.0 and "no foot carries load" in str(gait(air))
    one = np.stack([np.full(80, 95.0), np.zeros(80)], axis=1)
    found = gait(one)
    assert found.touchdowns == 0.0 and found.shortest_stance is found.median_swing is None
    vectors = ("contact_force", "contact_point", "contact_velocity", "contact_normal")
    none = {name: np.zeros((80, 0, 3)) for name in vectors}
    bare = motion(air, **none, contact_depth=np.zeros((80, 0)), contact_names=())
    assert bare.gait is not None and bare.gait.touchdowns is None
    assert gait(one[:1]).touchdowns == 0.0


def test_report_and_words(tmp_path):
    solution = motion(trot(), 0.021, x=np.linspace(0.0, 8.0, 322)[:, None] * np.eye(8)[6])
    figures = solution.report()["gait"]
    assert set(figures) == {field.name for field in dataclasses.fields(Gait)}
    assert figures["touchdowns"] == pytest.approx(1.25)
    line = [line for line in str(solution).splitlines() if "touchdowns" in line]
    assert line == [
        "  feet: 1.2 touchdowns a second, stance ≥ 0.5 s, swing 0.3 s (≥ 0.3 s), clearance 21 mm; "
        "joints ≤ 1.0 rad/s (0.1 of the limit); rhythm 1.00"
    ]
    solution.save(tmp_path / "trot.npz")
    assert Solution.load(tmp_path / "trot.npz").gait == solution.gait
    broken = dataclasses.replace(solution, u=np.full((320, 2), np.nan), x=np.full((322, 8), np.nan))
    assert json.dumps(broken.report()["gait"], allow_nan=False)


def test_user_written_dynamics_have_no_gait():
    solution = motion(trot(2.0), character=None)
    assert solution.gait is None and solution.report()["gait"] is None
    assert "touchdowns" not in str(solution)
