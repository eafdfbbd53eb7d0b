"""Arrays of NumPy or of a device, under one set of words.

What is large (batch, K, …) stays where the kernels run; the scalars of the algorithm, (batch,) or
(batch, K), are NumPy arrays: a decision costs one small copy, and then no launch.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = Any  # numpy.ndarray, or a device's
Numbers = NDArray[Any]
copies = 0  # from a device to the host, so far


def array_module(array: Array) -> Any:
    """The module whose functions take ``array``: numpy, or cupy for a device array (it is not
    imported here)."""
    return sys.modules[type(array).__module__.partition(".")[0]]


def host(array: Array) -> Numbers:
    """``array`` as a NumPy array: itself, or a copy from the device, which this waits for."""
    global copies
    if isinstance(array, np.ndarray):
        return array
    copies += 1
    return np.asarray(array.get())


def hosts(*values: Array) -> list[Numbers]:
    """Arrays of one shape in NumPy, a device's in one copy."""
    if isinstance(values[0], np.ndarray):
        return list(values)
    return list(host(array_module(values[0]).stack(values)))


def like(values: Numbers, array: Array) -> Array:
    """NumPy ``values`` where ``array`` is."""
    return values if isinstance(array, np.ndarray) else array_module(array).asarray(values)


def inner(a: Array, b: Array) -> Array:
    """(batch,) inner products of two arrays (batch, …), where they are."""
    return (a * b).reshape(len(a), -1).sum(axis=1)


def largest(v: Array) -> Array:
    """(batch,) ‖·‖∞ of v (batch, …), where it is; 0 where it has no entries."""
    return abs(v).reshape(len(v), -1).max(axis=1) if v.size else array_module(v).zeros(len(v))


def size(v: Array) -> Numbers:
    """(batch,) ‖·‖₁ of v (batch, …)."""
    return host(abs(v).reshape(len(v), -1).sum(axis=1))


def scaled(factor: Numbers, v: Array) -> Array:
    """factor (batch,) times v (batch, K, …), a new array."""
    if len(factor) and every(factor == factor[0]):
        return float(factor[0]) * v
    return like(factor.reshape(-1, *(1,) * (v.ndim - 1)), v) * v


def some(mask: NDArray[np.bool_]) -> bool:
    """Whether any is set: by its bytes, for on a few members NumPy's any() and all() take ten times
    as long."""
    return b"\1" in mask.tobytes()


def every(mask: NDArray[np.bool_]) -> bool:
    """Whether all are set."""
    return b"\0" not in mask.tobytes()


def choose(mask: NDArray[np.bool_], one: Array, other: Array | float) -> Array:
    """``one`` (batch, …) where mask (batch,), ``other`` elsewhere; an array itself where all
    members come from it."""
    if every(mask):
        return one
    if not (some(mask) or isinstance(other, float)):
        return other
    return array_module(one).where(like(mask.reshape(-1, *(1,) * (one.ndim - 1)), one), one, other)
