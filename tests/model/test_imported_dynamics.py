"""FD of a robot read from a file converges at order one to MuJoCo's inverse dynamics as dt goes to
zero."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_oracle import qpos_of, urdf_model, velocity_map
from robot_packages import package, urdf_named

from octo.dynamics.laws import Smooth
from octo.dynamics.parameters import robot_layout
from octo.dynamics.symbolic import forward_dynamics
from octo.model.character import Character
from octo.model.load import load
from octo.model.terrain import Plane

SPRUNG = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="base" pos="0 0
  1"><freejoint/>
<inertial pos=".01 .02 .03" mass="3" diaginertia=".02 .03 .04"/>
<body name="arm" pos=".1 0 0" euler="10 20 30">
  <joint name="hinge" axis="0 1 .5" pos="0 .02 -.1" armature=".1" damping=".7" stiffness="5"
    springref="20" ref="15"/>
  <inertial pos="0 0 .2" mass="1" diaginertia=".01 .02 .02"/>
<body name="tool" pos="0 0 .4">
  <joint name="slide" type="slide" axis="1 0 1" armature=".2" damping="2" stiffness="30"
    springref=".1" ref=".05"/>
  <inertial pos=".1 0 0" mass=".5" diaginertia=".001 .002 .002"/></body></body></body></worldbody>
<actuator><motor joint="hinge" gear="4"/></actuator></mujoco>"""


class Motion:
    """A smooth motion x(t) (nx,) with all derivatives, inside the chart."""

    def __init__(self, character: Character, seed: int):
        rng, n = np.random.default_rng(seed), character.nx
        self.center, self.size = rng.uniform(-0.3, 0.3, n), rng.uniform(0.05, 0.2, n)
        self.rate, self.phase = rng.uniform(1.0, 3.0, n), rng.uniform(0.0, 6.0, n)

    def __call__(self, t: float) -> np.ndarray:
        return self.center + self.size * np.sin(self.rate * t + self.phase)

    def velocity(self, t: float) -> np.ndarray:
        return self.size * self.rate * np.cos(self.rate * t + self.phase)


def inverse_dynamics(character: Character, model: mujoco.MjModel, motion: Motion) -> np.ndarray:
    """Torques (nx,) in the coordinates x that MuJoCo needs for the motion at t = 0: no contacts,
    limits or friction."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data, h = mujoco.MjData(model), 1e-3

    def qvel(t: float) -> np.ndarray:
        return velocity_map(character, model, motion(t)) @ motion.velocity(t)

    data.qpos[:], data.qvel[:] = qpos_of(character, model, motion(0.0)), qvel(0.0)
    data.qacc[:] = (8.0 * (qvel(h) - qvel(-h)) - (qvel(2.0 * h) - qvel(-2.0 * h))) / (12.0 * h)
    mujoco.mj_inverse(model, data)
    return velocity_map(character, model, motion(0.0)).T @ data.qfrc_inverse


def fd_errors(
    character: Character, model: mujoco.MjModel, steps: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Relative error of FD at each time step (s), and of its Richardson extrapolation from the last
    three."""
    character = replace(character, contacts=(), pairs=())
    law, terrain = Smooth(), Plane()
    layout = robot_layout(law.parameters, terrain.parameters)
    FD = forward_dynamics(character, law, terrain, layout)
    motion = Motion(character, 3)
    expected = inverse_dynamics(character, model, motion)
    values = []
    for dt in steps:
        p = layout.pack(dt=dt, w_joint=0.0, w_self=0.0)
        values.append(np.array(FD(motion(dt), motion(0.0), motion(-dt), p)).ravel())
    coarse, middle, fine = values[-3:]
    # halved steps: cancels orders one and two
    extrapolated = (8.0 * fine - 6.0 * middle + coarse) / 3.0
    scale = np.abs(expected).max()
    return np.array([np.abs(v - expected).max() / scale for v in values]), np.abs(
        extrapolated - expected
    ).max() / scale


def case(name: str, tmp_path: Path) -> tuple[Character, mujoco.MjModel]:
    if name == "sprung":
        path = tmp_path / "sprung.xml"
        path.write_text(SPRUNG)
    elif name.endswith(".xml"):
        folder = package("gymnasium") or pytest.skip("gymnasium is not installed")
        path = folder / "envs" / "mujoco" / "assets" / name
    else:
        path = urdf_named(name)
        return load(path), urdf_model(path)
    return load(path), mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize(
    "name",
    [
        "sprung",
        "ant.xml",
        "humanoid.xml",
        "go2.urdf",
        "anymal_c_simple_description/urdf/anymal.urdf",
        "hyq_no_sensors.urdf",
    ],
)
def test_forward_dynamics_converges_to_inverse_dynamics(name, tmp_path):
    character, model = case(name, tmp_path)
    errors, extrapolated = fd_errors(character, model, (4e-3, 2e-3, 1e-3))
    assert errors[-1] < 1e-3
    assert np.allclose(errors[:-1] / errors[1:], 2.0, rtol=0.05)
    assert extrapolated < 1e-8
