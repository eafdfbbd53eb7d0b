"""What is generated once for dynamics that say the same, whoever made them: a robot that is loaded
again, in the next solve of a script, is the same robot."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from octo.digest import digest
from octo.dynamics.laws import Compliant, ContactLaw, Coulomb, Smooth, Viscous
from octo.model import store
from octo.model.character import Character
from octo.model.terrain import Ground, Plane

T = TypeVar("T")
KEPT = 8  # texts, and programs
# what is compared by its numbers alone: a class that somebody else wrote may say the same twice and
# mean another force
LAWS = (Smooth, Compliant)
FRICTIONS = (Viscous, Coulomb)

_texts: OrderedDict[tuple[Hashable, str], str] = OrderedDict()


def content_of(character: Character, law: ContactLaw, terrain: Ground) -> Hashable | None:
    """What is equal where robot, law and ground are, number for number; None where a part is not
    octo's own, or is no plane."""
    elements = {*store.KINDS_OF_ELEMENTS.values()}
    shapes = {*store.SHAPES_OF_SOLIDS.values()}
    own = (
        type(law) in LAWS
        and type(getattr(law, "friction", None)) in FRICTIONS
        and type(terrain) is Plane
        and all(type(element) in elements for element in character.elements)
        and all(type(solid.shape) in shapes for solid in character.solids)
    )
    return (digest([store.to_plain(character)]), law, terrain) if own else None


def kept(key: Hashable, kind: str, make: Callable[[], str]) -> str:
    """The text of that kind of dynamics with that key, made if it is not there; the last few
    are kept."""
    return recent(_texts, (key, kind), make)


def recent(store: OrderedDict[Any, T], key: Any, make: Callable[[], T]) -> T:
    """What a store has under a key, made if it is not there; it keeps the KEPT that were asked for
    last."""
    found = store.pop(key) if key in store else make()
    store[key] = found
    while len(store) > KEPT:
        store.popitem(last=False)
    return found
