"""What the compiler says of the kernels of a CUDA text: registers and spills."""

from __future__ import annotations

import re
from dataclasses import dataclass

from octo.gpu import nvrtc


@dataclass(frozen=True)
class Kernel:
    """What ptxas says of one kernel."""

    name: str
    registers: int
    stack: int  # bytes a thread
    spill_stores: int  # bytes a thread
    spill_loads: int


def kernels_of(binary: nvrtc.Binary) -> dict[str, Kernel]:
    """What ptxas says of each kernel; spills are those of the functions that it calls too."""
    found = {}
    for section in binary.log.split("Compiling entry function '")[1:]:
        name = section.split("'", 1)[0]
        frames = re.findall(
            r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", section
        )
        used = re.search(r"Used (\d+) registers", section)
        if frames and used:
            stores, loads = (sum(int(frame[k]) for frame in frames) for k in (1, 2))
            found[name] = Kernel(name, int(used[1]), int(frames[0][0]), stores, loads)
    return found
