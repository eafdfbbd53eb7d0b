"""The problem as a compiled library behind CasADi's C interface: what IPOPT and fatrop call,
without Python in between.

adapter.c and interface.c alone are compiled; they call octo's own library.
"""

from __future__ import annotations

import ctypes
import hashlib
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.checks import Array
from octo.errors import DeviceError
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.problem.native_steps import NativeSteps
from octo.problem.neighbours import anchors
from octo.reference.layout import Layout
from octo.reference.program import parameter_vector
from octo.reference.rows import complementarity, limits
from octo.solver.options import SqpOptions

SHAPES = ("x", "p", "scalar", "g", "jacobian", "hessian", "nothing")
_ACTIVE: dict[str, Any] = {}  # by library, what its code points to


class Library:
    """One problem structure, compiled. One solve at a time: the library keeps the point it
    evaluated last.

    Functions of the library may outlive this object: they work on the tables of the last one that
    was activated.

    Parameters
    ----------
    compiled: whose terms are exact: its linearize is the Hessian of the Lagrangian.

    Attributes
    ----------
    path: of the shared library, with CasADi's nlp, nlp_f, nlp_g, nlp_grad_f, nlp_jac_g, nlp_hess_l
        and octo_watch.
    """

    def __init__(self, compiled: CompiledProblem, layout: Layout):
        compiled.check_squares("a reference solver", bounds=True)
        if compiled.library is None:
            raise DeviceError("the compiled reference needs a C compiler (gcc, cc, clang or $CC)")
        self.layout, self.size = layout, layout.variables
        self._tables = _Tables(compiled, layout)
        handle = native.load(_text(compiled.library, layout))
        assert handle is not None
        self.handle, self.path = handle, handle._name
        self.steps = compiled.steps
        numbers = (ctypes.c_double,) * 3
        self.handle.octo_watch_set.argtypes = (*numbers, ctypes.c_int)
        self.handle.octo_log_rows.restype = ctypes.POINTER(ctypes.c_double)
        self.activate()

    def activate(self) -> None:
        """Hand the tables to the library: needed again after another problem of the same structure
        used it."""
        self.handle.octo_adapter_set(ctypes.byref(self._tables.struct))
        _ACTIVE[self.path] = self._tables

    def function(self, name: str) -> ca.Function:
        """nlp_f, nlp_grad_f, … as a CasADi function."""
        return ca.external(name, self.path)

    def begin(self, options: SqpOptions) -> None:
        """Start the clock, and the rule by which octo_watch stops."""
        o, room = options, complementarity(self.steps, options)
        self.handle.octo_watch_set(o.tolerance, o.plateau_change, room, o.plateau)

    def stop(self, stopped: bool = True) -> None:
        """Make every evaluation fail, so that the solver ends; or no longer."""
        self.handle.octo_stop(int(stopped))

    @property
    def settled(self) -> bool:
        """True when octo_watch told the solver to stop."""
        return bool(self.handle.octo_watch_settled())

    def log(self) -> Array:
        """(points, 3) seconds since ``begin``, E, how far g is off its bounds."""
        count = self.handle.octo_log_size()
        return (
            np.ctypeslib.as_array(self.handle.octo_log_rows(), (count, 3)).copy()
            if count
            else np.zeros((0, 3))
        )


SIZES = (
    *("variables", "rows", "numbers", "n", "nodes", "slots", "steps", "terms", "references"),
    *("first_q", "linear", "segment", "tested", "bounded"),
    *("first_slope", "slopes", "products"),
)
INTEGERS = (
    *("node_variable", "place", "row_place", "jacobian_index", "hessian_index"),
    *("linear_row", "linear_column", "fixed", "target", "one", "other"),
)
CONSTANTS = (
    *("node_value", "jacobian_constant", "linear_value", "carry"),
    *("product_value", "lower", "upper"),
)
MEMORY = (
    *("x", "p", "q", "trajectory", "energies", "g", "controls", "C", "A", "b", "H", "lam"),
    *("gradient", "lagrangian", "kept"),
)
TASKS = ("value", "slope", "curvature")
CALLS = ("evaluate", "linearize", "between_values", "between_model")


class _Struct(ctypes.Structure):
    """octo_adapter of adapter.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in SIZES),
        *((name, ctypes.c_void_p) for name in (*INTEGERS, *CONSTANTS, *MEMORY, *TASKS, *CALLS)),
        ("sparsity", ctypes.c_void_p * len(SHAPES)),
    ]


class _Tables:
    """The struct, and the arrays that it points to."""

    def __init__(self, c: CompiledProblem, layout: Layout):
        linear_row, linear_column, linear_value = layout.linear
        given = {
            **{name: getattr(layout, name) for name in (*INTEGERS[:5], *CONSTANTS[:2])},
            "linear_row": linear_row,
            "linear_column": linear_column,
            "linear_value": linear_value,
            "fixed": c.plan.still,
            "carry": None if c.carry is None else c.carry[0],
            **{name: getattr(layout.slopes, name) for name in ("target", "one", "other")},
            "product_value": layout.slopes.value,
            **dict(zip(("lower", "upper"), limits(c, layout.bounded_place), strict=True)),
            **_memory(c, layout),
        }
        kept: dict[str, NDArray] = {}
        for name, array in given.items():
            kind = np.int32 if name in INTEGERS else float
            if array is not None:
                kept[name] = np.ascontiguousarray(array, dtype=kind)
        steps, terms = kept["energies"].shape
        segment = c.basis.steps_per_segment if isinstance(c.basis, Hermite) else 0
        own = layout.variables, layout.rows, len(kept["p"]), c.n, *layout.node_value.shape
        first_q = c.constant.size + c.p.size
        slopes = len(layout.slopes.row), len(layout.slopes.target)
        bounded = len(c.functions.bounded), len(kept["A"]) - slopes[0], *slopes
        linear = c.q.shape[2], first_q, len(linear_value), segment
        sizes = (*own, steps, terms, *linear, layout.tested, *bounded)
        self.struct = _Struct(*sizes)
        self._kept: list[Any] = [*kept.values()]
        for name, array in kept.items():
            setattr(self.struct, name, array.ctypes.data)
        self._set_tasks(c, kept, layout)
        for name in CALLS if c.program.between is not None else CALLS[:2]:
            function = getattr(c.library, f"octo_{name}")
            setattr(self.struct, name, ctypes.cast(function, ctypes.c_void_p).value)
        dense = [_dense(size) for size in (layout.variables, len(kept["p"]), 1, layout.rows)]
        nothing = _dense(len(kept["p"]), full=False)
        shapes = [*dense, layout.jacobian, layout.hessian, nothing]
        self._kept += shapes
        self.struct.sparsity[:] = [shape.ctypes.data for shape in shapes]

    def _set_tasks(self, c: CompiledProblem, kept: dict[str, NDArray], layout: Layout) -> None:
        """Tasks of octo's library over ``kept``; that of second derivatives has its own q, and
        first derivatives beside them."""
        assert c.library is not None
        p, first_q = kept["p"], c.constant.size + c.p.size
        parts = np.split(p, [c.constant.size, first_q, first_q + c.q.size])
        data = replace(
            c.data, p=parts[1][None], q=parts[2].reshape(c.q.shape), row_scale=parts[3][None]
        )
        steps = NativeSteps(c.library, c.plan, data, 1)
        beside = {name: np.empty_like(kept[name]) for name in ("A", "b", "C")}
        fd = np.zeros((c.steps, c.n))
        for name in TASKS:
            task, more = steps.task()
            task.nodes, task.fd = kept["trajectory"].ctypes.data, fd.ctypes.data
            task.terms, task.apart = kept["energies"].ctypes.data, int(layout.stagewise)
            own = {**kept, **beside} if name == "curvature" else kept
            task.a, task.b, task.c = (own[key].ctypes.data for key in ("A", "b", "C"))
            if name == "curvature":
                task.h, task.lam = kept["H"].ctypes.data, kept["lam"].ctypes.data
                task.q = kept["q"].ctypes.data
            elif c.functions.bounded:
                task.rows = kept["C"][layout.tested :].ctypes.data
                task.kept = kept["kept"].ctypes.data
            setattr(self.struct, name, ctypes.addressof(task))
            self._kept += [task, *more]
        self._kept += [fd, *beside.values()]


def _memory(c: CompiledProblem, layout: Layout) -> dict[str, Array]:
    """What the library writes, and the numbers of the problem."""
    if layout.stagewise:
        units, lags, nc = c.steps, 1, 3 * c.n
    else:
        units, lags, nc = c.K, 3, c.nc
    slopes, tested = layout.slopes, layout.tested
    bounded = c.steps * len(c.functions.bounded)
    shapes = {
        "x": (layout.variables,),
        "q": c.q.shape[1:],
        "trajectory": (len(layout.node_value), c.n),
        "energies": (c.steps, len(c.functions.references.terms)),
        "g": (layout.rows,),
        "C": (tested + bounded,),
        "A": (lags * tested * nc + len(slopes.row),),
        "b": (units, nc),
        "H": (units, lags, nc, nc),
        "lam": (tested + bounded,),
        "gradient": (layout.variables,),
        "lagrangian": (layout.variables,),
    }
    size = 0 if c.program.kept is None else c.steps * c.program.kept.size
    between = c.program.between is not None
    controls = anchors(c.plan, c.data)[0] if between else np.zeros(0)
    made = {name: np.zeros(shape) for name, shape in shapes.items()}
    return {**made, "p": parameter_vector(c), "controls": controls, "kept": np.ones(size + 1)}


def _dense(rows: int, full: bool = True) -> NDArray[np.int64]:
    """A column in CasADi's compressed form, full or without a nonzero."""
    count = rows if full else 0
    return np.concatenate([[rows, 1, 0, count], np.arange(count)]).astype(np.int64)


def _text(octos: ctypes.CDLL, layout: Layout) -> str:
    """adapter.c and interface.c, marked with octo's library and the layout: a library of their own
    keeps the last point of each structure."""
    folder = resources.files("octo.reference")
    shape = [layout.place, layout.row_place, layout.node_variable, layout.hessian, layout.jacobian]
    marks = hashlib.sha256(Path(octos._name).stem.encode())
    for array in shape:
        marks.update(np.ascontiguousarray(array).tobytes())
    return "\n".join(
        [
            *(["#define STAGEWISE"] if layout.stagewise else []),
            *((folder / n).read_text(encoding="utf-8") for n in ("adapter.c", "interface.c")),
            f"/* structure {marks.hexdigest()[:16]} */",
        ]
    )
