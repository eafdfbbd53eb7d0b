"""What this machine can solve on, and which of it a solve takes."""

from __future__ import annotations

import logging
from functools import cache

from octo import native
from octo.checks import one_of
from octo.errors import DeviceError
from octo.gpu import cuda, nvrtc
from octo.gpu.backend import DeviceBackend
from octo.solver.backend import CPU, Backend

DEVICES = ("auto", "cpu", "cuda")
LOG = logging.getLogger("octo")


def devices() -> dict[str, str]:
    """The devices by name, and what each is; behind "cannot be used:" why it is none here."""
    words = native.compiler()
    how = f"C compiled by {words[0]}" if words else "no C compiler: slow"
    known = {"cpu": f"{native.cores()} cores, {how}"}
    reason = cuda.reason()
    if reason is None:
        gpu = cuda.device()
        free = f"{gpu.free_bytes() / 1e9:.1f} GB free"
        known["cuda"] = f"{gpu.name}, {gpu.architecture}, {free}, NVRTC {nvrtc.version()}"
    else:
        known["cuda"] = f"cannot be used: {reason}"
    return known


@cache
def say_cpu(reason: str) -> None:
    """Log why "auto" is the CPU, once for each reason."""
    LOG.info("using the CPU: %s", reason)


def check_device_name(device: object) -> None:
    """Refuse what is no device. The nearest name would be a bad guess: that of "gpu" is "cpu"."""
    hint = "valid: cpu, cuda (an NVIDIA GPU), auto (a GPU if there is one)"
    one_of("device", device, DEVICES, hint)


def resolve_device(device: str) -> str:
    """ "cuda", or "cpu"; for "auto" the log says why. DeviceError: "cuda" cannot be used."""
    check_device_name(device)
    if device == "cpu":
        return "cpu"
    reason = cuda.reason()
    if reason is None:
        return "cuda"
    if device == "cuda":
        raise DeviceError(f"device 'cuda' cannot be used: {reason}; try device 'cpu'")
    say_cpu(reason)
    return "cpu"


def backend_of(device: str) -> Backend:
    """Where the arrays of a solve live."""
    return CPU if resolve_device(device) == "cpu" else _cuda_backend()


@cache
def _cuda_backend() -> DeviceBackend:
    """Once per process: it keeps what was compiled."""
    return DeviceBackend(cuda.device())
