"""φ and its derivatives at points, from the numbers of a world: the C text, and calls of it."""

from __future__ import annotations

import ctypes
from functools import cache
from importlib import resources

import numpy as np

from octo import native
from octo.checks import Array, doubles
from octo.emit import HEAD, function_of_numbers, switch
from octo.interrupts import postponed
from octo.world import layout
from octo.world.blend import REACH, add, soften
from octo.world.jet import ORDERS, SIZES, turned
from octo.world.shape import FRACTION
from octo.world.shapes import KINDS

ALL = """
void octo_world_below(const double *world, int count, const double *limits, double *points) {
  const double lowest = limits[0], reached = limits[1], least = limits[2], steepest = limits[3];
  for (int k = 0; k < count; ++k) {
    double *point = points + 3 * (size_t)k, above = point[2], height = point[2], away;
    while (octo_world(world, point, 0, &away), away > reached) {
      above = height;
      height -= fmax(away / steepest, least);
      if (height < lowest) {
        height = -INFINITY;
        break;
      }
      point[2] = height;
    }
    for (int j = 0; j < (int)limits[4] && isfinite(height) && height < above; ++j) {
      point[2] = 0.5 * (above + height);
      octo_world(world, point, 0, &away);
      if (away <= reached) height = point[2];
      else above = point[2];
    }
    point[2] = height;
  }
}

void octo_world_all(const double *world, int count, const double *points, int order, double *jets) {
  for (int k = 0; k < count; ++k) {
    octo_world(world, points + 3 * (size_t)k, order, jets + octo_world_size(order) * (size_t)k);
  }
}
"""


@cache
@postponed()
def text() -> str:
    """C text, which is C++ and CUDA too, of ``static void octo_world(const double *world, const
    double *point, int order, double *jet)``: the same for every world."""
    parts = [HEAD, layout.text()]
    parts.append(f"#define OCTO_WORLD_FRACTION {FRACTION}\n#define OCTO_WORLD_REACH {REACH}")
    for name, made in (("turned", turned), ("add", add), ("soften", soften)):
        functions = [made(order) for order in ORDERS]
        parts += [*map(function_of_numbers, functions), switch(f"octo_world_{name}", functions)]
    parts += [kind.text() for kind in KINDS]
    parts.append(
        "static void octo_world_of_kind(int kind, const double *own, const double *point, int "
        "order, double *jet) {\n  switch (kind) {"
    )
    for k, kind in enumerate(KINDS):
        parts.append(f"    case {k}: octo_world_{kind.name}(own, point, order, jet); break;")
    parts.append("  }\n}")
    parts.append((resources.files("octo.world") / "query.c").read_text(encoding="utf-8"))
    return "\n".join(parts)


@cache
def _library() -> ctypes.CDLL | None:
    return native.load(text() + ALL)


def compiled(data: Array, points: Array, order: int) -> Array | None:
    """Jets (k, SIZES[order]) at points (k, 3) m from ``World.data``; None without a compiler."""
    library = _library()
    if library is None:
        return None
    given = doubles("points", points, points.shape)
    jets = np.empty((len(given), SIZES[order]))
    library.octo_world_all(
        ctypes.c_void_p(data.ctypes.data),
        ctypes.c_int(len(given)),
        ctypes.c_void_p(given.ctypes.data),
        ctypes.c_int(order),
        ctypes.c_void_p(jets.ctypes.data),
    )
    return jets


def fallen(data: Array, points: Array, limits: tuple[float, float, float, float, int]) -> bool:
    """Let points (k, 3) m fall onto a world, in place (``World.below``); False without a compiler.

    limits: the lowest height, what counts as reached, the least step (m), the steepest slope of φ,
        and halvings of the last step.
    """
    library = _library()
    if library is None:
        return False
    given = np.array(limits, dtype=float)
    library.octo_world_below(
        ctypes.c_void_p(data.ctypes.data),
        ctypes.c_int(len(points)),
        ctypes.c_void_p(given.ctypes.data),
        ctypes.c_void_p(doubles("points", points, points.shape).ctypes.data),
    )
    return True
