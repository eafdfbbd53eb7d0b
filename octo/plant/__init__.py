"""Machines with other physics, in which a plan or a controller has to prove itself."""

from octo.model.convention import from_chart, to_chart
from octo.plant.mujoco_plant import MujocoPlant
from octo.plant.simulator_plant import SimulatorPlant

__all__ = ["MujocoPlant", "SimulatorPlant", "from_chart", "to_chart"]
