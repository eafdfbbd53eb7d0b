"""An array module that is as unforgiving as CuPy: what lies here and what lies in NumPy do not mix,
and every copy to the host is counted. With it, code that only ever met NumPy shows where a GPU
would refuse it."""

from __future__ import annotations

from typing import Any

import numpy as np

copies = 0  # to the host: each of them waits for a device
# a graph is recorded: nothing may be computed, allocated or copied by this module
capturing = False


def _bare(value: Any) -> Any:
    """The NumPy array behind an operand: another of this module, or a Python number."""
    if isinstance(value, ndarray):
        return value._values
    if isinstance(value, np.ndarray) and value.ndim > 0:
        raise TypeError("a NumPy array meets an array of the device")
    if isinstance(value, tuple):
        return tuple(_bare(part) for part in value)
    if isinstance(value, list):
        raise TypeError("a list meets an array of the device")
    return value


def _legal() -> None:
    if capturing:
        raise RuntimeError(
            "an array is computed while a graph is recorded: its memory would be given away "
            "before the graph runs"
        )


def _made(value: Any) -> Any:
    _legal()
    return ndarray(np.asarray(value))


def _counted() -> None:
    global copies
    _legal()
    copies += 1


class ndarray:  # noqa: N801  (the name CuPy's has)
    __array_ufunc__ = None

    def __init__(self, values: np.ndarray):
        self._values = values

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("implicit conversion to a NumPy array is not allowed")

    def get(self) -> np.ndarray:
        _counted()
        return self._values.copy()

    def get_view(self) -> np.ndarray:
        return self._values

    T = property(lambda self: _made(self._values.T))
    shape = property(lambda self: self._values.shape)
    ndim = property(lambda self: self._values.ndim)
    size = property(lambda self: self._values.size)
    dtype = property(lambda self: self._values.dtype)
    flags = property(lambda self: self._values.flags)

    def __len__(self) -> int:
        return len(self._values)

    def __bool__(self) -> bool:
        _counted()
        return bool(self._values)

    def __getitem__(self, key: Any) -> Any:
        return _made(self._values[_bare(key)])

    def __setitem__(self, key: Any, value: Any) -> None:
        _legal()
        self._values[_bare(key)] = _bare(value)

    def __abs__(self) -> Any:
        return _made(np.abs(self._values))

    def __neg__(self) -> Any:
        return _made(-self._values)

    def __invert__(self) -> Any:
        return _made(~self._values)


def _operator(name: str) -> Any:
    def apply(self: ndarray, other: Any) -> Any:
        return _made(getattr(self._values, name)(_bare(other)))

    return apply


for _name in ("add", "sub", "mul", "truediv", "pow", "matmul"):
    setattr(ndarray, f"__{_name}__", _operator(f"__{_name}__"))
    setattr(ndarray, f"__r{_name}__", _operator(f"__r{_name}__"))
for _name in ("and", "or", "eq", "ne", "lt", "le", "gt", "ge"):
    setattr(ndarray, f"__{_name}__", _operator(f"__{_name}__"))


def _in_place(name: str) -> Any:
    def apply(self: ndarray, other: Any) -> Any:
        _legal()
        getattr(self._values, name)(_bare(other))
        return self

    return apply


for _name in ("iadd", "isub", "imul", "itruediv"):
    setattr(ndarray, f"__{_name}__", _in_place(f"__{_name}__"))


def _method(name: str) -> Any:
    def apply(self: ndarray, *arguments: Any, **named: Any) -> Any:
        return _made(getattr(self._values, name)(*(_bare(a) for a in arguments), **named))

    return apply


for _name in ("sum", "max", "min", "any", "all", "reshape", "copy", "astype"):
    setattr(ndarray, _name, _method(_name))


def asarray(values: Any, dtype: Any = None) -> ndarray:
    """From the host, as CuPy's."""
    return values if isinstance(values, ndarray) else ndarray(np.array(values, dtype=dtype))


array = asarray


def _function(name: str) -> Any:
    def apply(*arguments: Any, **named: Any) -> Any:
        return _made(getattr(np, name)(*(_bare(a) for a in arguments), **named))

    return apply


for _name in (
    "full",
    "zeros",
    "ones",
    "zeros_like",
    "where",
    "isfinite",
    "argmax",
    "ascontiguousarray",
    "maximum",
    "minimum",
    "clip",
    "log",
    "sqrt",
    "abs",
    "arange",
    "eye",
    "swapaxes",
    "cos",
    "sin",
    "exp",
    "tanh",
    "broadcast_to",
):
    globals()[_name] = _function(_name)


class linalg:  # noqa: N801  (the name CuPy's has)
    @staticmethod
    def eigh(matrix: ndarray) -> tuple[ndarray, ndarray]:
        values, vectors = np.linalg.eigh(_bare(matrix))
        return _made(values), _made(vectors)


def stack(arrays: Any, axis: int = 0) -> ndarray:
    return _made(np.stack([_bare(array) for array in arrays], axis=axis))


def concatenate(arrays: Any, axis: int = 0) -> ndarray:
    return _made(np.concatenate([_bare(array) for array in arrays], axis=axis))


nan, inf = np.nan, np.inf
