"""CUDA text to machine code with NVRTC's wheel: no driver, GPU or toolkit is needed."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path

from octo.errors import DeviceError, MissingExtraError

# CasADi's C text has no execution spaces: everything that is not a kernel is device code. Line
# numbers keep its errors legible.
OPTIONS = ("-default-device", "-std=c++17", "-Xptxas", "-v")


@dataclass(frozen=True)
class Binary:
    """A compiled text: the cubin, and the compiler's whole log, with what ptxas says of each
    kernel."""

    cubin: bytes
    log: str


def compile_text(
    text: str, architecture: str = "sm_90", options: tuple[str, ...] = OPTIONS
) -> Binary:
    """Machine code of ``text`` for one real architecture; refuses with the compiler's log."""
    library = _library()
    program = ctypes.c_void_p()
    own = (ctypes.byref(program), text.encode(), b"octo.cu", 0, None, None)
    _check(library, library.nvrtcCreateProgram(*own))
    try:
        words = [word.encode() for word in (f"--gpu-architecture={architecture}", *options)]
        argv = (ctypes.c_char_p * len(words))(*words)
        status = library.nvrtcCompileProgram(program, len(words), argv)
        log = _read(library, "ProgramLog", program).rstrip(b"\0").decode(errors="replace")
        if status != 0:
            raise DeviceError(
                f"NVRTC could not compile octo's text for {architecture}: {log.strip()[:2000]}"
            )
        return Binary(_read(library, "CUBIN", program), log)
    finally:
        library.nvrtcDestroyProgram(ctypes.byref(program))


@functools.cache
def version() -> str:
    """Of NVRTC, as "13.0"."""
    major, minor = ctypes.c_int(), ctypes.c_int()
    _check(_library(), _library().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor)))
    return f"{major.value}.{minor.value}"


@functools.cache
def _library() -> ctypes.CDLL:
    """NVRTC of the wheel, of $CUDA_PATH, or of the system's search path."""
    spec = importlib.util.find_spec("nvidia")
    wheel = spec.submodule_search_locations or () if spec else ()
    for folder in filter(None, (*wheel, os.environ.get("CUDA_PATH"), "/usr/local/cuda/lib64")):
        for path in sorted(Path(folder).rglob("libnvrtc.so.*"), reverse=True):
            for builtins in path.parent.glob("libnvrtc-builtins.so.*"):
                # NVRTC opens it by name, and the wheel's folder is on no search path
                ctypes.CDLL(str(builtins))
            return ctypes.CDLL(str(path))
    found = ctypes.util.find_library("nvrtc")
    if found is None:
        raise MissingExtraError("compiling for the GPU", "cuda13")
    return ctypes.CDLL(found)


def _check(library: ctypes.CDLL, status: int) -> None:
    if status != 0:
        library.nvrtcGetErrorString.restype = ctypes.c_char_p
        raise DeviceError(f"NVRTC: {library.nvrtcGetErrorString(status).decode()}")


def _read(library: ctypes.CDLL, what: str, program: ctypes.c_void_p) -> bytes:
    size = ctypes.c_size_t()
    _check(library, getattr(library, f"nvrtcGet{what}Size")(program, ctypes.byref(size)))
    buffer = ctypes.create_string_buffer(size.value)
    _check(library, getattr(library, f"nvrtcGet{what}")(program, buffer))
    return buffer.raw
