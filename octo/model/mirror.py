"""The left-right mirror of a robot: which joint is the image of which, found from its geometry.

The mirror plane is y = 0, with a floating base at the origin. M = diag(1, -1, 1) takes points p to
M p; of a joint's twist (angular velocity, velocity of the point at the origin) it takes the
velocity to M v and the angular velocity, a pseudo-vector, to -M w. A robot has a mirror if, in one
configuration, the reflected twists of its joints are, up to a sign each, those of other joints at
the same place in the tree. This then holds in every configuration, and the mirrored configuration
is linear in x: a signed permutation G and an offset.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from octo.checks import instance, one_of
from octo.errors import MirrorError, ProblemError, ShapeError
from octo.model.body import Joint
from octo.model.character import Character
from octo.model.element import Element, named
from octo.model.feet import lowest_contacts
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.mass_matrix import joint_twists
from octo.model.quantities import Array

# How far from a mirror image a robot may be.
JOINTS = 5e-3  # rad, and of the robot's size
MASS = 0.02  # of the robot's mass
CENTERS = 0.05  # of the robot's size: centres of mass
INERTIA = 0.02  # of the robot's mass and squared size
PASSIVE = 0.25  # of the largest armature, damping and stiffness of the robot's joints
REST = 0.05  # rad or m, of springs
CONTACTS = 0.02  # of the robot's size: centres and radii of spheres
BY_HAND = 10.0  # times JOINTS where joints are paired by hand
POSES = 5.0  # times JOINTS, of the bodies at the end of a chain of joints

NAMES = 1e-6  # of the robot's size: names decide only between bodies in one place
IMPOSSIBLE = 1e6  # of the robot's size
REFLECTION = np.diag([1.0, -1.0, 1.0])
TWIST = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # what M does to a twist (6,)


@dataclass(frozen=True, eq=False)
class Mirror:
    """The mirrored configuration G x + offset of a robot; mirrored twice it is x again.

    The mirror plane is the world's x-z plane: x, z and pitch of a floating base keep their sign,
    y, yaw and roll change it. G is symmetric and orthogonal, so that FD (nx,) mirrors by G too.

    Attributes
    ----------
    matrix: (nx, nx) G, a signed permutation.
    offset: (nx,) rad and m; not zero where a joint and its image have different zero positions.
    joints: name of a joint -> name of its image and the sign between their coordinates.
    contacts: (contacts,) index of each contact sphere's image, its own where it has none.
    alone: names of the contact spheres without an image; none of them is at the feet.
    """

    matrix: Array
    offset: Array
    joints: Mapping[str, tuple[str, int]]
    contacts: NDArray[np.intp]
    alone: tuple[str, ...] = ()

    def __call__(self, x: NDArray) -> Array:
        """Mirrored configurations (..., nx) of x (..., nx), rad and m."""
        x = np.asarray(x, dtype=float)
        if x.ndim == 0 or x.shape[-1] != len(self.offset):
            raise ShapeError("x", x.shape, f"(..., {len(self.offset)})")
        return x @ self.matrix.T + self.offset


def mirror_of(robot: Character, pairs: Mapping[str, str] | None = None) -> Mirror:
    """Find the left-right mirror of a robot that heads along +x at yaw 0.

    The images are looked for where all displacements are zero, then in the default pose and the
    poses of the robot's file. Limits of joints and torques and self-collision pairs are not
    compared.

    Parameters
    ----------
    robot: its files' small differences between left and right are allowed.
    pairs: name of a joint -> name of its image, for joints that the geometry does not tell apart
        or that are less alike: ten times the difference is allowed, and any between the bodies.

    Raises
    ------
    MirrorError: there is none; the sentence names what has no image.
    UnknownNameError: ``pairs`` names no joint of the robot.
    """
    instance("robot", robot, Character, "a Character: what octo.load gives")
    given = {} if pairs is None else pairs
    by_hand = _both_ways(robot, instance("pairs", given, Mapping, "names of joints by name"))
    refusals: list[_NoImage] = []
    for x in _configurations(robot):
        try:
            return _Search(robot, x, by_hand).mirror()
        except _NoImage as refusal:
            refusals.append(refusal)
    closest = max(refusals, key=lambda refusal: refusal.progress)
    raise MirrorError(f"robot {robot.name!r} has no left-right mirror: {closest}")


class _NoImage(Exception):
    """Why there is no image, and how far the search had come: the farthest has the best reason."""

    def __init__(self, progress: float, sentence: str):
        super().__init__(sentence)
        self.progress = progress


def _both_ways(robot: Character, pairs: Mapping[str, str]) -> dict[str, str]:
    names = [joint.name for joint in robot.joints]
    both: dict[str, str] = {}
    for pair in pairs.items():
        for joint, image in (pair, pair[::-1]):
            one_of("joint", joint, names)
            if both.setdefault(joint, image) != image:
                named = f"{both[joint]!r} and {image!r}"
                raise ProblemError(f"pairs gives joint {joint!r} the images {named}, must be one")
    return both


def _configurations(robot: Character) -> list[Array]:
    """Configurations (nx,) that may mirror themselves, with a floating base at the origin."""
    known = [pose for pose in (robot.default_pose, *robot.poses.values()) if pose is not None]
    found: list[Array] = []
    for pose in (np.array([joint.reference for joint in robot.joints]), *known):
        x = np.array(pose, dtype=float)
        if robot.base == "floating":
            first = robot.base_coordinate
            x[first : first + 3] = 0.0
        if not any(np.array_equal(x, other) for other in found):
            found.append(x)
    return found


class _Search:
    """The images of bodies, joints and contacts about one configuration, in world axes."""

    def __init__(self, robot: Character, x: Array, by_hand: Mapping[str, str]):
        self.robot, self.x, self.by_hand = robot, x, by_hand
        self.rotation, self.origin = body_poses(robot, x)  # (bodies, 3, 3); (bodies, 3) m
        self.twists = joint_twists(robot, x)  # (nx, 6)
        self.centers = sphere_centers(robot, x)  # (contacts, 3) m
        local = np.array([body.com for body in robot.bodies])
        self.com = self.origin + np.einsum("bij,bj->bi", self.rotation, local)  # (bodies, 3) m
        inertia = np.array([body.inertia for body in robot.bodies])
        self.inertia = self.rotation @ inertia @ self.rotation.swapaxes(1, 2)  # (bodies, 3, 3)
        moving = [b for b, path in enumerate(robot.path) if path]
        points = [np.zeros((1, 3)), self.origin[moving], self.com[moving], self.centers]
        self.size = float(np.linalg.norm(np.ptp(np.concatenate(points), axis=0))) or 1.0  # m
        self.children: dict[int, list[int]] = {b: [] for b in (-1, *moving)}
        for b in moving:
            parent = robot.bodies[b].parent
            self.children[parent if parent in self.children else -1].append(b)

    def mirror(self) -> Mirror:
        """Raises _NoImage where a body, joint or contact has no image."""
        robot = self.robot
        _, image = self._siblings(self.children[-1], self.children[-1])
        for b, c in image.items():
            if image[c] != b:
                names = [robot.bodies[k].name for k in (b, c, image[c])]
                one_place = f"bodies {', '.join(names)} are in one place"
                raise _NoImage(math.inf, f"{one_place}, pairs must tell them apart")
        matrix = np.zeros((robot.nx, robot.nx))
        joints: dict[str, tuple[str, int]] = {}
        for b, c in image.items():
            for j, k in zip(self._joints(b), self._joints(c), strict=True):
                _, sign = self._difference(j, k)
                matrix[k, j] = sign
                joints[robot.joints[j].name] = (robot.joints[k].name, sign)
        offset = self.x - matrix @ self.x
        offset[np.abs(offset) < JOINTS] = 0.0
        offset += self._whole_turns(matrix, offset)
        found = Mirror(matrix, offset, joints, *self._contacts(image))
        self._check_elements(image)
        self._check_poses(found, image)
        return found

    def _whole_turns(self, matrix: Array, offset: Array) -> Array:
        """(nx,) rad: multiples of 2π that take mirrored limits (0 to 2π) to those of the image."""
        lower, upper = self.robot.lower, self.robot.upper
        hinge = np.array([joint.kind == "hinge" for joint in self.robot.joints])
        limited = hinge & np.isfinite(lower) & np.isfinite(upper)
        middle = np.zeros(self.robot.nx)
        middle[limited] = (lower[limited] + upper[limited]) / 2.0
        apart = (middle - matrix @ middle - offset) / (2.0 * math.pi)
        return 2.0 * math.pi * np.round(apart * limited * (np.abs(matrix) @ limited))

    def _joints(self, b: int) -> range:
        first = int(self.robot.first_joint[b])
        return range(first, first + len(self.robot.bodies[b].joints))

    def _siblings(
        self, bodies: Sequence[int], images: Sequence[int]
    ) -> tuple[float, dict[int, int]]:
        """Pair the subtrees of bodies that share a parent: distance (m) and body -> image."""
        cost = np.full((len(bodies), len(images)), IMPOSSIBLE * self.size)
        below: dict[tuple[int, int], dict[int, int]] = {}
        refusals: dict[tuple[int, int], _NoImage] = {}
        for r, b in enumerate(bodies):
            for s, c in enumerate(images):
                try:
                    cost[r, s], below[b, c] = self._bodies(b, c)
                except _NoImage as refusal:
                    refusals[b, c] = refusal
        paired = [(bodies[r], images[s]) for r, s in zip(*linear_sum_assignment(cost), strict=True)]
        paired = [pair for pair in paired if pair in below]
        alone = [b for b in bodies if b not in {b for b, _ in paired}]
        alone += [c for c in images if c not in {c for _, c in paired}]
        if alone:
            nearest = [self._none(alone[0])]
            nearest += [refusal for pair, refusal in refusals.items() if alone[0] in pair]
            raise max(nearest, key=lambda refusal: refusal.progress)
        image = {b: c for pair in paired for b, c in below[pair].items()}
        total = sum(cost[bodies.index(b), images.index(c)] for b, c in paired)
        return float(total), image

    def _none(self, b: int) -> _NoImage:
        body = self.robot.bodies[b]
        what = f"joint {body.joints[0].name!r}" if body.joints else f"body {body.name!r}"
        return _NoImage(0.0, f"{what} has no image on the other side")

    def _bodies(self, b: int, c: int) -> tuple[float, dict[int, int]]:
        """Pair a body's subtree with that of its image: distance (m) and body -> image."""
        first, second = self.robot.bodies[b], self.robot.bodies[c]
        if len(first.joints) != len(second.joints):
            raise self._none(b)
        distance = float(np.linalg.norm(REFLECTION @ self.com[b] - self.com[c]))
        for j, k in zip(self._joints(b), self._joints(c), strict=True):
            distance += self.size * self._check_joints(j, k)
        if not any(joint.name in self.by_hand for joint in first.joints):
            self._check_masses(b, c)
        alike = difflib.SequenceMatcher(None, first.name, second.name).ratio()
        try:
            beyond, image = self._siblings(self.children[b], self.children[c])
        except _NoImage as refusal:
            raise _NoImage(refusal.progress + 2.0, str(refusal)) from None
        return distance + beyond + NAMES * self.size * (1.0 - alike), {b: c, **image}

    def _difference(self, j: int, k: int) -> tuple[float, int]:
        """How far joint ``k`` is from the image of ``j`` (rad, and of the size), and the sign."""
        scale = np.ones(6)
        if self.robot.joints[j].kind == "hinge":
            scale[3:] /= self.size
        reflected, twist = scale * TWIST * self.twists[j], scale * self.twists[k]
        same, opposite = (float(np.abs(reflected - s * twist).max()) for s in (1.0, -1.0))
        return (same, 1) if same <= opposite else (opposite, -1)

    def _check_joints(self, j: int, k: int) -> float:
        """The difference of a joint and its image, where that is allowed."""
        first, second = self.robot.joints[j], self.robot.joints[k]
        difference, sign = self._difference(j, k)
        given = self.by_hand.get(first.name)
        alike = first.kind == second.kind and first.actuated == second.actuated
        if given is None and second.name not in self.by_hand:
            if not (alike and difference <= JOINTS):
                raise _NoImage(0.0, f"joint {first.name!r} has no image on the other side")
            apart = (second.rest - self.x[k]) - sign * (first.rest - self.x[j])
            self._check_passive(first, second, float(apart))
        elif given != second.name or not (alike and difference <= BY_HAND * JOINTS):
            one = first.name if given else second.name
            other = self.by_hand[one]
            sentence = f"joint {one!r} and the image that pairs gives it, {other!r}, are not alike"
            raise _NoImage(1.0 if given == second.name else 0.5, sentence)
        return difference

    def _check_passive(self, first: Joint, second: Joint, apart: float) -> None:
        """``apart``: of the rests of their springs, rad or m."""
        named = f"joint {first.name!r} and its image {second.name!r} differ in"
        for what in ("armature", "damping", "stiffness"):
            a, b = getattr(first, what), getattr(second, what)
            if abs(a - b) > PASSIVE * max(getattr(joint, what) for joint in self.robot.joints):
                raise _NoImage(1.0, f"{named} {what}, {a:.3g} and {b:.3g}")
        if min(first.stiffness, second.stiffness) > 0.0 and abs(apart) > REST:
            raise _NoImage(1.0, f"{named} the rest of their springs")

    def _check_masses(self, b: int, c: int) -> None:
        first, second, mass = self.robot.bodies[b], self.robot.bodies[c], self.robot.mass
        of = f"of body {first.name!r}" + ("" if b == c else f" and of its image {second.name!r}")
        if abs(first.mass - second.mass) > MASS * mass:
            raise _NoImage(1.0, f"the mass {of} is {first.mass:.3g} and {second.mass:.3g} kg")
        away = np.linalg.norm(REFLECTION @ self.com[b] - self.com[c])
        if min(first.mass, second.mass) > 0.0 and away > CENTERS * self.size:
            raise _NoImage(1.0, f"the centre of mass {of} is no mirror image")
        reflected = REFLECTION @ self.inertia[b] @ REFLECTION
        if np.abs(reflected - self.inertia[c]).max() > INERTIA * mass * self.size**2:
            raise _NoImage(1.0, f"the inertia {of} is no mirror image")

    def _contacts(self, image: Mapping[int, int]) -> tuple[NDArray[np.intp], tuple[str, ...]]:
        """The image of each sphere (contacts,), and the names of those that have none."""
        spheres, allowed = self.robot.contacts, CONTACTS * self.size
        radius = np.array([sphere.radius for sphere in spheres])
        touches = np.array([sphere.touches_terrain for sphere in spheres])
        contacts = np.full(len(spheres), -1)
        for b, c in image.items():
            own, others = (
                [k for k, sphere in enumerate(spheres) if sphere.body == body] for body in (b, c)
            )
            if b > c or not own or not others:
                continue  # b > c are the pairs of c, b, read backwards
            reflected = self.centers[own] @ REFLECTION
            away = np.linalg.norm(reflected[:, None] - self.centers[others], axis=-1)
            away += np.abs(radius[own][:, None] - radius[others])
            away[touches[own][:, None] != touches[others]] = math.inf
            near = [(away[r, s], own[r], others[s]) for r, s in np.argwhere(away <= allowed)]
            for _, k, other in sorted(near):
                if contacts[k] < 0 and contacts[other] < 0:
                    contacts[k], contacts[other] = other, k
        alone = np.flatnonzero(contacts < 0)
        for k in np.intersect1d(alone, self._feet()):
            raise _NoImage(math.inf, f"contact {spheres[k].name!r} has no image on the other side")
        contacts[alone] = alone
        return contacts, tuple(spheres[k].name for k in alone)

    def _check_elements(self, image: Mapping[int, int]) -> None:
        """Every element must have an image: reflected points, with the reflected force."""
        elements = self.robot.elements
        for name, element in named(elements):
            if not any(self._reflects(element, other, image) for other in elements):
                raise _NoImage(math.inf, f"element {name} has no image on the other side")

    def _reflects(self, one: Element, other: Element, image: Mapping[int, int]) -> bool:
        """Whether ``other`` is the image of ``one``, with the same ends or with a for b."""
        ends, images = self._ends(one), self._ends(other)
        samples = self.size * np.random.default_rng(0).standard_normal((5, 2, 2, 3))
        samples[:, 0] += [place for _, place in ends]  # m; then m/s
        for order in ((0, 1), (1, 0)):
            near = all(
                image.get(b, -1) == images[k][0]
                and np.linalg.norm(place @ REFLECTION - images[k][1]) <= CONTACTS * self.size
                for k, (b, place) in zip(order, ends, strict=True)
            )
            if not near:
                continue
            forces = self._forces(one, samples) @ REFLECTION
            turned = self._forces(other, (samples @ REFLECTION)[:, :, order])
            turned = turned if order == (0, 1) else -turned
            if np.abs(forces - turned).max() <= PASSIVE * np.abs(forces).max():
                return True
        return False

    def _ends(self, element: Element) -> list[tuple[int, Array]]:
        """Of points a and b the body that moves, -1 where none does, and the world place, m."""
        made = []
        for body, point in ((element.body_a, element.point_a), (element.body_b, element.point_b)):
            b = -1 if body is None else self.robot.body_index(body)
            place = np.array(point) if b < 0 else self.rotation[b] @ point + self.origin[b]
            made.append((b if b >= 0 and self.robot.path[b] else -1, place))
        return made

    @staticmethod
    def _forces(element: Element, samples: Array) -> Array:
        """(5, 3) N at samples (5, 2, 2, 3) of the places and velocities of both points."""
        values = []
        for (a, b), (v_a, v_b) in samples:
            at = (ca.DM(a), ca.DM(v_a), ca.DM(b), ca.DM(v_b))
            values.append(ca.DM(element.force(*at, dict(element.parameters))).full().ravel())
        return np.array(values)

    def _feet(self) -> list[int]:
        """The spheres that a robot in its default pose would stand on."""
        default = self.robot.default_pose
        return lowest_contacts(self.robot, self.x if default is None else default)

    def _check_poses(self, mirror: Mirror, image: Mapping[int, int]) -> None:
        """In mirrored configurations the bodies must be where their reflected images are."""
        bodies, images = list(image), list(image.values())
        reflected, at = REFLECTION @ self.rotation[bodies], self.origin[bodies] @ REFLECTION
        back = self.rotation[images].swapaxes(1, 2)
        turn = back @ reflected  # a body's axes in those of its image
        move = np.einsum("bij,bj->bi", back, at - self.origin[images])  # m
        away = np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(self.x)))
        R, t = body_poses(self.robot, self.x + away)
        R_image, t_image = body_poses(self.robot, mirror(self.x + away))
        turned = np.abs(R_image[:, images] @ turn - REFLECTION @ R[:, bodies]).max(axis=(0, 2, 3))
        moved = t_image[:, images] + np.einsum("nbij,bj->nbi", R_image[:, images], move)
        moved = np.abs(moved - t[:, bodies] @ REFLECTION).max(axis=(0, 2)) / self.size
        allowed = POSES * JOINTS * (BY_HAND if self.by_hand else 1.0)
        worst = int(np.argmax(turned + moved))
        if turned[worst] + moved[worst] > allowed:
            name = self.robot.bodies[bodies[worst]].name
            raise _NoImage(math.inf, f"body {name!r} does not move as its image does")
