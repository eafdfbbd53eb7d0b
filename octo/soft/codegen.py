"""The C text of a body's dynamics: tables of its numbers, small generated functions, and loops."""

from __future__ import annotations

from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array
from octo.dynamics import codegen, slots
from octo.dynamics import stages as laws
from octo.dynamics.laws import ContactLaw
from octo.dynamics.long import brisk
from octo.dynamics.parameters import Layout
from octo.emit import HEAD, function_of_numbers
from octo.interrupts import postponed
from octo.model.chart import Chart
from octo.model.terrain import ADDRESS, Ground, World
from octo.soft import stages
from octo.soft.body import Body
from octo.soft.moments import Moments
from octo.soft.near import spheres_of
from octo.soft.stvk import products
from octo.world import query
from octo.world.jet import SIZES

PAIRED = ("first_of", "second_of")  # z of each product
CURVATURE = 5  # blocks of the curvature: a body has none of x and x_prev
KIN = 9 * stages.TURNS + 3  # and 9 of each function φ_k


def source(name: str) -> str:
    return (resources.files("octo.soft") / name).read_text(encoding="utf-8")


@postponed()
def body_text(
    body: Body, law: ContactLaw, terrain: Ground, layout: Layout, chart: Chart, lanes: bool
) -> str:
    """C text for one time step, or for one in every lane of a vector."""
    functions = [stages.turn(chart), stages.bend(chart)]
    if not isinstance(terrain, World):
        functions.append(laws.gap(layout, law, terrain))
    functions += [laws.point(order, layout, law, terrain) for order in (0, 1, 2)]
    tables, sizes = _tables(body, terrain, layout)
    common = [source("step.c"), source("elastic.c"), source("touch.c")]
    if not lanes:
        sizes["KIN"] = 0
    head = [HEAD, codegen.macros(sizes), *tables]
    if isinstance(terrain, World):
        head += [query.text(), function_of_numbers(laws.reach(layout, law))]
    if not lanes:
        made = [brisk(function_of_numbers(one), one.n_instructions()) for one in functions]
        return "\n".join([*head, *made, *common, source("step_numbers.c")])
    made = [codegen.lanes_text(one, _shared(one)) for one in functions]
    n = sizes["NX"]
    dense = [np.arange(1, 1 + count) for count in (3 * n * n, CURVATURE * n * n)]
    steps = [source("step_lanes.c"), codegen.source("lanes_group.c")]
    text = [*head, codegen.source("lanes.c"), *made, *common, slots.table(*dense), *steps]
    return "\n".join(text)


def _shared(function: ca.Function) -> tuple[int, ...]:
    """Inputs that are the same for all lanes."""
    return laws.SHARED.get(function.name().removeprefix(laws.PREFIX).rstrip("012"), ())


def bits_table(name: str, values: Array) -> str:
    """A long table of numbers in C, by their bits: a compiler reads those ten times faster than
    literals of doubles."""
    flat = np.ascontiguousarray(values, dtype=float).ravel().view(np.uint64)
    entries = ",".join(map(hex, flat.tolist()))
    bits = f"static const unsigned long long octo_{name}_bits[] = {{{entries}}};"
    return f"{bits}\n#define octo_{name} ((const double *)octo_{name}_bits)"


def _tables(body: Body, terrain: Ground, layout: Layout) -> tuple[list[str], dict[str, int]]:
    """The body's numbers, and sizes."""
    moments, count = Moments.of(body), body.modes.shape[1]
    shapes = np.concatenate([body.points[:, None], body.modes], axis=1)
    spheres = spheres_of(shapes)
    steepest = 1.0 if isinstance(terrain, World) else terrain.steepest
    numbers: dict[str, ArrayLike] = {
        "second": moments.second,
        "first": moments.first,
        "mass": [moments.mass],
        "modal": moments.modal,
        "stiffness": body.stiffness,
        "steepest": [steepest],
    }
    made = [codegen.numbers_table(name, table) for name, table in numbers.items()]
    made.append(bits_table("entry", spheres.rows))
    pairs: tuple[ArrayLike, ArrayLike] = ((), ())
    if body.stvk is not None:
        pairs = products(count)
        made.append(bits_table("gram", body.stvk))
    made += [codegen.integers(name, own) for name, own in zip(PAIRED, pairs, strict=True)]
    made += [codegen.integers("skip", spheres.skip), codegen.integers("member", spheres.member)]
    kin = KIN + 9 * (1 + count)
    sizes = {"NX": 6 + count, "NB": 0, "NC": 0, "NP": layout.size, "NSHAPE": 1 + count}
    sizes["NPRODUCT"] = np.size(pairs[0])
    sizes |= {"NENTRY": len(spheres.skip), "CURVATURE": CURVATURE, "KIN": kin}
    places = {"DT": "dt", "GRAVITY": "gravity_x", "ELASTIC": "elastic.stiffness"}
    sizes |= {name: layout.index(parameter) for name, parameter in places.items()}
    if isinstance(terrain, World):
        sizes |= {"WORLD": layout.index(ADDRESS), "JET": SIZES[-1]}
    n, K = 6 + count, 1 + count
    sizes["WORK"] = 76 * K + n * n + 15 * n + 380  # octo_step_work
    return made, sizes
