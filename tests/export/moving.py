"""Motions to export that nobody solved: bases that travel and turn, joints that swing."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

import octo
from octo.model.body import floating_base
from octo.model.character import Character
from octo.result.solution import Solution, recorded

DT, STEPS = 0.025, 32
SLIDING = """<mujoco><worldbody><body name="rail" pos=".1 .2 1" quat=".9 .1 .2 .3">
<geom size=".1"/><body name="cart" pos="0 .1 0"><joint type="slide" name="along" axis="0 .6 .8"/>
<geom size=".08"/><body name="arm" pos=".1 0 0"><joint type="ball" name="shoulder" pos="0 0 .05"/>
<geom size=".05"/><body name="hand" pos=".2 0 0"><joint name="wrist" axis="0 1 0" ref="0.3"/>
<joint name="turn" axis="1 0 0" pos="0 0 .02"/><geom size=".02"/></body></body></body></body>
</worldbody></mujoco>"""
FIXED = SLIDING.replace('<joint type="slide" name="along" axis="0 .6 .8"/>', "")


def of_file(text: str, path: Path) -> Character:
    file = path / "robot.xml"
    file.write_text(text, encoding="utf-8")
    return octo.load(file)


def moving(robot: Character, steps: int = STEPS, dt: float = DT, **fields: Any) -> Solution:
    """Every coordinate swings about the start pose, each in its time; a floating base turns twice
    about its first angle."""
    random = np.random.default_rng(5)
    times = dt * np.arange(-1, steps + 1)[:, None]
    x = robot.start_pose + random.uniform(0.05, 0.4, robot.nx) * np.sin(
        3.0 * times + random.uniform(0.0, 6.0, robot.nx)
    )
    if robot.base == "floating":
        first = robot.base_coordinate
        x[:, first] += 0.5 * times[:, 0]
        x[:, first + 2] = robot.start_pose[first + 2] + 0.1 * x[:, first + 2]
        x[:, first + 3] += 4.0 * np.pi * times[:, 0] / (steps * dt)
    contacts = len(robot.terrain_contacts)
    weight = 9.81 * robot.mass
    touches = len(robot.touches)
    known: dict[str, Any] = {
        "u": np.zeros((steps, robot.nu)),
        "contact_force": np.zeros((steps, contacts, 3)),
        "touch_force": np.tile([weight, 0.0, 0.0], (steps, touches, 1)),
        "touch_point": np.zeros((steps, touches, 3)),
        "ground": {"x": np.array([-1.0, 2.0]), "y": np.array([-1.0, 1.0]), "z": np.zeros((2, 2))},
    }
    return recorded(character=robot, dt=dt, x=x, weight=weight, length=0.5, **{**known, **fields})


def other_chart() -> Character:
    """A spider whose base has the other three angles."""
    robot = octo.gallery.spider()
    base = dataclasses.replace(robot.bodies[0], joints=floating_base(chart="zxy"))
    return dataclasses.replace(robot, bodies=(base, *robot.bodies[1:]), chart="zxy")


def pushing() -> Character:
    box = octo.objects.box((0.3, 0.4, 0.3), 1.5, (0.8, 0.0, 0.15))
    return octo.Scene(octo.gallery.mammal(), [box]).character
