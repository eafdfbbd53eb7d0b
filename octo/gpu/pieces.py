"""The costs of a step, cut into pieces that threads of a block evaluate side by side.

One function of all terms and of all their derivatives is a long chain for one thread, and spills. A
piece over the state is the value of one term, or its derivatives with respect to one of (x_next, x,
x_prev, u): for one thread. A piece over contacts is the value or the derivatives of their terms:
for a thread for each contact. What needs many numbers at the same time is halved. Sines and cosines
of coordinates, which most pieces ask for, are computed once, by all threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.codegen import integers, macros
from octo.emit import instructions, switch
from octo.problem.codegen import CostFunctions
from octo.problem.contact_model import BLOCKS, ContactFunctions

# numbers that a piece may need at the same time; a thread has registers for 127, and some are
# constants
LIVE = 130
LIVE_OF_CONTACT = 84  # the same of a contact's: with 110 the kernel spills
TRIGONOMETRY = {ca.OP_SIN: 0, ca.OP_COS: 1}
# inputs of the costs' functions whose sines and cosines are shared: x_next, x, x_prev, q
ANGULAR = (0, 1, 2, 5)

Angle = tuple[int, int, float]


@dataclass(frozen=True, eq=False)
class Pieces:
    """state, contact: functions and the place of what they write: those of values (r), then those
    of derivatives.

    angles: (input, element, what is added to it) whose sine and cosine are an input of ``state``,
    the last one but for v.
    rows, columns (NZ,): of the derivatives over the state, those with respect to u last.
    """

    state: _Cut
    contact: _Cut
    angles: list[Angle]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @classmethod
    def of(cls, functions: CostFunctions) -> Pieces:
        """The pieces of all terms."""
        inputs = functions.state.sx_in()
        r, terms = functions.state(*inputs), np.array(functions.state_terms, dtype=int)
        own = [np.flatnonzero(terms == term) for term in dict.fromkeys(terms.tolist())]
        whole = [(r[term.tolist()], int(term[0])) for term in own]
        entry_rows: list[int] = []
        entry_columns: list[int] = []
        values, first = len(whole), 0  # of which the first are values
        for group in inputs[:4]:
            for term in own:
                jac = functions.calls.jacobian(r[term.tolist()], inputs, group)
                if jac.nnz():
                    whole.append((ca.vertcat(*jac.nonzeros()), len(entry_rows)))
                    entry_rows += [int(term[k]) for k in jac.sparsity().row()]
                    entry_columns += [first + k for k in jac.sparsity().get_col()]
            first += group.numel()
        made = _Rewritten(inputs, [piece for piece, _ in whole])
        columns = [(output, at) for output, (_, at) in zip(made.outputs, whole, strict=True)]
        given = [*inputs[:6], made.sines, *inputs[6:]]
        state = _Cut.of("piece", given, [columns[:values], columns[values:]], LIVE)
        places = np.array(entry_rows, dtype=int), np.array(entry_columns, dtype=int)
        return cls(state, _contact_pieces(functions.contact), made.angles, *places)

    @property
    def functions(self) -> list[ca.Function]:
        return [*self.state.functions, *self.contact.functions]

    def text(self) -> str:
        """C text that calls piece k; the functions stand before it."""
        columns = list(zip(*self.angles, strict=True)) or [(0,), (0,), (0.0,)]
        source, element, offset = (", ".join(map(repr, column)) for column in columns)
        return "\n".join(
            [
                f"#define ANGLES {len(self.angles)}",
                f"static const int octo_angle_input[] = {{{source}}}, octo_angle_element[] = "
                f"{{{element}}};",
                f"static const double octo_angle_offset[] = {{{offset}}};",
                self.state.text("VALUES", "PIECES"),
                self.contact.text(
                    "CONTACT_VALUES", "CONTACT_SLOPES", "CONTACT_MODEL", "CONTACT_PIECES"
                ),
            ]
        )


@dataclass(frozen=True, eq=False)
class _Cut:
    """Functions of one output each, and the place from which on it is written; ``ends``: where each
    kind of them ends."""

    name: str
    functions: list[ca.Function]
    at: list[int]
    ends: list[int]

    @classmethod
    def of(
        cls,
        name: str,
        inputs: Sequence[ca.SX],
        kinds: Sequence[Sequence[tuple[ca.SX, int]]],
        live: int,
    ) -> _Cut:
        """Of kinds of columns with their places, halved until they need no more than ``live``
        numbers at the same time."""
        made = cls(name, [], [], [])
        for columns in kinds:
            for column, place in columns:
                made._add(list(inputs), column, place, live)
            made.ends.append(len(made.functions))
        return made

    def _add(self, inputs: list[ca.SX], output: ca.SX, place: int, live: int) -> None:
        name = f"octo_{self.name}_{len(self.functions)}"
        function = ca.Function(name, inputs, [output], {"cse": True})
        half = output.numel() // 2
        if function.sz_w() > live and half:
            self._add(inputs, output[:half], place, live)
            self._add(inputs, output[half:], place + half, live)
        else:
            self.functions.append(function)
            self.at.append(place)

    def text(self, *ends: str) -> str:
        """C text of a call of piece k, and of ``ends`` as macros."""
        sizes = macros(dict(zip(ends, self.ends, strict=True)))
        name = f"octo_{self.name}"
        return f"{sizes}\n{integers(f'{self.name}_at', self.at)}\n{switch(name, self.functions)}\n"


def _contact_pieces(contact: ContactFunctions | None) -> _Cut:
    """Values; y'; what is left of Gauss and Newton's model; what is left of the exact one. Places:
    model.cu's TOUCHED."""
    if contact is None:
        return _Cut("contact_piece", [], [], [0, 0, 0, 0])
    own = contact.factors
    slopes, bend = ca.vec(ca.densify(own.slopes).T), 18 * own.size
    square = bend + own.bend.numel()
    blocks = [(own.bend[36 * k : 36 * k + 36], bend + 36 * k) for k in range(len(BLOCKS))]
    kinds = [
        [(contact.value(*own.inputs[:-1]), 0)],
        [(slopes, 0)],
        [(own.model, square)],
        [*blocks, (own.exact, square)],
    ]
    return _Cut.of("contact_piece", own.inputs, kinds, LIVE_OF_CONTACT)


class _Rewritten:
    """Outputs with symbols in the place of sines and cosines of an element of the inputs ANGULAR,
    or of one plus a number.

    sines: the symbols, sine before cosine of each of ``angles``.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]):
        self._pairs: dict[Angle, tuple[ca.SX, ca.SX]] = {}
        self._value: dict[int, ca.SX] = {}
        self._angle: dict[int, Angle | None] = {}
        given = [symbol.elements() for symbol in inputs]
        made = [[ca.SX(0)] * output.numel() for output in outputs]
        function = ca.Function("whole", list(inputs), list(outputs), {"cse": True})
        for k, (operation, take, put) in enumerate(instructions(function)):
            if operation == ca.OP_OUTPUT:
                made[put[0]][put[1]] = self._value[take[0]]
            elif operation == ca.OP_INPUT:
                angle = (take[0], take[1], 0.0) if take[0] in ANGULAR else None
                self._keep(put[0], given[take[0]][take[1]], angle)
            elif operation == ca.OP_CONST:
                self._keep(put[0], ca.SX(function.instruction_constant(k)), None)
            else:
                self._apply(operation, take, put[0])
        self.outputs, self.angles = [ca.vertcat(*column) for column in made], list(self._pairs)
        symbols = [symbol for pair in self._pairs.values() for symbol in pair]
        self.sines = ca.vertcat(*symbols) if symbols else ca.SX.sym("none")

    def _keep(self, place: int, value: ca.SX, angle: Angle | None) -> None:
        self._value[place], self._angle[place] = value, angle

    def _apply(self, operation: int, take: Sequence[int], place: int) -> None:
        values, angle = [self._value[k] for k in take], self._angle[take[0]]
        if operation in TRIGONOMETRY and angle is not None:
            sine, cosine = (f"{name}_angle{len(self._pairs)}" for name in ("sin", "cos"))
            pair = self._pairs.setdefault(angle, (ca.SX.sym(sine), ca.SX.sym(cosine)))
            self._keep(place, pair[TRIGONOMETRY[operation]], None)
            return
        moved = None
        if operation in (ca.OP_ADD, ca.OP_SUB) and angle is not None and values[1].is_constant():
            by = float(values[1]) if operation == ca.OP_ADD else -float(values[1])
            moved = (angle[0], angle[1], angle[2] + by)
        apply = ca.SX.unary if len(values) == 1 else ca.SX.binary
        self._keep(place, apply(operation, *values), moved)
