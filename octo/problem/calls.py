"""Calls of stages of code in the residuals of a step: what is called with what, how derivatives
pass through, and the C text around it.

The values and the derivatives that the code gives are one more input v of the functions of a step,
so that CasADi differentiates what stands before and behind a call; the chain rule is ``jacobian``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from octo.checks import Array
from octo.dynamics.codegen import integers, lanes_text
from octo.emit import HEAD, function_of_numbers
from octo.errors import ProblemError, ShapeError
from octo.problem.code_stage import LARGEST, CodeStage

GIVEN = 6  # inputs of a step's functions before v: x_next, x, x_prev, u, p, q


@dataclass(frozen=True, eq=False)
class Call:
    """One call, as a residual made it.

    Attributes
    ----------
    argument: (inputs,) of the symbols of a step and of the values of calls before.
    given: (stage.size,) symbols: values, slopes and second derivatives, row by row.
    """

    stage: CodeStage
    argument: ca.SX
    given: ca.SX

    @classmethod
    def of(cls, stage: CodeStage, argument: ca.SX, number: int) -> Call:
        """Raises
        ------
        ProblemError, ShapeError: no stage, or another number of arguments."""
        if not isinstance(stage, CodeStage):
            raise ProblemError(f"a {type(stage).__name__} is called, must be an octo.CodeStage")
        a = ca.densify(ca.vec(ca.SX(argument)))
        if a.numel() != stage.inputs:
            raise ShapeError(f"the argument of {stage.label}", (a.numel(),), (stage.inputs,))
        return cls(stage, a, ca.SX.sym(f"v{number}", stage.size))

    @property
    def value(self) -> ca.SX:
        """(outputs,) symbols."""
        return self.given[: self.stage.outputs]

    @property
    def slopes(self) -> ca.SX:
        """(outputs, inputs) symbols."""
        n, m = self.stage.outputs, self.stage.inputs
        return ca.reshape(self.given[n : n + n * m], m, n).T

    @property
    def second(self) -> ca.SX:
        """(outputs·inputs, inputs) symbols, of a stage that has second derivatives."""
        n, m = self.stage.outputs, self.stage.inputs
        return ca.reshape(self.given[n + n * m :], m, n * m).T


def jacobian(calls: Sequence[Call], expression: ca.SX, over: ca.SX) -> ca.SX:
    """d expression / d over, where both the expression and the arguments may depend on ``over`` and
    on what calls before gave."""
    moved: list[ca.SX] = []  # d argument / d over of each call
    for call in calls:
        moved.append(_through(calls, call.argument, over, moved))
    return _through(calls, expression, over, moved)


def gradient(calls: Sequence[Call], expression: ca.SX, over: ca.SX) -> ca.SX:
    """The same of one number, as a column."""
    return jacobian(calls, expression, over).T if calls else ca.gradient(expression, over)


def with_numbers_of(
    others: Sequence[Call], calls: Sequence[Call], expression: ca.SX
) -> tuple[ca.SX, list[Call]]:
    """An expression and its calls with what ``others``, the same calls made of other symbols, are
    given."""
    if not calls:
        return expression, []
    own, new = (ca.vertcat(*[call.given for call in some]) for some in (calls, others))
    made = ca.substitute([expression, *[call.argument for call in calls]], [own], [new])
    pairs = zip(others, made[1:], strict=True)
    return made[0], [Call(other.stage, a, other.given) for other, a in pairs]


def _through(
    calls: Sequence[Call], expression: ca.SX, over: ca.SX, moved: Sequence[ca.SX]
) -> ca.SX:
    """The same where d argument / d over is known of the calls that the expression depends on."""
    whole = ca.jacobian(expression, over)
    for call, a in zip(calls, moved, strict=False):
        whole += ca.jacobian(expression, call.value) @ (call.slopes @ a)
        if call.stage.second:
            entries = ca.vec(call.slopes.T)
            whole += ca.jacobian(expression, entries) @ (call.second @ a)
    return whole


@dataclass(frozen=True, eq=False)
class Calls:
    """Those of all terms, in the order in which they can be made.

    Attributes
    ----------
    stages: what is called. arguments: with what, functions (x_next, x, x_prev, u, p, q, v) ->
        (inputs,).
    """

    stages: tuple[CodeStage, ...] = ()
    arguments: tuple[ca.Function, ...] = ()

    @classmethod
    def of(cls, made: Sequence[Call], inputs: Sequence[ca.SX]) -> Calls:
        """Calls over the symbols ``inputs`` of a step.

        Raises
        ------
        ProblemError: two stages share a name.
        """
        known: dict[str, CodeStage] = {}
        for call in made:
            if known.setdefault(call.stage.name, call.stage).structure != call.stage.structure:
                raise ProblemError(
                    f"two stages are named {call.stage.name!r}: rename one, and its function"
                )
        size = sum(call.stage.size for call in made)
        if size > LARGEST:
            raise ProblemError(
                f"the stages that are called give {size} values and derivatives in a step, at most "
                f"{LARGEST} fit: call smaller ones"
            )
        over = [*inputs, ca.vertcat(*[call.given for call in made])]
        arguments = tuple(
            ca.Function(f"octo_argument_{k}", over, [call.argument], {"cse": True})
            for k, call in enumerate(made)
        )
        return cls(tuple(call.stage for call in made), arguments)

    def __bool__(self) -> bool:
        return bool(self.stages)

    @property
    def structure(self) -> tuple[Any, ...]:
        """What tells one list of calls from another."""
        written = tuple(function.serialize() for function in self.arguments)
        return tuple(stage.structure for stage in self.stages), written

    @cached_property
    def at(self) -> tuple[int, ...]:
        """Where each call's numbers begin in v, and the size of v."""
        return (0, *(int(k) for k in np.cumsum([stage.size for stage in self.stages])))

    @property
    def size(self) -> int:
        return self.at[-1]

    @cached_property
    def waves(self) -> list[int]:
        """Of each call, the first one behind it that asks for its value or for those after it."""
        ends = []
        for k in range(len(self.stages)):
            later = range(k + 1, len(self.stages))
            free = (j for j in later if self._asks(j, self.at[k], self.at[j]))
            ends.append(next(free, len(self.stages)))
        return ends

    def _asks(self, k: int, first: int, last: int) -> bool:
        """Whether the argument of call k depends on numbers first … last − 1 of v."""
        columns = ca.Sparsity(self.arguments[k].jac_sparsity(0, GIVEN)).get_col()
        return any(first <= column < last for column in columns)

    # -- derivatives -------------------------------------------------------------------------------

    def jacobian(self, expression: ca.SX, inputs: Sequence[ca.SX], over: ca.SX) -> ca.SX:
        """d expression / d over, through the calls.

        Parameters
        ----------
        expression: of ``inputs``: x_next, x, x_prev, u, p, q, v. over: symbols of those but v.
        """
        ends = zip(self.stages, self.arguments, self.at, self.at[1:], strict=False)
        made = [Call(stage, f(*inputs), inputs[GIVEN][i:j]) for stage, f, i, j in ends]
        return jacobian(made, expression, over)

    # -- numbers -----------------------------------------------------------------------------------

    def evaluate(self, arguments: Sequence[ca.Function], given: Sequence[Array]) -> list[Array]:
        """v (size, N) where there are calls, by the stages' Python.

        Parameters
        ----------
        arguments: as functions of the inputs ``given`` (…, N) and v, over N steps.
        """
        if not self:
            return []
        steps = given[0].shape[-1]
        v = np.zeros((self.size, steps))
        for stage, argument, at in zip(self.stages, arguments, self.at, strict=False):
            made = stage.evaluate(np.asarray(argument(*given, v)).T)
            v[at : at + stage.size] = np.concatenate([p.reshape(steps, -1) for p in made], axis=1).T
        return [v]

    # -- text --------------------------------------------------------------------------------------

    @property
    def stages_text(self) -> str:
        """The stages themselves, before everything else: their macros and octo's do not meet."""
        unique = {stage.name: stage.c_text for stage in self.stages}
        return "\n".join([HEAD, *unique.values(), ""]) if self else ""

    @property
    def lanes_text(self) -> str:
        """``octo_calls``, with a time step in every lane: v from the other inputs."""
        lines = [lanes_text(argument, {4}) for argument in self.arguments]
        lines.append("static void octo_calls(const void *const *arg, real *v, const int order) {")
        for k, (stage, at) in enumerate(zip(self.stages, self.at, strict=False)):
            counts = " : ".join(f"order == {o} ? {n}" for o, n in enumerate(_ends(stage)[:-1]))
            lines += [
                f"  {{ real a[{stage.inputs}], *res[1] = {{a}}; octo_argument_{k}(arg, res);",
                f"    const int count = {counts} : {stage.size};",
                "    for (int k = 0; k < STEPS; ++k) {",
                f"      double one[{stage.inputs}], made[{stage.size}];",
                f"      for (int j = 0; j < {stage.inputs}; ++j) one[j] = a[j][k];",
                f"      {_written(stage, 'one', 'made')};",
                f"      for (int j = 0; j < count; ++j) v[{at} + j][k] = made[j];",
                "    } }",
            ]
        return "\n".join([*lines, "}", ""])

    def in_lanes(self, function: ca.Function, order: int) -> str:
        """C text of a function of a step's inputs and v as one of the inputs alone.

        Parameters
        ----------
        order: of the derivatives that it asks the stages for.
        """
        text = lanes_text(function, {4})
        if not self:
            return text
        name, own = function.name(), ", ".join(f"arg[{k}]" for k in range(GIVEN))
        text = text.replace(f"static void {name}(", f"static void {name}_given(", 1)
        return "\n".join(
            [
                text,
                f"static void {name}(const void *const *arg, real *const *res) {{",
                f"  real v[{self.size}];",
                f"  const void *own[] = {{{own}, v}};",
                f"  octo_calls(own, v, {order});",
                f"  {name}_given(own, res);",
                "}",
            ]
        )

    @property
    def numbers_text(self) -> str:
        """``octo_call`` of call k, for one step, in C that is CUDA too."""
        if not self:
            return ""
        cases = [
            f"    case {k}: {{ double a[{stage.inputs}], *res[1] = {{a}}; "
            f"octo_argument_{k}(arg, res); {_written(stage, 'a', f'(v + {at})')}; break; }}"
            for k, (stage, at) in enumerate(zip(self.stages, self.at, strict=False))
        ]
        return "\n".join(
            [
                f"#define CALLS {len(self.stages)}\n#define NV {self.size}",
                integers("call_end", self.waves),
                *map(function_of_numbers, self.arguments),
                "static void octo_call(int k, const double *const *arg, double *v, int order) {",
                "  switch (k) {",
                *cases,
                "  }",
                "}",
                "",
            ]
        )


def _ends(stage: CodeStage) -> list[int]:
    """Where each order ends in what a stage gives."""
    return [int(k) for k in np.cumsum([np.prod(shape) for shape in stage.shapes])]


def _written(stage: CodeStage, argument: str, into: str) -> str:
    """C text of a call that writes what ``order`` asks for."""
    asked = [f"order > {order} ? {into} + {at} : 0" for order, at in enumerate(_ends(stage)[:-1])]
    return f"{stage.name}({', '.join([argument, into, *asked])})"
