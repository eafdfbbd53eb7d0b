"""Terms over one contact's height, velocity, force and previous force, mapped over the contacts.

A term's residual is written for one contact; E sums it over the contacts chosen (all that touch the
terrain, or ``contacts`` by name) and averages over the steps. Forces are in units of the weight mg.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import casadi as ca

from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import chosen_contacts
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost
from octo.problem.limits import FrictionCones

if TYPE_CHECKING:
    from octo.problem.symbols import ContactSymbols, Setting

TINY_FORCE = 1e-3  # of the weight; rounds |f_t| off at zero
TINY_LOAD = 1e-6  # of the weight; rounds the root of a load off at zero


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactCost(Cost):
    """A term of E summed over contacts.

    ``contacts``: names, or "feet", those on the ground at the start; by default all that touch the
    terrain, or the feet where a term pulls on what is in the air.
    """

    contacts: tuple[str, ...] | Literal["feet"] | None = None
    of_feet: ClassVar[bool] = False  # by default only contacts that touch the ground at the start

    def chosen(self, robot: Character, feet: Collection[int]) -> set[int]:
        """Indices into the robot's contacts."""
        own = "feet" if self.contacts is None and self.of_feet else self.contacts
        return chosen_contacts(robot, own, feet)

    def hard(self) -> Constraint:
        raise ProblemError(
            f"{self.label} is over contacts and has no hard form, must be octo.FrictionCone or a "
            "term over a step"
        )

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        raise ProblemError(
            f"{self.label}.contact_residual is missing: write contact_residual(self, contact, p)"
        )


@dataclass(frozen=True, eq=False)
class Slip(ContactCost):
    """Tangential velocity (m/s) of a foot near the ground: √(2·sigmoid(−h/length))·v_t."""

    length: float = 0.01  # m

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"inverse_length": self._inverse("length", "m")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        near = 2 / (1 + ca.exp(ca.fmin(contact.height * p["inverse_length"], 50.0)))
        return ca.sqrt(near) * contact.tangential_velocity


@dataclass(frozen=True, eq=False)
class FootLift(ContactCost):
    """Height (m) of a foot above ``height``, squared hinge: feet do not swing higher than they
    need."""

    of_feet: ClassVar[bool] = True
    height: float = 0.02  # m

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"height": self._number("height")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.fmax(0, contact.height - p["height"])


@dataclass(frozen=True, eq=False)
class Clearance(ContactCost):
    """Moving feet stay clear of the ground: v·exp(−h/(2 length)), so that its square is v²
    exp(−h/length)."""

    of_feet: ClassVar[bool] = True
    length: float = 0.02  # m

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"inverse_length": self._inverse("length", "m")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return contact.velocity * ca.exp(ca.fmin(-0.5 * contact.height * p["inverse_length"], 2.0))


@dataclass(frozen=True, eq=False)
class FrictionCone(ContactCost):
    """max(0, |f_t| − ``mu``·f_n)/mg, f_t and f_n the tangential and the normal force."""

    mu: float = 0.6

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"mu": self._number("mu")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        tangential = ca.sqrt(ca.sumsqr(contact.tangential_force) + TINY_FORCE**2) - TINY_FORCE
        return ca.fmax(0, tangential - p["mu"] * contact.normal_force)

    def hard(self) -> Constraint:
        return FrictionCones(self.mu, contacts=self.contacts, **self._kept())


@dataclass(frozen=True, eq=False)
class LoadSharing(ContactCost):
    """f_n/mg: the squares are least where the feet share the load."""

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return contact.normal_force


@dataclass(frozen=True, eq=False)
class BodyLoad(ContactCost):
    """f_n/mg of what is no foot: knees and bellies stay off the ground. ``contacts`` are the feet,
    which this leaves out."""

    def chosen(self, robot: Character, feet: Collection[int]) -> set[int]:
        feet = feet if self.contacts is None else super().chosen(robot, feet)
        return set(robot.own_contacts).difference(feet)

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return contact.normal_force


@dataclass(frozen=True, eq=False)
class ForceRate(ContactCost):
    """(f_next − f)/mg between neighbouring steps."""

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return contact.force - contact.force_before


@dataclass(frozen=True, eq=False)
class SlipPower(ContactCost):
    """√(f_n/mg)·v_t: its square is the load times the squared speed with which a loaded foot
    slides."""

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        load = ca.sqrt(ca.fmax(contact.normal_force, 0.0) + TINY_LOAD)
        return load * contact.tangential_velocity


@dataclass(frozen=True, eq=False)
class SwingClearance(ContactCost):
    """A moving foot is to be ``height`` (m) over the ground: |v_t|·max(0, 1 − h/height), h the
    foot's own height.

    Near the ground a foot moves slowly, fast it is high.
    """

    of_feet: ClassVar[bool] = True
    height: float = 0.04  # m

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"inverse_height": self._inverse("height", "m")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        low = ca.fmax(0, 1 - contact.height * p["inverse_height"])
        return low * contact.tangential_velocity
