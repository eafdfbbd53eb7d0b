"""A stage that is code: a look-up in a grid, a query of a mesh, a learned map, which gives its
value and its derivatives itself.

It is said twice, in C (which is CUDA too) and in Python; the two and their derivatives are compared
where the stage is made.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from octo import native
from octo.checks import Array, doubles, flag, instance, numbers, whole
from octo.emit import HEAD
from octo.errors import DeviceError, ProblemError, ShapeError, ValueRangeError

NAME = re.compile(r"[A-Za-z_]\w*")
DEFINED = re.compile(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", re.MULTILINE)
RESERVED = ("octo", "casadi", "main", "v8", "real")  # what a name must not begin with
LARGEST = 10_000  # numbers that it may give: a stack and the shared memory of a GPU hold that many
POINTS = 8  # at which the two are compared
STEP = 1e-5  # of differences
SAME = 1e-9  # relative difference of C and Python
CLOSE = 1e-4  # the same of derivatives and of differences of values
STRICT = ("-Wl,-z,defs",)  # an unknown function is an error of the compiler, not of the loader
ORDERS = ("value", "slopes", "second")


@dataclass(frozen=True, eq=False)
class CodeStage:
    """A function of a few numbers, written as code, for the residual of a term: ``step.call(stage,
    argument)``.

    Parameters
    ----------
    name: of the C function; a C identifier. Other names in ``text`` are best begun with it.
    inputs, outputs: how many numbers it takes and gives.
    text: C that is CUDA and C++ too, doubles alone, with the function ``void NAME(const double *a,
        double *value, double *slopes)``: value (outputs), slopes (outputs, inputs) row by row, or a
        null pointer where they are not asked for. No allocation and no state: threads call it.
    python: the same for NumPy, a (…, inputs) -> value (…, outputs), slopes (…, outputs, inputs).
    second: the code gives second derivatives too: a fourth argument ``double *second`` and a third
        result of ``python``, (outputs, inputs, inputs).
    points: (count, inputs) where the two are compared; by default normally distributed ones.

    Raises
    ------
    ProblemError: C does not compile, C and Python differ, or the derivatives are not those of the
        value. ShapeError, ValueRangeError: a wrong size, or values that are not finite.
    """

    name: str
    inputs: int
    outputs: int
    text: str
    python: Callable[[Array], Sequence[Any]]
    second: bool = False
    points: Array | None = None

    def __post_init__(self) -> None:
        instance("CodeStage.name", self.name, str, "a name")
        word = bool(NAME.fullmatch(self.name)) and self.name != self.name.upper()  # no macro
        if not word or self.name.lower().startswith(RESERVED):
            raise ProblemError(
                f"CodeStage.name is {self.name!r}, must be a C identifier with a small letter that "
                f"does not begin with {', '.join(RESERVED[:-1])} or {RESERVED[-1]}"
            )
        for size in ("inputs", "outputs"):
            whole(f"{self.label}.{size}", getattr(self, size), most=LARGEST)
        instance(f"{self.label}.text", self.text, str, "C text")
        flag(f"{self.label}.second", self.second)
        if not callable(self.python):
            raise ProblemError(f"{self.label}.python is not callable, must be a function of a")
        if self.size > LARGEST:
            raise ValueRangeError(
                f"{self.label} has {self.size} values and derivatives, at most {LARGEST} are held"
            )
        self.check(self.points)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copies: the fields."""
        return {name: value for name, value in self.__dict__.items() if name != "function"}

    @staticmethod
    def table(name: str, values: ArrayLike) -> str:
        """C text of a constant table of doubles, row by row.

        Parameters
        ----------
        name: of the table in C. values: an array of any shape.
        """
        flat = numbers(f"table {name}", values).ravel()
        if not NAME.fullmatch(name) or not flat.size:
            raise ProblemError(f"table {name!r} needs a C identifier as its name, and a number")
        return f"static const double {name}[] = {{{', '.join(map(float.hex, flat.tolist()))}}};\n"

    @property
    def label(self) -> str:
        """What messages call it."""
        return f"CodeStage {self.name}"

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of what it gives: value, slopes and, if any, second derivatives."""
        two = (self.outputs,), (self.outputs, self.inputs)
        return (*two, (self.outputs, self.inputs, self.inputs)) if self.second else two

    @property
    def size(self) -> int:
        """Numbers of all that it gives."""
        return sum(int(np.prod(shape)) for shape in self.shapes)

    @property
    def structure(self) -> tuple[Any, ...]:
        """What tells one stage from another."""
        return self.name, self.inputs, self.outputs, self.second, self.text

    @property
    def c_text(self) -> str:
        """``text``, whose macros end with it."""
        return "\n".join([self.text, *(f"#undef {name}" for name in DEFINED.findall(self.text))])

    def evaluate(self, a: Array) -> tuple[Array, ...]:
        """What ``python`` gives, in ``shapes``.

        Parameters
        ----------
        a: (…, inputs).

        Raises
        ------
        ShapeError: a result has another shape. ProblemError: it fails.
        """
        try:
            made = [np.asarray(part, dtype=float) for part in self.python(a)]
        except Exception as error:  # a user's code may raise anything
            raise ProblemError(
                f"{self.label}.python fails for a {a.shape}: {type(error).__name__}: {error}"
            ) from error
        if len(made) != len(self.shapes):
            raise ProblemError(
                f"{self.label}.python gives {len(made)} arrays, must give "
                f"{', '.join(ORDERS[: len(self.shapes)])}"
            )
        for order, part, shape in zip(ORDERS, made, self.shapes, strict=False):
            if part.shape != (*a.shape[:-1], *shape):
                raise ShapeError(f"{self.label}.python's {order}", part.shape, a.shape[:-1] + shape)
        return tuple(made)

    # -- the checks --------------------------------------------------------------------------------

    def check(self, points: Array | None = None) -> None:
        """Compare C, Python and differences of the values.

        Parameters
        ----------
        points: (count, inputs), by default normally distributed ones.

        Raises
        ------
        OctoError: as where a stage is made.
        """
        if points is None:
            points = np.random.default_rng(0).standard_normal((POINTS, self.inputs))
        a = numbers(f"{self.label}.points", points)
        if a.ndim != 2 or a.shape[1] != self.inputs:
            raise ShapeError(f"{self.label}.points", a.shape, f"(count, {self.inputs})")
        made = self.evaluate(a)
        for order, part in zip(ORDERS, made, strict=False):
            numbers(f"{self.label}.python's {order}", part)
        for low, high in zip(made, made[1:], strict=False):
            self._check_derivatives(a, low, high)
        for order, one, other in zip(ORDERS, made, self._compiled(a), strict=False):
            size = np.abs(one).max(initial=0.0)
            wrong = ~(np.abs(one - other) <= SAME * max(1.0, size))
            if wrong.any():
                at = tuple(int(k) for k in np.argwhere(wrong)[0])
                raise ProblemError(
                    f"{self.label}: {order} {at[1:]} at a = {a[at[0]]} is {other[at]:.9g} in C and "
                    f"{one[at]:.9g} in Python, must be the same"
                )

    def _check_derivatives(self, a: Array, low: Array, high: Array) -> None:
        """``high`` against differences of ``low``, the order below it."""
        name = ORDERS[low.ndim - 1]
        for j in range(self.inputs):
            step = np.zeros(self.inputs)
            step[j] = STEP * max(1.0, float(np.abs(a[:, j]).max(initial=0.0)))
            up, down = (self.evaluate(a + way * step)[low.ndim - 2] for way in (1.0, -1.0))
            expected, found = (up - down) / (2.0 * step[j]), high[..., j]
            size = np.abs(expected).max(initial=0.0) + 1e-6 * np.abs(low).max(initial=0.0)
            wrong = ~(np.abs(found - expected) <= CLOSE * size + 1e-9)
            if wrong.any():
                at = tuple(int(k) for k in np.argwhere(wrong)[0])
                raise ProblemError(
                    f"{self.label}: {name} {(*at[1:], j)} at a = {a[at[0]]} is {found[at]:.6g}, "
                    f"differences give {expected[at]:.6g}; where the function has a kink, give "
                    "other points"
                )

    def _compiled(self, a: Array) -> tuple[Array, ...]:
        """What C gives; nothing without a compiler."""
        text = f'{HEAD}#line 1 "{self.name}"\n{self.c_text}\n{self._caller}'
        try:
            library = native.load(text, STRICT)
        except DeviceError as error:
            _, failed, said = str(error).partition("could not compile octo's text (")
            if not failed:
                raise
            said = said.partition("): ")[2]
            raise ProblemError(f"{self.label}.text does not compile: {said}") from error
        if library is None:
            return ()
        given = doubles("points", a, a.shape)
        made = tuple(np.full((len(a), *shape), np.nan) for shape in self.shapes)
        for lowest in range(len(made)):  # the orders beyond are not asked for
            kept = [part.ctypes.data if k <= lowest else None for k, part in enumerate(made)]
            library.octo_stage(
                ctypes.c_int(len(a)),
                ctypes.c_void_p(given.ctypes.data),
                *map(ctypes.c_void_p, kept),
            )
            numbers(f"{self.label}.text's {ORDERS[lowest]}", made[lowest])
        return made

    @property
    def _caller(self) -> str:
        """C text that calls it at many points."""
        names = ORDERS[: len(self.shapes)]
        sizes = [int(np.prod(shape)) for shape in self.shapes]
        pointers = ", ".join(f"double *{name}" for name in names)
        each = ", ".join(
            f"{name} ? {name} + k * {n} : 0" for name, n in zip(names, sizes, strict=True)
        )
        return (
            f"void octo_stage(int count, const double *a, {pointers}) {{\n"
            f"  for (int k = 0; k < count; ++k) {self.name}(a + k * {self.inputs}, {each});\n}}\n"
        )

    # -- for CasADi --------------------------------------------------------------------------------

    @cached_property
    def function(self) -> ca.Function:
        """``python`` as a function of CasADi's MX, with its derivatives; second ones by differences
        where there are none."""
        return _Called(self, 0)


class _Called(ca.Callback):
    """a -> an order of what a stage gives: (outputs,), (outputs, inputs), (outputs·inputs, inputs)
    with the rows as CasADi counts the entries of the one before."""

    def __init__(self, stage: CodeStage, order: int):
        ca.Callback.__init__(self)
        self._stage, self._order = stage, order
        self._next = _Called(stage, order + 1) if order + 1 < len(stage.shapes) else None
        options = {} if self._next is not None else {"enable_fd": True}
        self.construct(f"stage_{ORDERS[order]}", options)  # no C name is refused

    def get_sparsity_in(self, k: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._stage.inputs, 1)

    def get_sparsity_out(self, k: int) -> ca.Sparsity:
        stage = self._stage
        rows = stage.outputs * stage.inputs ** max(0, self._order - 1)
        return ca.Sparsity.dense(rows, 1 if self._order == 0 else stage.inputs)

    def eval(self, given: Sequence[ca.DM]) -> list[ca.DM]:
        made = self._stage.evaluate(given[0].full().ravel())[self._order]
        if self._order == 2:
            made = made.transpose(1, 0, 2).reshape(-1, self._stage.inputs)
        return [ca.DM(made)]

    def has_jacobian(self) -> bool:
        return self._next is not None

    def get_jacobian(self, name: str, inputs: list[str], outputs: list[str], options: Any) -> Any:
        assert self._next is not None
        a, value = ca.MX.sym("a", self.size1_in(0)), ca.MX.sym("value", *self.size_out(0))
        return ca.Function(name, [a, value], [self._next(a)], inputs, outputs, options)
