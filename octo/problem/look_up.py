"""A world as a stage of code: φ and ∇φ at a point, for terms over a step that look at contacts."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from octo.checks import Array
from octo.emit import HEAD
from octo.model.terrain import world_at
from octo.problem.code_stage import CodeStage
from octo.world import query
from octo.world.jet import SIZES

NAME = "world_look"
OUTPUTS, INPUTS = SIZES[1], 4  # φ and ∇φ; a point (3,) m and the address of the world's numbers
# where the numbers of ∂²φ and ∂³φ stand in a jet, by axes
SECOND = np.array([[4, 5, 6], [5, 7, 8], [6, 8, 9]])
THIRD = np.array(
    [
        [[10, 11, 12], [11, 13, 14], [12, 14, 15]],
        [[11, 13, 14], [13, 16, 17], [14, 17, 18]],
        [[12, 14, 15], [14, 17, 18], [15, 18, 19]],
    ]
)


class LookUp(CodeStage):
    """(point, address) -> (φ, ∇φ), with first and second derivatives; one for all worlds."""

    def check(self, points: Array | None = None) -> None:
        """Nothing: an address is no number to take differences of, and what it finds is a world's
        affair."""


@functools.cache
def look_up() -> LookUp:
    """The one that there is."""
    return LookUp(NAME, INPUTS, OUTPUTS, _text(), _looked, second=True)


def _text() -> str:
    """C of the look-up; the dynamics have octo_world by its own name."""
    second = ", ".join(map(str, np.concatenate([np.arange(1, 4)[None], SECOND]).ravel()))
    third = ", ".join(map(str, np.concatenate([SECOND[None], THIRD]).ravel()))
    return f"""{query.text().replace(HEAD, "").replace("octo_world", NAME + "_at")}
static void {NAME}(const double *a, double *value, double *slopes, double *second) {{
  static const int first[{OUTPUTS * 3}] = {{{second}}}, next[{OUTPUTS * 9}] = {{{third}}};
  double jet[{SIZES[-1]}];
  {NAME}_at((const double *)(unsigned long long)a[3], a, second ? 3 : slopes ? 2 : 1, jet);
  for (int k = 0; k < {OUTPUTS}; ++k) value[k] = jet[k];
  for (int k = 0; slopes && k < {OUTPUTS}; ++k)
    for (int i = 0; i < {INPUTS}; ++i)
      slopes[{INPUTS} * k + i] = i < 3 ? jet[first[3 * k + i]] : 0.0;
  for (int e = 0; second && e < {OUTPUTS * INPUTS * INPUTS}; ++e) {{
    int k = e / {INPUTS * INPUTS}, i = e / {INPUTS} % {INPUTS}, j = e % {INPUTS};
    second[e] = i < 3 && j < 3 ? jet[next[9 * k + 3 * i + j]] : 0.0;
  }}
}}
"""


def _looked(a: Array) -> Sequence[Any]:
    """The same for NumPy, a (…, 4)."""
    flat = a.reshape(-1, INPUTS)
    jets = np.full((len(flat), SIZES[-1]), np.nan)
    for address in set(flat[:, 3].tolist()):
        world, own = world_at(address), flat[:, 3] == address
        if world is not None:
            jets[own] = world.jets(flat[own, :3], len(SIZES) - 1)
    slopes = np.zeros((len(flat), OUTPUTS, INPUTS))
    second = np.zeros((len(flat), OUTPUTS, INPUTS, INPUTS))
    slopes[:, 0, :3], slopes[:, 1:, :3] = jets[:, 1:4], jets[:, SECOND]
    second[:, 0, :3, :3], second[:, 1:, :3, :3] = jets[:, SECOND], jets[:, THIRD]
    parts = (jets[:, :OUTPUTS], slopes, second)
    return [part.reshape(*a.shape[:-1], *part.shape[1:]) for part in parts]
