"""A robot and free objects around it, as one Character of several roots."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from octo.errors import ModelError, UnknownNameError, said
from octo.model.character import Character
from octo.model.element import Element
from octo.model.kinematics import body_poses
from octo.shown import Shown, listed


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Shown):
    """A robot and objects, which octo.Problem and octo.simulate take where they take a Character.

    What is asked of "the robot" stays the robot's: its base and centre of mass, its mass, which
    forces are measured in, its feet and what a gait is measured by. Objects have no motors; they
    start at rest where they stand, in the start pose that is looked for. Terms address the bodies
    of any: ``octo.PointPosition(body="box", target=(1, 0, 0.2))``.

    Attributes
    ----------
    robot: its joints come first in x; None: the first object takes the robot's place.
    objects: Characters whose joints nothing drives (octo.objects.box, ball, cylinder, capsule,
        door; or octo.load of a file, whose motors are taken off). Where a name is taken already,
        the object's own is put before it, and a number after that.
    contacts: which bodies touch each other, by the problem's contact law: pairs of names. The
        first is a contact sphere or a body, the second a body that has a solid; of two bodies both
        of which have one, the spheres of each touch the other. By default the ends of the robot's
        limbs and every object, and every two objects.
    """

    robot: Character | None
    objects: Sequence[Character] = ()
    contacts: Sequence[tuple[str, str]] | None = None

    def __post_init__(self) -> None:
        if self.robot is not None and not isinstance(self.robot, Character):
            raise ModelError(f"scene: robot is {said(self.robot)}, must be a Character or None")
        given = self.objects
        if not isinstance(given, (tuple, list)) or not all(isinstance(o, Character) for o in given):
            raise ModelError(
                f"scene: objects is {said(given)}, must be a list of Characters, such as "
                "octo.objects.box((0.3, 0.3, 0.3), 2.0)"
            )
        if self.robot is None and not given:
            raise ModelError("scene: it holds neither a robot nor an object")
        object.__setattr__(self, "objects", tuple(given))
        self.character  # noqa: B018  (names and pairs are checked here)

    @cached_property
    def character(self) -> Character:
        """All of it as one Character, whose ``objects`` names what is no robot."""
        first, *rest = (self.robot, *self.objects) if self.robot is not None else self.objects
        assert first is not None
        whole = first
        for thing in rest:
            whole = _joined(whole, _passive(thing))
        _check_apart(whole)
        touches = _defaults(whole) if self.contacts is None else _chosen(whole, self.contacts)
        return replace(whole, touches=tuple(dict.fromkeys([*whole.touches, *touches])))

    def __repr__(self) -> str:
        whole = self.character
        names = [contact.name for contact in whole.contacts]
        touches = [f"{names[c]} – {whole.solids[s].name}" for c, s in whole.touches]
        return "\n".join(
            [repr(whole), listed("objects", list(whole.objects)), listed("touches", touches)]
        )


def _check_apart(whole: Character) -> None:
    """Refuse two objects in one place: contact would shoot them apart."""
    rotation, origin = body_poses(whole, whole.start_pose)
    for b in np.flatnonzero(whole.of_objects).tolist():
        middle = origin[b] + rotation[b] @ whole.bodies[b].com
        for solid in whole.solids:
            if solid.body != b and whole.of_objects[solid.body]:
                place = rotation[solid.body].T @ (middle - origin[solid.body])
                if solid.distance(place) < 0.0:
                    raise ModelError(
                        f"scene: objects {whole.bodies[b].name!r} and "
                        f"{whole.bodies[solid.body].name!r} are in one place, must be beside each "
                        "other"
                    )


def _passive(thing: Character) -> Character:
    """The object without its motors."""
    bodies = tuple(
        replace(body, joints=tuple(replace(joint, actuated=False) for joint in body.joints))
        for body in thing.bodies
    )
    return replace(thing, bodies=bodies)


def _joined(whole: Character, thing: Character) -> Character:
    """``whole`` and an object, whose names are changed where they are taken."""
    thing = _renamed(whole, thing)
    bodies, spheres, solids = len(whole.bodies), len(whole.contacts), len(whole.solids)
    roots = [body.name for body in thing.bodies if body.parent < 0]
    placed: dict[str, Any] = {
        "bodies": tuple(
            replace(b, parent=b.parent + bodies if b.parent >= 0 else -1) for b in thing.bodies
        ),
        "contacts": tuple(replace(c, body=c.body + bodies) for c in thing.contacts),
        "solids": tuple(replace(s, body=s.body + bodies) for s in thing.solids),
        "pairs": tuple((a + spheres, b + spheres) for a, b in thing.pairs),
        "touches": tuple((c + spheres, s + solids) for c, s in thing.touches),
        "looks": tuple(replace(look, body=look.body + bodies) for look in thing.looks),
        "elements": thing.elements,
        "dropped": thing.dropped,
        "objects": tuple(roots),
    }
    both: dict[str, Any] = {
        name: (*getattr(whole, name), *values) for name, values in placed.items()
    }
    own = thing.start_pose
    poses = {name: np.concatenate([pose, own]) for name, pose in whole.poses.items()}
    # not None where the robot's is: zeros are what it would start from
    pose = np.concatenate([whole.start_pose, own])
    return replace(whole, **both, poses=poses, default_pose=pose)


def _renamed(whole: Character, thing: Character) -> Character:
    """The object, with names that ``whole`` has not."""
    taken = {item.name for _, items in _named(whole) for item in items} | set(whole.objects)
    label, count = thing.name, 2
    while label in taken:
        label, count = f"{thing.name}{count}", count + 1

    def fresh(name: str) -> str:
        if name not in taken:
            return name
        own = name == thing.name or name.startswith(f"{thing.name}_")
        new = label + name[len(thing.name) :] if own else f"{label}_{name}"
        while new in taken:
            new = f"{new}_"
        return new

    changes: dict[str, Any] = {
        field: tuple(replace(item, name=fresh(item.name)) for item in items)
        for field, items in _named(thing)
        if field != "joints"
    }
    changes["bodies"] = tuple(
        replace(body, joints=tuple(replace(j, name=fresh(j.name)) for j in body.joints))
        for body in changes["bodies"]
    )
    changes["elements"] = tuple(_on(element, fresh) for element in thing.elements)
    return replace(thing, **changes, name=label, objects=tuple(map(fresh, thing.objects)))


def _on(element: Element, fresh: Any) -> Element:
    bodies = {end: getattr(element, end) for end in ("body_a", "body_b")}
    ends: dict[str, Any] = {k: None if body is None else fresh(body) for k, body in bodies.items()}
    return replace(element, **ends)


def _named(character: Character) -> Iterator[tuple[str, Sequence[Any]]]:
    for field in ("bodies", "joints", "contacts", "solids"):
        yield field, getattr(character, field)


def _defaults(whole: Character) -> list[tuple[int, int]]:
    """The ends of the robot's limbs and every object; every two objects."""
    robot = [b for b in range(len(whole.bodies)) if not whole.of_objects[b]]
    mine = [b for b in robot if any(item.body == b for item in whole.solids)]
    carriers = {whole.bodies[b].parent for b in robot} | set(mine)
    limbs = [k for k in whole.own_contacts if whole.contacts[k].body not in carriers]
    solid = [s for s, item in enumerate(whole.solids) if whole.of_objects[item.body]]
    made = [(k, s) for k in limbs for s in solid]
    roots, groups = whole.roots, [mine]
    members: dict[int, list[int]] = {}
    for b in np.flatnonzero(whole.of_objects).tolist():
        members.setdefault(roots[b], []).append(b)
    groups += members.values()
    for one, other in itertools.combinations(groups, 2):
        for a, b in itertools.product(one, other):
            made += _both(whole, a, b)
    return list(dict.fromkeys(made))


def _both(whole: Character, a: int, b: int) -> list[tuple[int, int]]:
    """The spheres of each body with the solids of the other; of a ball its own sphere alone, which
    is all of it."""
    first, second = _one_way(whole, a, b), _one_way(whole, b, a)
    if first and second and is_ball(whole, a):
        return first
    return second if first and second and is_ball(whole, b) else first + second


def _one_way(whole: Character, a: int, b: int) -> list[tuple[int, int]]:
    spheres = [k for k, item in enumerate(whole.contacts) if item.body == a]
    solids = [s for s, item in enumerate(whole.solids) if item.body == b]
    return [(k, s) for k in spheres for s in solids]


def is_ball(whole: Character, b: int) -> bool:
    """Whether body ``b`` has no solid that is no sphere."""
    return all(item.kind == "sphere" for item in whole.solids if item.body == b)


def _chosen(whole: Character, pairs: Any) -> list[tuple[int, int]]:
    """The pairs that were named."""
    if not isinstance(pairs, (tuple, list)):
        raise ModelError(f"scene: contacts is {said(pairs)}, must be a list of pairs of names")
    names = [contact.name for contact in whole.contacts]
    bodies = [body.name for body in whole.bodies]
    made: list[tuple[int, int]] = []
    for pair in pairs:
        if not isinstance(pair, (tuple, list)) or [type(n) for n in pair] != [str, str]:
            raise ModelError(f"scene: contact {said(pair)} must be a pair of names")
        first, second = pair
        if second not in bodies:
            raise UnknownNameError("body of a contact", second, bodies)
        b = bodies.index(second)
        if first in bodies:
            found = _both(whole, bodies.index(first), b)
        elif first in names:
            k = names.index(first)
            found = [(k, s) for s, item in enumerate(whole.solids) if item.body == b]
        else:
            raise UnknownNameError("sphere or body of a contact", first, [*names, *bodies])
        if not found:
            raise ModelError(
                f"scene: {first!r} and {second!r} cannot touch, one must have contact spheres and "
                "the other a solid"
            )
        made += found
    return made
