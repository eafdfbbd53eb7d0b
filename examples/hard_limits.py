"""Limits that hold: a cart on a short rail swings its pole up with a motor of bounded force.

What is in ``constraints`` must hold at every step, whatever it costs; a term of ``costs`` is paid
for. The weaker the motor, the more effort a swing-up takes. ``--short`` tries two motors instead
of five.
"""

import sys

import casadi as ca
import numpy as np

import octo

SHORT = "--short" in sys.argv
STEPS, DT = 60, 0.05
RAIL, FASTEST = 0.4, 3.0  # m to each side, m/s


def dynamics(x_next, x, x_prev, p):
    """(2,) N and N m of the cart's place and the pole's angle (0 hangs, π stands)."""
    a, angle = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2, x_next[1]
    rate, moment = (x_next[1] - x[1]) / p["dt"], p["pole"] * p["length"]
    push = (p["cart"] + p["pole"]) * a[0]
    push += moment * (ca.cos(angle) * a[1] - ca.sin(angle) * rate**2)
    turn = moment * (ca.cos(angle) * a[0] + p["length"] * a[1] + 9.81 * ca.sin(angle))
    return ca.vertcat(push, turn)


cart_pole = octo.CustomDynamics(
    dynamics, nx=2, actuated=[0], parameters={"cart": 1.0, "pole": 0.3, "length": 0.5}
)


def on_the_rail(step, p):
    """The cart's place, in parts of the rail: rows of about one suit a solver's tolerance."""
    return step.x_next[0] / RAIL


def swing_up(force):
    """The swing-up in three seconds with at most ``force`` N."""
    return octo.Problem(
        cart_pole,
        steps=STEPS,
        dt=DT,
        x0=np.zeros(2),
        x_end=np.array([0.0, np.pi]),
        v_end=np.zeros(2),
        costs=[octo.Effort(weight=0.1, reference=1.0)],
        constraints=[
            octo.TorqueLimits(limit=force),
            octo.JointSpeedLimits(limit=FASTEST),
            octo.StepLimit(largest=[np.inf, 0.8]),  # rad: the pole turns, it does not leap
            octo.CustomConstraint(on_the_rail, lower=-1.0, upper=1.0, name="Rail"),
        ],
    )


forces = (20.0, 12.0) if SHORT else (20.0, 15.0, 12.0, 11.0, 10.0)
motions = octo.solve([swing_up(force) for force in forces])
print(f"{'limit':>6}{'largest':>9}{'rail':>7}{'speed':>7}{'turn':>6}{'effort':>9}  iterations")
for force, motion in zip(forces, motions, strict=True):
    place, step = motion.x[1:, 0], np.abs(np.diff(motion.x[1:], axis=0))
    found = np.abs(motion.u).max(), np.abs(place).max(), step[:, 0].max() / DT, step[:, 1].max()
    print(
        f"{force:4.0f} N{found[0]:7.2f} N{found[1]:5.2f} m{found[2]:7.2f}{found[3]:6.2f}"
        f"{motion.energy:9.4f}  {motion.iterations}"
    )
    assert motion.converged
    assert (np.array(found) <= np.array([force, RAIL, FASTEST, 0.8]) * (1 + 1e-6)).all()

print(f"\nWhat came nearest to its bound with {forces[-1]:g} N:")
for bound in motions[-1].bounds:
    print(f"  {bound}")
    assert bound.held
# a weaker motor never pays less for the same way
efforts = [motion.energy for motion in motions]
assert all(b >= a * (1 - 1e-4) for a, b in zip(efforts, efforts[1:], strict=False)), efforts
