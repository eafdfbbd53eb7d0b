"""Robots written in Python: what no robot can have is refused where the object is made, in one
sentence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import octo
from octo.errors import ModelError
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base

Y = (0.0, 1.0, 0.0)
HINGE = Joint("hinge", "hinge", Y)
ARM = Body("arm", -1, (HINGE,), mass=1.0, inertia=np.eye(3))
BALL = ContactSphere("ball", 0, (0.0, 0.0, 0.0), 0.1)
ROBOT = Character("arm", (ARM,), (BALL,), base="fixed")
TRUNK = Body("trunk", -1, floating_base(), mass=1.0, inertia=np.eye(3))


def joint(**fields: Any) -> Callable[[], Any]:
    return lambda: replace(HINGE, **fields)


def body(**fields: Any) -> Callable[[], Any]:
    return lambda: replace(ARM, **fields)


def ball(**fields: Any) -> Callable[[], Any]:
    return lambda: replace(BALL, **fields)


def robot(**fields: Any) -> Callable[[], Any]:
    return lambda: replace(ROBOT, **fields)


TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "negative damping": (
        joint(damping=-1.0),
        "joint 'hinge': damping is -1.0, must be finite and not negative",
    ),
    "negative stiffness": (joint(stiffness=-1e-9), "joint 'hinge': stiffness is -1e-09"),
    "negative armature": (joint(armature=-0.1), "joint 'hinge': armature is -0.1"),
    "no damping": (joint(damping=math.nan), "joint 'hinge': damping is nan"),
    "endless damping": (joint(damping=math.inf), "joint 'hinge': damping is inf"),
    "endless armature": (joint(armature=math.inf), "joint 'hinge': armature is inf"),
    "stiffness in words": (
        joint(stiffness="soft"),
        "joint 'hinge': stiffness is 'soft', must be a number",
    ),
    "a number in quotes": (
        joint(damping="0.5"),
        "joint 'hinge': damping is '0.5', must be a number",
    ),
    "an axis in quotes": (
        joint(axis=("0", "1", "0")),
        "joint 'hinge': axis is .*, must be numbers",
    ),
    "an axis of None": (joint(axis=None), "joint 'hinge': axis is None, must be numbers"),
    "a crooked inertia": (
        body(inertia=[[1.0], [1.0, 2.0]]),
        "body 'arm': inertia is .*, must be numbers",
    ),
    "damping of None": (joint(damping=None), "joint 'hinge': damping is None, must be a number"),
    "too large": (
        joint(stiffness=1e300),
        r"joint 'hinge': stiffness is 1e\+300, must be at most 1e\+12",
    ),
    "a whole number too large": (joint(damping=10**400), "joint 'hinge': damping is inf"),
    "no limit": (joint(lower=math.nan), "joint 'hinge': lower limit is nan"),
    "limits in words": (joint(upper="high"), "joint 'hinge': upper limit is 'high'"),
    "limits the wrong way": (
        joint(lower=1.0, upper=0.0),
        "joint 'hinge': lower limit 1.0 is above the upper limit 0.0",
    ),
    "no range": (joint(lower=math.inf), "joint 'hinge': both limits are inf"),
    "negative torque": (
        joint(torque_limit=-5.0),
        "joint 'hinge': torque limit is -5.0, must be not negative",
    ),
    "no torque": (joint(torque_limit=math.nan), "joint 'hinge': torque limit is nan"),
    "no speed": (
        joint(velocity_limit=0.0),
        "joint 'hinge': velocity limit is 0.0, must be positive",
    ),
    "gear": (joint(gear=math.nan), "joint 'hinge': gear is nan, must be finite"),
    "reference": (joint(reference=math.inf), "joint 'hinge': reference is inf"),
    "rest": (joint(rest=math.nan), "joint 'hinge': rest is nan"),
    "long axis": (
        joint(axis=(0.0, 2.0, 0.0)),
        "joint 'hinge': axis has length 2, must be a unit vector",
    ),
    "short axis": (joint(axis=(0.0, 0.5, 0.5)), "joint 'hinge': axis has length 0.70"),
    "no axis": (joint(axis=(0.0, 0.0, 0.0)), "joint 'hinge': axis has length 0"),
    "axis that is none": (
        joint(axis=(0.0, math.nan, 0.0)),
        "joint 'hinge': axis has the entry nan",
    ),
    "axis of two": (
        joint(axis=(0.0, 1.0)),
        r"joint 'hinge': axis has shape \(2,\), must have \(3,\)",
    ),
    "axis in words": (joint(axis="y"), "joint 'hinge': axis is 'y', must be numbers"),
    "anchor": (joint(anchor=(0.0, math.inf, 0.0)), "joint 'hinge': anchor has the entry inf"),
    "kind": (joint(kind="ball"), "joint 'hinge': kind is 'ball', must be 'hinge' or 'slide'"),
    "kind of None": (joint(kind=None), "joint 'hinge': kind is None"),
    "actuated": (joint(actuated="yes"), "joint 'hinge': actuated is 'yes', must be True or False"),
    "joint without a name": (joint(name=""), "joint: name is ''"),
    "joint of a number": (joint(name=3), "joint: name is 3, must be a text"),
    "origin": (body(position=(math.nan, 0.0, 0.0)), "body 'arm': position has the entry nan"),
    "origin far away": (
        body(position=(0.0, 1e300, 0.0)),
        r"body 'arm': position has the entry 1e\+300",
    ),
    "centre of mass": (
        body(com=(0.0, 0.0, math.inf)),
        "body 'arm': centre of mass has the entry inf",
    ),
    "centre of mass of two": (body(com=(0.0, 0.0)), "body 'arm': centre of mass has shape"),
    "mirrored rotation": (body(rotation=np.diag([1.0, 1.0, -1.0])), "body 'arm': rotation is none"),
    "scaled rotation": (
        body(rotation=2.0 * np.eye(3)),
        r"body 'arm': rotation is none \(off by 3\)",
    ),
    "no rotation": (
        body(rotation=np.full((3, 3), math.nan)),
        "body 'arm': rotation has the entry nan",
    ),
    "negative mass": (body(mass=-1.0), "body 'arm': mass is -1.0, must be finite and not negative"),
    "endless mass": (body(mass=math.inf), "body 'arm': mass is inf"),
    "mass in words": (body(mass="heavy"), "body 'arm': mass is 'heavy'"),
    "indefinite inertia": (
        body(inertia=np.diag([1.0, 1.0, -1.0])),
        "principal moments -1, 1, 1 kg m², must have none",
    ),
    "slightly indefinite": (
        body(inertia=np.diag([1.0, 1.0, -1e-4])),
        "principal moments -0.0001, 1, 1",
    ),
    "indefinite off the diagonal": (
        body(inertia=np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])),
        "principal moments -1, 1, 3",
    ),
    "inertia of a triangle": (
        body(inertia=np.triu(np.ones((3, 3)))),
        "body 'arm': inertia is not symmetric",
    ),
    "inertia of three": (body(inertia=(1.0, 1.0, 1.0)), "body 'arm': inertia has shape"),
    "no inertia": (
        body(inertia=np.full((3, 3), math.nan)),
        "body 'arm': inertia has the entry nan",
    ),
    "parent": (
        body(parent="trunk"),
        "body 'arm': parent is 'trunk', must be the index of a body, or -1",
    ),
    "joints": (
        body(joints=("hinge",)),
        r"body 'arm': joints is \('hinge',\), must be a tuple of Joint",
    ),
    "radius": (ball(radius=1e300), r"contact 'ball': radius is 1e\+300, must be at most 1e\+12"),
    "no radius": (ball(radius=math.nan), "contact 'ball': radius is nan"),
    "endless radius": (ball(radius=math.inf), "contact 'ball': radius is inf"),
    "negative radius": (
        ball(radius=-0.1),
        "contact 'ball': radius is -0.1, must be finite and not negative",
    ),
    "place of a contact": (
        ball(position=(0.0, math.nan, 0.0)),
        "contact 'ball': position has the entry nan",
    ),
    "body of a contact": (
        ball(body="arm"),
        "contact 'ball': body is 'arm', must be the index of a body",
    ),
    "two joints of a name": (
        robot(bodies=(ARM, Body("hand", 0, (HINGE,), mass=1.0))),
        "character 'arm': two joints are named 'hinge'",
    ),
    "two joints of a body": (
        robot(bodies=(replace(ARM, joints=(HINGE, HINGE)),)),
        "two joints are named 'hinge'",
    ),
    "two bodies of a name": (
        robot(bodies=(ARM, replace(ARM, joints=()))),
        "two bodies are named 'arm'",
    ),
    "two contacts of a name": (robot(contacts=(BALL, BALL)), "two contacts are named 'ball'"),
    "base": (
        robot(base="flying"),
        "character 'arm': base is 'flying', must be 'floating' or 'fixed'",
    ),
    "chart": (robot(chart="xyz"), "character 'arm': chart is 'xyz', must be 'zyx' or 'zxy'"),
    "a floating base of one hinge": (
        robot(base="floating"),
        "base is 'floating', but body 'arm', the first that moves",
    ),
    "a driven floating base": (
        lambda: Character(
            "t", (replace(TRUNK, joints=tuple(replace(j, actuated=True) for j in floating_base())),)
        ),
        "base is 'floating', but body 'trunk'",
    ),
    "pose": (
        robot(default_pose=np.zeros(2)),
        r"character 'arm': default pose has shape \(2,\), must have \(1,\)",
    ),
    "no pose": (
        robot(poses={"home": [math.nan]}),
        "character 'arm': pose 'home' has the entry nan",
    ),
    "bodies": (
        robot(bodies=(HINGE,)),
        "character 'arm': bodies is a tuple, must be a tuple of Body",
    ),
    "contacts": (
        robot(contacts=BALL),
        "character 'arm': contacts is a ContactSphere, must be a tuple of ContactSphere",
    ),
    "pairs": (robot(pairs=(("a", "b"),)), "character 'arm': pairs is .*, must be pairs of indices"),
    "half pairs": (robot(pairs=(0, 1)), "character 'arm': pairs is"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", REFUSED)
def test_refused_where_it_is_made(case):
    make, message = REFUSED[case]
    with pytest.raises(ModelError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200  # never the repr of a robot


ALLOWED: dict[str, Callable[[], Any]] = {
    "no limits": joint(
        lower=-math.inf, upper=math.inf, torque_limit=math.inf, velocity_limit=math.inf
    ),
    "a limit in words of Python": joint(lower=float("-inf"), upper=float("1e400")),
    "limits that hold": joint(lower=0.3, upper=0.3),
    "large limits": joint(lower=-1e300, upper=1e16, torque_limit=1e308),
    "whole numbers": joint(damping=1, lower=-1, upper=1, axis=(0, 0, 1)),
    "numbers of NumPy": joint(damping=np.float32(0.5), lower=np.int64(-1), actuated=np.bool_(True)),
    "a rounded axis": joint(axis=(0.0, 0.7071, 0.7071)),
    "turned": body(rotation=TURNED.tolist()),
    "a point": body(inertia=np.zeros((3, 3))),
    "a plate": body(inertia=np.diag([1.0, 1.0, 2.0])),
    "of no mass distribution": body(inertia=np.diag([0.1, 0.1, 0.5])),
    "rounding of an inertia": body(inertia=np.diag([-2.5e-22, 3.4e-23, 3e-6])),
    "lists": robot(bodies=[ARM], contacts=[BALL]),
    "a point of contact": ball(radius=0.0),
}


@pytest.mark.parametrize("case", ALLOWED)
def test_allowed(case):
    assert ALLOWED[case]() is not None


def test_fields_are_numbers_of_the_objects_own():
    """Lists become arrays, and what the caller does to its own afterwards changes nothing."""
    axis, com = np.array([0.0, 1.0, 0.0]), np.zeros(3)
    made = Body("arm", -1, [Joint("hinge", "hinge", axis)], com=com, mass=2)
    axis[:], com[:] = 9.0, 9.0
    assert made.joints[0].axis.tolist() == [0.0, 1.0, 0.0]
    assert made.com.tolist() == [0.0, 0.0, 0.0]
    assert isinstance(made.mass, float)
    assert np.linalg.norm(replace(HINGE, axis=(0.0, 0.7071, 0.7071)).axis) == pytest.approx(
        1.0, abs=1e-15
    )


@pytest.mark.parametrize("name", ["chain", "biped", "bird", "mammal", "spider", "humanoid"])
def test_the_gallery_is_as_it_was(name):
    made = octo.load(name)
    assert made.mass == pytest.approx(sum(part.mass for part in made.bodies), rel=1e-15)
    assert made.masses.tolist() == [part.mass for part in made.bodies]


def test_start_pose_is_a_new_array_and_zeros_without_a_default() -> None:
    robot = octo.gallery.mammal()
    robot.start_pose[:] = 1.0
    np.testing.assert_array_equal(robot.start_pose, robot.default_pose)
    np.testing.assert_array_equal(replace(robot, default_pose=None).start_pose, np.zeros(robot.nx))
