"""What this machine can solve on."""

from __future__ import annotations

from octo import native
from octo.gpu import cuda, nvrtc


def devices() -> dict[str, str]:
    """The devices by name, and what each is; behind "cannot be used:" why it is none here."""
    words = native.compiler()
    how = f"C compiled by {words[0]}" if words else "no C compiler: slow"
    known = {"cpu": f"{native.cores()} cores, {how}"}
    reason = cuda.reason()
    if reason is None:
        gpu = cuda.device()
        known["cuda"] = (
            f"{gpu.name}, {gpu.architecture}, {gpu.free_bytes() / 1e9:.1f} GB free, NVRTC "
            f"{nvrtc.version()}"
        )
    else:
        known["cuda"] = f"cannot be used: {reason}"
    return known
