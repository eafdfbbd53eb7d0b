"""Control over shapes that the plan does not know of: the log keeps them, and so do pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from octo import worlds
from octo.model.kinematics import sphere_centers
from octo.mpc import Log, run
from octo.plant import MujocoPlant


def test_a_log_keeps_the_shapes_of_its_plant(robot, problem, controller, tmp_path: Path) -> None:
    world = worlds.blocks(height=0.03, length=0.4, start=0.12)  # below the front feet
    plant = MujocoPlant(robot, terrain=world)
    x = problem.start.copy()
    x[robot.base_coordinate + 2] += 0.04
    plant.reset_chart(x)
    log = run(controller, plant, 0.4)
    assert log.shapes is world
    front = [c for c in log.feet if log.point[-1, c, 0] > 0.1]
    assert len(front) == 2 and log.point[-1, front, 2] == pytest.approx(0.03, abs=0.01)
    chosen = [robot.terrain_contacts[c] for c in log.feet]
    radius = np.array([robot.contacts[k].radius for k in chosen])
    centers = sphere_centers(robot, log.x[-1])[chosen]
    np.testing.assert_allclose(log.foot_height[-1], world.distance(centers) - radius, atol=1e-12)
    log.save(tmp_path / "log.npz")
    back = Log.load(tmp_path / "log.npz")
    assert back.shapes is not None
    np.testing.assert_allclose(back.shapes.data, world.data, atol=1e-14)
    motion = back.solution()
    assert motion.world is back.shapes and motion.ground["z"].max() == pytest.approx(0.03, abs=1e-3)


def test_a_log_on_a_plane_has_none(robot, problem, controller, plant) -> None:
    assert run(controller, plant, 0.1).shapes is None
