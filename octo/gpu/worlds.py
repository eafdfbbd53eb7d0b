"""The numbers of the worlds that problems stand on, on a device."""

from __future__ import annotations

from numpy.typing import NDArray

from octo.dynamics.evaluate import RobotDynamics
from octo.gpu.device import Array, Device
from octo.model.terrain import ADDRESS, World, world_at
from octo.problem.compiled import CompiledProblem


class Worlds:
    """Of a batch: the data of each world once, which kernels find by its address in p.

    contacts: how many look-ups a node has.
    """

    def __init__(self, problem: CompiledProblem, device: Device):
        self.contacts = self._place = 0
        self._held: list[Array] = []
        self._addresses: list[float] = []
        dynamics = problem.dynamics
        if not isinstance(dynamics, RobotDynamics) or not isinstance(dynamics.terrain, World):
            return
        self.contacts = dynamics.looks
        self._place = dynamics.layout.index(ADDRESS)
        found: dict[float, float] = {}
        for address in problem.p[:, self._place].tolist():
            if address not in found:
                world = world_at(address) or dynamics.terrain
                self._held.append(device.array(world.data))
                found[address] = float(device.address(self._held[-1]))
        self._addresses = [found[a] for a in problem.p[:, self._place].tolist()]

    def placed(self, problem: CompiledProblem) -> NDArray:
        """p (batch, NP) of the problem on the host, with where the device has the worlds."""
        p = problem.p.copy()
        p[:, self._place] = self._addresses
        return p
