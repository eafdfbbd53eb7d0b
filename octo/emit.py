"""SX functions as C, instruction by instruction: over ``real``, a vector with one time step in each
lane (lanes.c), or over numbers, which is CUDA too. CasADi's own text asks of every argument whether
it is there, and a compiler pays for that.

An operation without an entry in the tables below is refused by name: nothing is guessed about the
text.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import casadi as ca

from octo.errors import ModelError

# of every text
HEAD = """#ifndef __CUDACC_RTC__
#include <math.h>
#include <stddef.h>
#elif !defined(NAN)
#define NAN __longlong_as_double(0x7ff8000000000000LL)
#define INFINITY __longlong_as_double(0x7ff0000000000000LL)
#endif
"""
ARITHMETIC = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
}
COMPARISON = {
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
}
LOGIC = {ca.OP_NOT: "~{0}", ca.OP_AND: "{0} & {1}", ca.OP_OR: "{0} | {1}"}
WORDS = (  # of C's functions, which are those of CasADi's operations
    "sqrt sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp expm1 log log1p erf "
    "floor ceil fabs sign pow atan2 fmod copysign hypot fmin fmax"
)
FUNCTIONS = {getattr(ca, f"OP_{word.upper()}"): word for word in WORDS.split()}
FUNCTIONS[ca.OP_CONSTPOW] = "pow"
NUMBERS = {  # truth is 0 or 1, a double
    **ARITHMETIC,
    **COMPARISON,
    ca.OP_NOT: "!{0}",
    ca.OP_AND: "{0} && {1}",
    ca.OP_OR: "{0} || {1}",
    ca.OP_IF_ELSE_ZERO: "{0} ? {1} : 0.0",
    ca.OP_SIGN: "{0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : {0}",
}
TYPES = {"number": "double", "vector": "real", "mask": "octo_mask"}


def instructions(function: ca.Function) -> Iterator[tuple[int, list[int], list[int]]]:
    """Operation, inputs and outputs of each instruction of an SX function."""
    for k in range(function.n_instructions()):
        yield (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )


def function_in_lanes(
    function: ca.Function, shared: Collection[int], section: int | None = None
) -> str:
    """C text ``static void name(const void *const *arg, real *const *res)`` of an SX function with
    dense outputs.

    Parameters
    ----------
    shared: the inputs that are the same for all lanes, arrays of double; the others are arrays of
        real.
    section: the most instructions of one function of C; where there are more, ``name`` calls
        ``name_0``, ``name_1``, …, and what a later one reads is kept in arrays between them.
    """
    name, pointers = function.name(), []
    for k in range(function.n_in()):
        pointers.append(f"  const {'double' if k in shared else 'real'} *i{k} = arg[{k}];")
    pointers += [f"  real *restrict o{k} = res[{k}];" for k in range(function.n_out())]
    parts, sizes = _sections(list(instructions(function)), function, shared, section)
    if len(parts) == 1:
        head = f"static void {name}(const void *const *arg, real *const *res) {{"
        return "\n".join([head, *pointers, *parts[0], "}"])
    kept = "".join(f", {TYPES[kind]} *{kind}s" for kind in sizes)
    text = []
    for k, lines in enumerate(parts):
        head = f"void {name}_{k}(const void *const *arg, real *const *res{kept}) {{"
        text += [f"static __attribute__((noinline)) {head}", *pointers, *lines, "}"]
    text.append(f"static void {name}(const void *const *arg, real *const *res) {{")
    text += [f"  {TYPES[kind]} {kind}s[{size}];" for kind, size in sizes.items()]
    given = ", ".join(["arg", "res", *(f"{kind}s" for kind in sizes)])
    text += [f"  {name}_{k}({given});" for k in range(len(parts))]
    return "\n".join([*text, "}"])


def _sections(
    steps: Sequence[tuple[int, list[int], list[int]]],
    function: ca.Function,
    shared: Collection[int],
    section: int | None,
) -> tuple[list[list[str]], dict[str, int]]:
    """Lines of C of so many instructions each; how many values of each kind are kept at once."""
    section = section or max(len(steps), 1)
    operands, last = _reads(steps)
    values: dict[int, _Value] = {}
    kept: dict[int, int] = {}  # places of values that later sections read
    free: dict[str, list[int]] = {kind: [] for kind in TYPES}
    sizes = dict.fromkeys(TYPES, 0)
    parts = []
    for first in range(0, max(len(steps), 1), section):
        lines: list[str] = []
        for k, (operation, inputs, outputs) in enumerate(steps[first : first + section], first):
            own = [values[j] for j in operands[k]]
            if operation == ca.OP_OUTPUT:
                lines.append(f"  o{outputs[0]}[{outputs[1]}] = {own[0].vector()};")
            elif operation == ca.OP_CONST:
                values[k] = _Value("number", _constant(function.instruction_constant(k)))
            elif operation == ca.OP_INPUT:
                kind = "number" if inputs[0] in shared else "vector"
                values[k] = _Value(kind, f"i{inputs[0]}[{inputs[1]}]")
            else:
                made = _apply(function, operation, own)
                lines.append(f"  const {TYPES[made.kind]} a{k} = {made.text};")
                values[k] = _Value(made.kind, f"a{k}")
                if last[k] >= first + section:
                    if not free[made.kind]:
                        free[made.kind].append(sizes[made.kind])
                        sizes[made.kind] += 1
                    kept[k] = free[made.kind].pop()
                    lines.append(f"  {made.kind}s[{kept[k]}] = a{k};")
        for k in list(kept):
            kind = values[k].kind
            values[k] = _Value(kind, f"{kind}s[{kept[k]}]")
            if last[k] < first + section:
                free[kind].append(kept.pop(k))
        parts.append(lines)
    return parts, {kind: size for kind, size in sizes.items() if size}


def _reads(steps: Sequence[tuple[int, list[int], list[int]]]) -> tuple[list[list[int]], list[int]]:
    """Of each instruction, those whose results it reads; and the last one that reads its own."""
    places: dict[int, int] = {}
    operands, last = [], list(range(len(steps)))
    for k, (operation, inputs, outputs) in enumerate(steps):
        own = [] if operation in (ca.OP_CONST, ca.OP_INPUT) else [places[i] for i in inputs]
        for j in own:
            last[j] = k
        operands.append(own)
        if operation != ca.OP_OUTPUT:
            places[outputs[0]] = k
    return operands, last


def function_of_numbers(function: ca.Function) -> str:
    """C text ``static void name(const double *const *arg, double *const *res)`` of an SX function
    with dense outputs.

    Quotients of one denominator are products with its reciprocal: a division is many instructions
    on a GPU.
    """
    made: list[tuple[str, int, list[str]]] = []  # what is assigned to, an operation, its operands
    places: dict[int, str] = {}
    for k, (operation, inputs, outputs) in enumerate(instructions(function)):
        if operation == ca.OP_CONST:
            places[outputs[0]] = _constant(function.instruction_constant(k))
        elif operation == ca.OP_OUTPUT:
            made.append((f"res[{outputs[0]}][{outputs[1]}]", ca.OP_ASSIGN, [places[inputs[0]]]))
        else:
            if operation == ca.OP_INPUT:
                operation, operands = ca.OP_ASSIGN, [f"arg[{inputs[0]}][{inputs[1]}]"]
            else:
                operands = [places[i] for i in inputs]
            made.append((f"const double a{k}", operation, operands))
            places[outputs[0]] = f"a{k}"
    quotients = Counter(operands[1] for _, operation, operands in made if operation == ca.OP_DIV)
    inverse: dict[str, str] = {}
    lines = [f"static void {function.name()}(const double *const *arg, double *const *res) {{"]
    for target, operation, operands in made:
        if operation == ca.OP_DIV and quotients[operands[1]] > 1:
            if operands[1] not in inverse:
                inverse[operands[1]] = f"b{len(inverse)}"
                lines.append(f"  const double {inverse[operands[1]]} = 1.0 / {operands[1]};")
            operation, operands = ca.OP_MUL, [operands[0], inverse[operands[1]]]
        lines.append(f"  {target} = {_number(function, operation, operands)};")
    return "\n".join([*lines, "}"])


def switch(name: str, functions: Sequence[ca.Function]) -> str:
    """C text ``static void name(int k, const double **arg, double **res)``: a call of the k-th of
    the functions, which stand before it."""
    cases = " ".join(
        f"case {k}: {function.name()}(arg, res); break;" for k, function in enumerate(functions)
    )
    head = f"static void {name}(int k, const double **arg, double **res) {{"
    return f"{head}\n  switch (k) {{ {cases} }}\n}}"


def _number(function: ca.Function, operation: int, operands: list[str]) -> str:
    if operation in NUMBERS:
        return NUMBERS[operation].format(*operands)
    if operation in FUNCTIONS:
        return f"{FUNCTIONS[operation]}({', '.join(operands)})"
    raise _unknown(function, operation)


class _Value(NamedTuple):
    """An expression: a number that all lanes share, a vector, or a mask (all bits of a lane where
    it is true)."""

    kind: str
    text: str

    def vector(self) -> str:
        if self.kind == "number":
            return f"(ZERO + {self.text})"
        return f"WHERE({self.text}, ZERO + 1.0)" if self.kind == "mask" else self.text

    def mask(self) -> str:
        return self.text if self.kind == "mask" else f"({self.vector()} != 0.0)"


def _apply(function: ca.Function, operation: int, values: list[_Value]) -> _Value:
    if operation in ARITHMETIC:
        kind, texts = "number", []
        for value in values:
            kind = kind if value.kind == "number" else "vector"
            texts.append(value.vector() if value.kind == "mask" else value.text)
        return _Value(kind, ARITHMETIC[operation].format(*texts))
    if operation in COMPARISON:
        return _Value("mask", COMPARISON[operation].format(*(value.vector() for value in values)))
    if operation in LOGIC:
        return _Value("mask", LOGIC[operation].format(*(value.mask() for value in values)))
    if operation == ca.OP_IF_ELSE_ZERO:
        return _Value("vector", f"WHERE({values[0].mask()}, {values[1].vector()})")
    if operation in FUNCTIONS:
        operands = ", ".join(value.vector() for value in values)
        return _Value("vector", f"octo_{FUNCTIONS[operation]}({operands})")
    raise _unknown(function, operation)


def _unknown(function: ca.Function, operation: int) -> ModelError:
    names = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}
    name = names.get(operation, operation)
    return ModelError(
        f"{function.name()} uses CasADi's operation {name}, which octo cannot write as C"
    )


def _constant(value: float) -> str:
    """An exact literal of C and C++."""
    if value != value:
        return "NAN"
    text = "INFINITY" if abs(value) == float("inf") else abs(float(value)).hex()
    return f"(-{text})" if value < 0.0 else text
