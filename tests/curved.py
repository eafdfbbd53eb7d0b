"""Problems with terms whose residuals bend."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from extending.contact_pair import EqualLoads
from extending.pseudo_huber import PseudoHuber
from walker import BASES, START, walker

import octo

STEPS, DT = 12, 0.05


def _swing(x_next: ca.SX, x: ca.SX, x_prev: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """(2,) N and N m of a cart's place and its pole's angle."""

    def places(q: ca.SX) -> ca.SX:
        return ca.vertcat(q[0], q[0] + ca.sin(q[1]), ca.cos(q[1]))

    force = (places(x_next) - 2 * places(x) + places(x_prev)) / p["dt"] ** 2 + ca.DM([0, 0, 9.81])
    return ca.jtimes(places(x_next), x_next, force, True)


def _coupled(step: octo.costs.StepSymbols, p: dict[str, ca.SX]) -> ca.SX:
    """The centre of mass, torques and coordinates in one product."""
    return ca.vertcat(
        step.com[0] * step.u[0] * step.com_velocity[1],
        step.com_velocity[2] ** 2 + step.u[0] * step.u[1] + step.x_prev[6] * step.u[0],
    )


def _bent(control: ca.SX, following: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    return ca.vertcat(ca.sin(following[0]) * control[1], following[1] ** 2 - control[0])


LOSSES = [
    octo.JointVelocity(0.4, loss=PseudoHuber(0.2)),
    octo.JointAcceleration(loss=octo.Huber(3.0)),
    octo.Effort(loss=PseudoHuber(0.05)),
    octo.Slip(length=0.03, loss=PseudoHuber(0.02)),
    EqualLoads(pair=("foot", "front"), weight=2.0, loss=PseudoHuber(0.1)),
    octo.NeighbourCost(_bent, loss=PseudoHuber(0.1)),
    octo.CustomCost(_coupled),
]
CYCLES = {
    "mirrored": octo.Cycle(speed=0.4, period=0.4),
    "turning": octo.Cycle(speed=0.4, period=0.4, mirror=False, turn=0.4),
}
NAMES = [
    *("nodes", "hermite", "pinned", "losses, nodes", "losses, hermite"),
    *("biped, mirrored", "biped, turning", "cart-pole, nodes", "cart-pole, hermite"),
]


def described(name: str, every: Sequence[octo.Cost]) -> octo.Problem:
    """Terms, and losses, bases, fixed ends, cycles, user-written dynamics; ``every``: the terms of
    those named after a basis alone."""
    kind, basis = name.split(", ") if ", " in name else ("terms", name)
    if kind == "biped":
        terms = [octo.CenterOfMassVelocity((0.4, 0.0, 0.1)), octo.BaseOrientation(), octo.Slip()]
        return octo.Problem(octo.gallery.biped(), steps=8, costs=terms, cycle=CYCLES[basis])
    if kind == "cart-pole":
        dynamics = octo.CustomDynamics(_swing, nx=2, actuated=[0], parameters={})
        bent = octo.CustomCost(lambda s, p: ca.vertcat(ca.sin(s.x_next[1]), s.u * s.x[0]))
        terms = [bent, octo.Effort(loss=octo.Huber()), octo.NeighbourCost(_bent)]
        start = np.array([0.1, 0.3])
        return octo.Problem(dynamics, steps=20, dt=DT, costs=terms, x0=start, basis=basis)
    terms = LOSSES if kind == "losses" else every
    ends = {"x_end": START + 0.01, "v_end": 0.1 * np.ones(9)} if basis == "pinned" else {}
    return octo.Problem(
        walker(),
        steps=STEPS,
        dt=DT,
        costs=terms,
        basis=BASES["hermite" if basis == "pinned" else basis],
        x0=START,
        v0=0.2 * np.ones(9),
        parameters={"contact.onset": 0.004},
        **ends,
    )
