"""Records what the emulator launches, and runs it again under a sanitizer (replay.cpp)."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from tests import emulator

SANITIZERS = {
    "address": (
        "-fsanitize=address,undefined",
        # what AddressSanitizer finds too
        "-fno-sanitize=null,object-size,pointer-overflow",
        "-fno-sanitize-recover=all",
    ),
    "thread": ("-fsanitize=thread",),
}
FLAGS = ("-std=c++17", "-O0", "-g1", "-w", "-pthread")  # half the compiling of -O1 -g
LIMIT = 3  # launches of one kernel that are kept: a solve repeats itself


class Recorder:
    """The recorder of an ``EmulatedDevice``: launches by text, the first ``limit`` of each kernel
    of a text."""

    def __init__(self, limit: int = LIMIT):
        self.limit = limit
        self.launches: dict[str, list[bytes]] = {}
        self.kernels: set[str] = set()
        self._counts: dict[tuple[str, str], int] = {}

    def __call__(self, kernel: Any, launch: Any, arguments: list[Any]) -> None:
        self.kernels.add(kernel.name)
        key = kernel.text, kernel.name
        self._counts[key] = self._counts.get(key, 0) + 1
        if self._counts[key] <= self.limit:
            self.launches.setdefault(kernel.text, []).append(_packed(kernel, launch, arguments))


def _packed(kernel: Any, launch: Any, arguments: list[Any]) -> bytes:
    name = kernel.name.encode()
    sizes = struct.pack("=3IQ", *launch.grid, launch.shared)
    parts = [struct.pack("i", len(name)), name, sizes, struct.pack("i", len(arguments))]
    seen: dict[int, int] = {}
    for k, (letter, argument) in enumerate(zip(kernel.signature, arguments, strict=True)):
        if letter in "id":
            parts.append(
                b"i" + struct.pack("i", argument)
                if letter == "i"
                else b"d" + struct.pack("d", argument)
            )
        elif argument is None:
            parts.append(b"n")
        elif argument.size and argument.ctypes.data in seen:
            parts.append(b"s" + struct.pack("i", seen[argument.ctypes.data]))
        else:
            seen[argument.ctypes.data] = k
            parts.append(
                b"a" + struct.pack("=q", argument.nbytes) + np.ascontiguousarray(argument).tobytes()
            )
    return b"".join(parts)


def replay(
    text: str, launches: list[bytes], sanitizer: str, threads: int, crews: int, folder: Path
) -> subprocess.CompletedProcess[str]:
    """The launches of ``text`` again, with that many threads a block and blocks at a time."""
    entries = " ".join(f"ENTRY({name})" for name in emulator.KERNEL.findall(text))
    main = (Path(__file__).parent / "replay.cpp").read_text()
    whole = "\n".join([emulator.program(text), f"#define ENTRIES {entries}", main])
    program = emulator.compile_program(whole, (*FLAGS, *SANITIZERS[sanitizer]), f"-{sanitizer}")
    recorded = folder / "launches.bin"
    recorded.write_bytes(struct.pack("i", len(launches)) + b"".join(launches))
    words = [str(program), str(recorded), str(threads), str(crews)]
    if sanitizer == "thread" and shutil.which("setarch"):
        # ThreadSanitizer wants its own places in memory, which a randomised layout may take
        words = ["setarch", "-R", *words]
    options = {"ASAN_OPTIONS": "detect_leaks=0", "TSAN_OPTIONS": "halt_on_error=1", **os.environ}
    return subprocess.run(words, capture_output=True, text=True, check=False, env=options)
