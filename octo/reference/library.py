"""The problem as a compiled library behind CasADi's C interface: what IPOPT and fatrop call,
without Python in between."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Sequence
from importlib import resources
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.long import brisk
from octo.errors import DeviceError
from octo.problem.compiled import CompiledProblem
from octo.reference.costs import ExactCosts, exact_costs, patterns
from octo.reference.layout import Layout, Places, places
from octo.reference.program import parameter_vector

Array = NDArray[np.float64]
SHAPES = ("x", "p", "scalar", "g", "jacobian", "hessian", "nothing")
_ACTIVE: dict[str, list[Any]] = {}  # by library, the arrays that its code points to


class Library:
    """One problem structure, compiled. One solve at a time: the library keeps the point it
    evaluated last.

    Functions of the library may outlive this object: they work on the tables of the last one that
    was activated.

    Attributes
    ----------
    path: of the shared library, with CasADi's nlp, nlp_f, nlp_g, nlp_grad_f, nlp_jac_g, nlp_hess_l
        and octo_watch.
    """

    def __init__(self, compiled: CompiledProblem, layout: Layout):
        compiled.check_squares("a reference solver")
        costs = exact_costs(compiled)
        hessian, jacobian = patterns(compiled, costs)
        self.layout, self.places = layout, places(layout, compiled.n, hessian, jacobian)
        self.size, self.numbers = layout.blocks * compiled.n, len(parameter_vector(compiled))
        text = _text(compiled, costs, layout.stagewise)
        shape = [
            layout.local,
            layout.weight,
            layout.test_row,
            layout.test_value,
            self.places.jacobian,
            self.places.hessian,
        ]
        mark = hashlib.sha256(
            b"".join(np.ascontiguousarray(a).tobytes() for a in shape)
        ).hexdigest()[:16]
        handle = native.load(f"{text}\n/* structure {mark} */\n")
        if handle is None:
            raise DeviceError("the compiled reference needs a C compiler (gcc, cc, clang or $CC)")
        self.handle, self.path = handle, handle._name
        self.handle.octo_watch_set.argtypes = (ctypes.c_double, ctypes.c_double, ctypes.c_int)
        self.handle.octo_log_rows.restype = ctypes.POINTER(ctypes.c_double)
        self._tables, self._kept = _tables(compiled, layout, self.places, self.size, self.numbers)
        self.activate()

    def activate(self) -> None:
        """Hand the tables to the library: needed again after another problem of the same structure
        used it."""
        if self.handle.octo_nlp_set(ctypes.byref(self._tables)) != 0:
            raise MemoryError("the reference library could not allocate its work arrays")
        _ACTIVE[self.path] = self._kept

    def function(self, name: str) -> ca.Function:
        """nlp_f, nlp_grad_f, … as a CasADi function."""
        return ca.external(name, self.path)

    def begin(self, tolerance: float, change: float, plateau: int) -> None:
        """Start the clock, and the rule by which octo_watch stops."""
        self.handle.octo_watch_set(tolerance, change, plateau)

    def stop(self, stopped: bool = True) -> None:
        """Make every evaluation fail, so that the solver ends; or no longer."""
        self.handle.octo_stop(int(stopped))

    @property
    def settled(self) -> bool:
        """True when octo_watch told the solver to stop."""
        return bool(self.handle.octo_watch_settled())

    def log(self) -> Array:
        """(points, 3) seconds since ``begin``, E, ‖g‖∞."""
        count = self.handle.octo_log_size()
        return (
            np.ctypeslib.as_array(self.handle.octo_log_rows(), (count, 3)).copy()
            if count
            else np.zeros((0, 3))
        )


class _Tables(ctypes.Structure):
    """octo_nlp_tables of nlp.c."""

    _fields_ = [
        *(
            (name, ctypes.c_int)
            for name in ("steps", "local", "tests", "variables", "rows", "pairs", "couples")
        ),
        *((name, ctypes.c_int) for name in ("linear", "stagewise")),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "local_block",
                "pair",
                "test_row",
                "couple",
                "linear_row",
                "linear_column",
                "jacobian_index",
                "hessian_index",
                "weight",
                "test_value",
                "linear_value",
                "jacobian_constant",
                "carry",
            )
        ),
        ("sparsity", ctypes.c_void_p * len(SHAPES)),
    ]


def _tables(
    compiled: CompiledProblem, layout: Layout, at: Places, size: int, numbers: int
) -> tuple[_Tables, list[Any]]:
    """The tables, and the arrays that must outlive them."""
    arrays = [
        layout.local,
        at.pair,
        layout.test_row,
        at.test,
        *layout.linear[:2],
        at.jacobian_index,
        at.hessian_index,
        layout.weight,
        layout.test_value,
        layout.linear[2],
        at.jacobian_constant,
    ]
    shapes = [
        _dense(size),
        _dense(numbers),
        _dense(1),
        _dense(layout.rows),
        at.jacobian,
        at.hessian,
        _dense(numbers, full=False),
    ]
    kept = [np.ascontiguousarray(a) for a in (*arrays, *shapes)]
    pointers = [a.ctypes.data for a in kept]
    carry = None if layout.carry is None else np.ascontiguousarray(layout.carry)
    steps, local = layout.local.shape
    sparsity = (ctypes.c_void_p * len(SHAPES))(*pointers[len(arrays) :])
    table = _Tables(
        steps,
        local,
        layout.test_row.shape[1],
        size,
        layout.rows,
        at.pairs,
        at.tests,
        len(layout.linear[2]),
        int(layout.stagewise),
        *pointers[: len(arrays)],
        None if carry is None else carry.ctypes.data,
        sparsity,
    )
    return table, [*kept, carry]


def _dense(rows: int, full: bool = True) -> NDArray[np.int64]:
    """A column in CasADi's compressed form, full or without a nonzero."""
    count = rows if full else 0
    return np.concatenate([[rows, 1, 0, count], np.arange(count)]).astype(np.int64)


def _text(compiled: CompiledProblem, costs: ExactCosts, stagewise: bool) -> str:
    """C text: dynamics, generated costs, their tables, and the files of this folder."""
    generator = ca.CodeGenerator("octo_reference.c", {"with_header": False, "casadi_int": "int"})
    made = [*costs.step, *costs.contact]
    for function in made:
        generator.add(function)
    generated = brisk(str(generator.dump()), max(function.n_instructions() for function in made))
    names = (
        "CASADI_CODEGEN_PREFIX",
        "CASADI_PREFIX",
        "CASADI_NAMESPACE_CONCAT",
        "_CASADI_NAMESPACE_CONCAT",
    )
    return "\n".join(
        [
            compiled.dynamics.text(),
            *(f"#undef {name}" for name in names),
            "#define CASADI_CODEGEN_PREFIX octo_reference_",
            generated,
            *(["#define STAGEWISE"] if stagewise else []),
            *_constants(compiled, costs, made),
            *(
                (resources.files("octo.reference") / name).read_text(encoding="utf-8")
                for name in ("nodes.c", "step_costs.c", "nlp.c", "interface.c")
            ),
        ]
    )


def _constants(
    compiled: CompiledProblem, costs: ExactCosts, made: Sequence[ca.Function]
) -> list[str]:
    """Sizes as macros, index tables and masses as constant arrays."""
    functions, dynamics = compiled.functions, compiled.dynamics
    sizes = {
        "NU": compiled.nu,
        "MU": compiled.m,
        "NQ": compiled.q.shape[2],
        "NTERM": len(functions.references.terms),
        "NCENTER": costs.centers,
        "NW": compiled.nu + costs.centers,
        "NZ": costs.sparsity.nnz(),
        "NFC": len(functions.contact_spheres),
        "CR": 0 if functions.contact is None else len(functions.contact.terms),
        "EXACT_W": max(f.sz_w() for f in made),
        "EXACT_IW": max(f.sz_iw() for f in made),
    }
    integers: dict[str, Any] = {
        "ref_actuated": dynamics.actuated,
        "ref_unactuated": dynamics.unactuated,
        "exact_row": costs.sparsity.row(),
        "exact_column": costs.sparsity.get_col(),
    }
    numbers: dict[str, Any] = {}
    if isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        spheres = [robot.contacts[k] for k in functions.contact_spheres]
        integers["touch_body"] = [sphere.body for sphere in spheres]
        integers["touch_dof"] = [
            robot.path[sphere.body][-1] if robot.path[sphere.body] else -1 for sphere in spheres
        ]
        numbers = {
            "touch_sphere": [v for sphere in spheres for v in (*sphere.position, sphere.radius)],
            "touch_use": ()
            if functions.contact is None
            else functions.contact.use.astype(float).ravel(),
            "body_mass": robot.masses,
            "body_com": [v for body in robot.bodies for v in body.com],
        }
        sizes_of_mass = f"static const double octo_mass = {float(robot.mass).hex()};"
    else:
        sizes_of_mass = ""
    lines = [f"#undef {name}\n#define {name} {value}" for name, value in sizes.items()]
    for name, values in integers.items():
        lines.append(
            f"static const int octo_{name}[] = {{{', '.join(str(int(v)) for v in values) or '0'}}};"
        )
    for name, values in numbers.items():
        lines.append(
            f"static const double octo_{name}[] = "
            f"{{{', '.join(float(v).hex() for v in values) or '0.0'}}};"
        )
    return [*lines, sizes_of_mass]
