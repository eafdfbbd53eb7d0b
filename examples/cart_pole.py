"""User-written implicit dynamics in place of a robot: a cart balances its pole, then swings it up.

The dynamics are FD(x_next, x, x_prev, p) = (u, 0): Newton's law at the two masses, their
accelerations as differences of three positions (Eq. 4), projected on the coordinates. ``--short``
solves with fewer steps.
"""

import sys

import casadi as ca
import numpy as np

import octo

SHORT = "--short" in sys.argv
DT = 0.05


def dynamics(x_next, x, x_prev, p):
    """(2,) N and N m of the cart's place and the pole's angle (0 is up)."""

    def places(q):
        return ca.vertcat(q[0], 0.0, q[0] + p["length"] * ca.sin(q[1]), p["length"] * ca.cos(q[1]))

    mass = ca.vertcat(p["cart"], p["cart"], p["pole"], p["pole"])
    acceleration = (places(x_next) - 2.0 * places(x) + places(x_prev)) / p["dt"] ** 2
    gravity = ca.vertcat(0.0, 9.81, 0.0, 9.81)
    return ca.jtimes(places(x_next), x_next, mass * (acceleration + gravity), True)


cart_pole = octo.CustomDynamics(
    dynamics, nx=2, actuated=[0], parameters={"cart": 1.0, "pole": 0.2, "length": 0.5}
)


def near(target, weight):
    """A term that keeps the state near ``target``."""
    return octo.CustomCost(
        lambda step, p: step.x_next - p["target"], {"target": target}, weight=weight, name="near"
    )


balance = octo.Problem(
    cart_pole,
    steps=20 if SHORT else 80,
    dt=DT,
    x0=np.array([0.0, 0.3]),
    costs=[near(np.zeros(2), 1.0), octo.Effort(weight=1e-3)],
)
balanced = octo.solve(balance)
print(balanced)
assert balanced.converged and np.abs(balanced.x[-1]).max() < 0.1

swing_up = octo.Problem(
    cart_pole,
    steps=40 if SHORT else 60,
    dt=DT,
    x0=np.array([0.0, np.pi]),
    x_end=np.zeros(2),
    v_end=np.zeros(2),
    costs=[
        octo.Effort(weight=1e-2),
        octo.CustomCost(function=lambda step, p: step.x_next[0], name="place"),
    ],
)
# a start that hangs still would never see the other side
turning = np.linspace([0.0, np.pi], [0.0, 0.0], swing_up.steps + 1)
swung = octo.solve(swing_up, start=turning)
print(swung)
print(f"largest force {np.abs(swung.u).max():.1f} N, the cart moves {np.ptp(swung.x[:, 0]):.2f} m")
assert swung.converged and np.allclose(swung.x[-1], 0.0)
