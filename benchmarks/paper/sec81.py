"""Section 8.1, how good the force model is: a block on a slope, which has analytic answers.

Eq. 6 creeps at tan(slope)·w_perp/w_par and sinks by √(load/w_perp); regularised Coulomb friction
creeps at creep·tan/√(mu² − tan²) where dry friction holds, and accelerates as dry friction does,
by g(sin − mu cos), where that slides.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import octo
from benchmarks.paper.page import Row, number
from octo.checks import Array
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.static_pose import static_pose
from octo.model.body import Body, ContactSphere, floating_base
from octo.model.quantities import GRAVITY

TITLE = "Accuracy of the force model (section 8.1)"
PANELS = 2
MASS, RADIUS = 2.0, 0.01  # kg, m
MU, CREEP = 0.8, 0.2  # of octo.laws.Coulomb, m/s
HELD, SLIDING = 0.25, 0.8  # rad: dry friction of MU holds on the first and slides on the second
PRINTED = (3e3, 1e4, 1e5)  # w_perp = w_par of the three passes of Fig. 7
STIFF = (3e2, 1e3, *PRINTED, 1e6)  # N/m²
RATIOS = (1.0, 10.0, 150.0)  # s/m, w_par/w_perp: as printed, octo's first and last pass
DT = 0.025  # s


def block() -> octo.Character:
    """2 kg, 40 × 20 cm, on four spheres of 1 cm."""
    corners = [(0.2 * a, 0.1 * b, -0.02) for a in (1, -1) for b in (1, -1)]
    feet = tuple(ContactSphere(f"{k}", 0, np.array(c), RADIUS) for k, c in enumerate(corners))
    sides = np.diag([0.2**2 + 0.06**2, 0.4**2 + 0.06**2, 0.4**2 + 0.2**2])
    body = Body("block", -1, floating_base(), mass=MASS, inertia=MASS / 12.0 * sides)
    return octo.Character("block", (body,), feet)


def slide(law: Any, slope: float, seconds: float) -> dict[str, Any]:
    """Let go from rest: its speed down the slope, m/s, and the depth of its corners, m."""
    robot, plane = block(), octo.Plane(slope=slope)
    dynamics = RobotDynamics(robot, law, plane)
    start = static_pose(dynamics, dynamics.layout.pack())
    motion = octo.simulate(robot, start, seconds=seconds, dt=DT, terrain=plane, law=law)
    if not motion.converged.all():
        raise ArithmeticError(f"the block on a slope of {slope} rad was not simulated: {law}")
    centers = octo.kinematics.sphere_centers(robot, motion.x[-1:])[0]
    normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    downhill = np.array([-np.cos(slope), 0.0, -np.sin(slope)])
    return {
        "speed": motion.velocity[:, :3] @ downhill,
        "distance": float((motion.x[-1, :3] - start[:3]) @ downhill),
        "depth": float(np.mean(RADIUS - centers @ normal)),
    }


def viscous(w: float, ratio: float) -> octo.laws.Smooth:
    """Eq. 6 as printed, without a smoothed onset."""
    return octo.laws.Smooth(w, 0.0, octo.laws.Viscous(ratio * w))


def coulomb() -> octo.laws.Smooth:
    """Eq. 6's normal force with regularised Coulomb friction."""
    return octo.laws.Smooth(PRINTED[1], 0.0, octo.laws.Coulomb(MU, CREEP))


def measure(short: bool) -> dict[str, Any]:
    """Speeds and depths, each beside its analytic answer."""
    seconds = 2.0 if short else 10.0
    tan, steep = np.tan(HELD), np.tan(SLIDING)
    creeps = []
    for w, ratio in [*((w, 1.0) for w in PRINTED), *((PRINTED[1], r) for r in RATIOS[1:])]:
        found = slide(viscous(w, ratio), HELD, seconds)
        own = {"w": w, "ratio": ratio, "speed": float(found["speed"][-1])}
        creeps.append({**own, "analytic": tan / ratio, "distance": found["distance"]})
    depths = [
        {
            "w": w,
            "depth": slide(viscous(w, 1.0), 0.0, 1.0)["depth"],
            "analytic": float(np.sqrt(MASS * GRAVITY / (4.0 * w))),
        }
        for w in STIFF
    ]
    held, fast = slide(coulomb(), HELD, seconds), slide(coulomb(), SLIDING, seconds)
    still = slide(viscous(PRINTED[1], 1.0), SLIDING, seconds)
    late = len(fast["speed"]) // 2
    return {
        "seconds": seconds,
        "creep": creeps,
        "depth": depths,
        "coulomb": {
            "speed": float(held["speed"][-1]),
            "analytic": float(CREEP * tan / np.sqrt(MU**2 - tan**2)),
            "acceleration": float(np.diff(fast["speed"][late:]).mean() / DT),
            "dry": float(GRAVITY * (np.sin(SLIDING) - MU * np.cos(SLIDING))),
            "speeds": _curve(fast["speed"]),
        },
        "steep": {
            "speed": float(still["speed"][-1]),
            "analytic": float(steep),
            "speeds": _curve(still["speed"]),
        },
    }


def _curve(values: Array) -> list[float]:
    """Of the first two seconds."""
    return [float(f"{value:.5g}") for value in values[: int(2.0 / DT) + 1]]


def draw(records: dict[str, Any], axes: Any) -> None:
    """Depth against w, and speed on a slope on which dry friction slides."""
    left, right = axes
    stiff = [one["w"] for one in records["depth"]]
    left.loglog(stiff, [1e3 * one["depth"] for one in records["depth"]], "o", label="simulated")
    left.loglog(stiff, [1e3 * one["analytic"] for one in records["depth"]], label="√(mg/4w)")
    left.set(xlabel="w⊥ (N/m²)", ylabel="depth of a corner (mm)")
    times = DT * np.arange(len(records["steep"]["speeds"]))
    right.plot(times, records["steep"]["speeds"], label="Eq. 6, w∥ = w⊥")
    right.plot(times, records["coulomb"]["speeds"], label=f"Coulomb, μ {MU}")
    right.plot(times, records["coulomb"]["dry"] * times, "k:", label=f"dry friction, μ {MU}")
    right.set(xlabel=f"s, on a slope of {SLIDING} rad", ylabel="speed (m/s)")


def rows(records: dict[str, Any]) -> list[Row]:
    """Each with its analytic answer."""
    creep, steep, other = records["creep"], records["steep"], records["coulomb"]
    printed, stiffest, last = creep[0], creep[len(PRINTED) - 1], creep[-1]
    first, third = records["depth"][-1 - len(PRINTED)], records["depth"][-2]
    said = "“the lack of static/sliding friction mode switch”"

    def speed(one: dict[str, Any]) -> str:
        return f"{number(one['speed'], 3)} m/s, analytic {number(one['analytic'], 3)}"

    return [
        Row(
            f"drift on a slope of {HELD} rad, w∥ = w⊥ = {number(printed['w'])}",
            said,
            f"{speed(printed)}; {number(printed['distance'])} m in {records['seconds']:.0f} s",
            f"dry friction holds for μ > {number(printed['analytic'])}",
        ),
        Row(
            f"the same, w∥ = w⊥ = {number(stiffest['w'])}",
            "“as w⊥, w∥ → ∞, our model coincides with the dry frictional model with an infinite "
            "frictional coefficient”",
            speed(stiffest),
            "only where w∥/w⊥ grows: the drift is tan(slope)·w⊥/w∥",
        ),
        Row(
            f"the same, w∥ = {number(last['ratio'], 3)} w⊥",
            "“setting w∥ to be a large constant”",
            speed(last),
            "the ratio of octo's last pass",
        ),
        Row(
            "the same with `octo.laws.Coulomb`",
            "–",
            speed(other),
            f"μ {MU}, creep speed {CREEP} m/s; less with a smaller one",
        ),
        Row(
            f"a slope of {SLIDING} rad, w∥ = w⊥",
            said,
            speed(steep),
            "Eq. 6 never slides: dry friction of this μ accelerates",
        ),
        Row(
            "the same with `octo.laws.Coulomb`",
            "–",
            f"{number(other['acceleration'], 3)} m/s², dry friction {number(other['dry'], 3)}",
            "slides as dry friction does",
        ),
        Row(
            f"depth of a corner, w⊥ = {number(first['w'])} and {number(third['w'])}",
            "“refine the result to minimize penetrations”",
            f"{number(1e3 * first['depth'])} and {number(1e3 * third['depth'])} mm, analytic "
            f"{number(1e3 * first['analytic'])} and {number(1e3 * third['analytic'])}",
            "√(load/w⊥): a hundred times stiffer, a tenth as deep",
        ),
    ]
