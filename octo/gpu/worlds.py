"""The numbers of the worlds that problems stand on, on a device."""

from __future__ import annotations

from numpy.typing import NDArray

from octo.gpu.device import Array, Device
from octo.model.terrain import ADDRESS, World, world_at
from octo.problem.compiled import CompiledProblem


def placed(problem: CompiledProblem, device: Device) -> tuple[NDArray, list[Array]]:
    """p (batch, NP) of a batch, on the host, with where the device has the data of each world; and
    these, which kernels find by their addresses: they must outlive p."""
    held: list[Array] = []
    p, dynamics = problem.p, problem.dynamics
    terrain = getattr(dynamics, "terrain", None)
    if not isinstance(terrain, World):
        return p, held
    p, place = p.copy(), dynamics.layout.index(ADDRESS)
    for address in set(p[:, place].tolist()):
        world = world_at(address) or terrain
        held.append(device.array(world.data))
        p[problem.p[:, place] == address, place] = device.address(held[-1])
    return p, held
