"""As fast as it goes: a cart swings its pole up in the shortest time that its motor allows.

``duration`` makes the time step an unknown, ``octo.Duration`` is its price. A strong motor swings
the pole up at once; a weak one has to swing it back first. ``--short`` tries two motors instead of
five.
"""

import sys

import casadi as ca
import numpy as np

import octo

SHORT = "--short" in sys.argv
STEPS = 60


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


def swing_up(force):
    """The fastest swing-up with at most ``force`` N; the search begins at 1.5 s."""
    return octo.Problem(
        cart_pole,
        steps=STEPS,
        dt=1.5 / STEPS,
        duration=(0.5, 6.0),
        x0=np.zeros(2),
        x_end=np.array([0.0, np.pi]),
        v_end=np.zeros(2),
        costs=[octo.Duration()],
        constraints=[octo.TorqueLimits(limit=force)],
    )


forces = (30.0, 15.0) if SHORT else (30.0, 20.0, 15.0, 12.0, 9.0)
motions = octo.solve([swing_up(force) for force in forces], seeds=4)  # fast ways are many
print(f"{'limit':>6}{'time':>9}{'at the limit':>14}  swings back")
for force, motion in zip(forces, motions, strict=True):
    assert motion.converged
    at_limit = (np.abs(motion.u) > 0.99 * force).mean()
    angle = motion.x[1:, 1]
    print(
        f"{force:4.0f} N{STEPS * motion.dt:7.3f} s{at_limit:13.0%}{np.rad2deg(-angle.min()):10.0f}°"
    )
    assert np.abs(motion.u).max() <= force * (1 + 1e-6)
# a weaker motor is never faster
times = [motion.dt for motion in motions]
assert all(slow >= fast * (1 - 1e-6) for fast, slow in zip(times, times[1:], strict=False)), times
