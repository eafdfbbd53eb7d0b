"""The C text of the dynamics: stage functions and the character's tables, then the tree pass of
phases.c.

The text defines NX, NB (bodies), NC (terrain contacts), NP, KIN and WORK (doubles of a node's
kinematics and of a step's work area), CURVATURE (blocks of the curvature, see HESS in phases.c),
``octo_kin`` and ``octo_step``. It compiles as C and, unchanged, under NVRTC.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from importlib import resources
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from octo import native
from octo.checks import Array
from octo.dynamics import between_bodies, crowd, long, slots, stages
from octo.dynamics.elements import SHARED as SHARED_OF_ELEMENTS
from octo.dynamics.elements import Elements, elements_of
from octo.dynamics.laws import ContactLaw
from octo.dynamics.long import MOST, brisk, check_length, optimised
from octo.dynamics.parameters import Layout
from octo.dynamics.symbolic import mass_matrix_of_points
from octo.emit import HEAD, function_in_lanes, function_of_numbers
from octo.interrupts import postponed
from octo.model.character import Character
from octo.model.terrain import Ground, World
from octo.world import query

HINT = "describe a robot, whose links octo knows, or use fewer coordinates, contacts or operations"


@postponed()
def source(name: str) -> str:
    return (resources.files("octo.dynamics") / name).read_text(encoding="utf-8")


def batch_source() -> str:
    """C text that evaluates all steps of a batch, for the text of a model's functions."""
    return native.threads() + source("batch.c")


@postponed()
def robot_text(
    character: Character, law: ContactLaw, terrain: Ground, layout: Layout, lanes: bool = False
) -> str:
    """C text of the dynamics of §4 of a character: ``octo_step`` for one time step, or for one in
    every lane of a vector."""
    own = _stages_of(layout, law, terrain)
    elements = elements_of(character, layout, Links(character).of)
    mutuals = between_bodies.mutuals_of(character, layout, law, Links(character).of)
    functions = [*elements.functions, *mutuals.stages]
    length = own.length + sum(function.n_instructions() for function in functions)
    what = "contact law, terrain and elements" if character.elements else "contact law and terrain"
    check_length(what, length, "write them in fewer operations")
    crowds = crowd.tables_of(character, layout, terrain)
    sizes, tables = _tables(character, elements, mutuals, crowds)
    sizes |= {"NP": layout.size, "CURVATURE": 5}
    head = [HEAD]
    if isinstance(terrain, World):
        head += [query.text(), function_of_numbers(stages.reach(layout, law))]
    common = [source("tree.c"), source("pairs.c")]
    if character.elements:
        common += [elements.text(), source("elements.c")]
    if mutuals.stages:
        common += [mutuals.text(), source("bodies.c")]
    if crowds.bodies:
        common.append(source("crowd.c"))
    made = [own.text(lanes), *(_stage_text(function, lanes) for function in functions)]
    if not lanes:
        return "\n".join([*head, *made, macros(sizes), *tables, *common, source("phases.c")])
    places, coupled, jac, hess = slots.of_robot(character)
    sizes["NCOUPLED"] = coupled
    tables += [integers("coupled", places), slots.table(jac, hess)]
    steps = [source("lanes_step.c"), source("lanes_group.c")]
    return "\n".join([*head, source("lanes.c"), *made, macros(sizes), *tables, *common, *steps])


class _Stages:
    """The stages of a contact law and a ground, the same for every robot, and their C text."""

    def __init__(self, layout: Layout, law: ContactLaw, terrain: Ground):
        self.functions = [stages.gap(layout, law, terrain), stages.pair(layout)]
        for order in (0, 1, 2):
            self.functions.append(stages.body(order, layout))
            self.functions.append(stages.contact(order, layout, law, terrain))
            self.functions.append(stages.joint(order, layout))
        self.length = sum(function.n_instructions() for function in self.functions)
        self._texts: dict[bool, str] = {}

    def text(self, lanes: bool) -> str:
        if lanes not in self._texts:
            written = (_stage_text(function, lanes) for function in self.functions)
            self._texts[lanes] = "\n".join(written)
        return self._texts[lanes]


KEPT = 8  # stages of as many laws and grounds
_kept: OrderedDict[Any, _Stages] = OrderedDict()


def _stages_of(layout: Layout, law: ContactLaw, terrain: Ground) -> _Stages:
    """Those of the last few laws and grounds are kept: they take longer than all else of a text."""
    key = stages.structure(layout, law, terrain)
    found = _kept.pop(key, None)
    if found is None:
        found = _Stages(layout, law, terrain)
    _kept[key] = found
    while len(_kept) > KEPT:
        _kept.popitem(last=False)
    return found


def _stage_text(function: ca.Function, lanes: bool) -> str:
    if lanes:
        return lanes_text(function, _shared(function.name()))
    return brisk(function_of_numbers(function), function.n_instructions())


def _shared(name: str) -> Collection[int]:
    """Inputs of a stage that are the same for all lanes."""
    stage = name.removeprefix(stages.PREFIX).split("_")[0].rstrip("012")
    return {**between_bodies.SHARED, **stages.SHARED}.get(stage, SHARED_OF_ELEMENTS)


@postponed()
def function_text(fd: ca.Function, lanes: bool = False) -> str:
    """C text of user-written dynamics FD(x_next, x, x_prev, p) -> (n,), for one time step or for
    one in every lane."""
    if fd.n_instructions() > MOST:
        check_length("these user-written dynamics", fd.n_instructions(), HINT)
    n, size = int(fd.size1_in(0)), int(fd.numel_in(3))
    z, p, lam = ca.SX.sym("z", 3 * n), ca.SX.sym("p", size), ca.SX.sym("lam", n)
    x_next, x, x_prev = z[:n], z[n : 2 * n], z[2 * n :]
    value = ca.densify(fd(x_next, x, x_prev, p))
    inputs = [*(ca.SX.sym(name, n) for name in ("x_next", "x", "x_prev")), p, lam]
    jac = ca.jacobian(value, z)
    gradient = ca.mtimes(jac.T, lam)
    check_curvature("these user-written dynamics", [z, p, lam], gradient, HINT)
    hess = ca.triu2symm(ca.triu(ca.jacobian(gradient, z)))
    length = ca.Function("curvature", [z, p, lam], [hess]).n_instructions()
    check_length("these user-written dynamics", length, HINT)
    blocks = [hess[a * n : (a + 1) * n, b * n : (b + 1) * n] for a, b in slots.BLOCKS]
    squares = ca.veccat(*(ca.densify(block.T) for block in blocks))
    outputs = [value, ca.vec(ca.densify(jac.T)), squares]
    outputs = ca.substitute(outputs, [z], [ca.vertcat(*inputs[:3])])
    options = {"cse": True}
    functions = [
        ca.Function(f"octo_fd{order}", inputs, outputs[: order + 1], options) for order in (0, 1, 2)
    ]
    sizes = {"NX": n, "NB": 0, "NC": 0, "NP": size, "KIN": 0}
    sizes |= {"WORK": max(f.sz_w() for f in functions), "CURVATURE": len(blocks)}
    if not lanes:
        return "\n".join([HEAD, _generated(functions), macros(sizes), source("custom.c")])
    made = "\n".join(lanes_text(function, (3,)) for function in functions)
    dense = [np.arange(1, 1 + count) for count in (3 * n * n, len(blocks) * n * n)]
    steps = [source("custom_lanes.c"), source("lanes_group.c")]
    return "\n".join([HEAD, source("lanes.c"), made, macros(sizes), slots.table(*dense), *steps])


def _generated(functions: Sequence[ca.Function]) -> str:
    """CasADi's C text."""
    options = {"with_header": False, "include_math": False, "casadi_int": "int"}
    generator = ca.CodeGenerator("octo_dynamics.c", options)
    for function in functions:
        generator.add(function)
    return brisk(str(generator.dump()), max(function.n_instructions() for function in functions))


def check_curvature(what: str, inputs: Sequence[ca.SX], gradient: ca.SX, hint: str) -> None:
    """Refuse second derivatives, of a ``gradient`` to the first of ``inputs``, that would take too
    long to write down: their columns each cost about as much as the gradient.

    Measured: a dense one of 3n columns has 0.6 · 3n times the gradient's instructions.
    """
    function = ca.Function("gradient", list(inputs), [gradient])
    pattern = ca.Sparsity(function.jac_sparsity(0, 0))
    columns = max(np.diff(pattern.colind()), default=0)
    expected = int(0.6 * columns * function.n_instructions())
    if expected > 2 * MOST or function.n_instructions() > MOST:
        check_length(what, max(expected, function.n_instructions()), hint)


@postponed()
def lanes_text(function: ca.Function, shared: Collection[int]) -> str:
    """C text of a function with a time step in every lane; a long one in sections."""
    if function.n_instructions() < long.LONG:
        return function_in_lanes(function, shared)
    return optimised(function_in_lanes(function, shared, long.SECTION), "O1")


def macros(sizes: Mapping[str, int]) -> str:
    """Numbers by name, for the preprocessor."""
    return "\n".join(f"#define {name} {value}" for name, value in sizes.items())


def integers(name: str, values: ArrayLike) -> str:
    """A table of integers in C."""
    entries = ", ".join(str(int(v)) for v in np.asarray(values).ravel()) or "0"
    return f"static const int octo_{name}[] = {{{entries}}};"


def numbers_table(name: str, values: ArrayLike) -> str:
    """A table of numbers in C."""
    flat = np.asarray(values, dtype=float).ravel()
    entries = ", ".join(_literal(float(v)) for v in flat) or "0.0"
    return f"static const double octo_{name}[] = {{{entries}}};"


def _literal(value: float) -> str:
    """An exact literal of C and C++; an absent joint limit is beyond every coordinate."""
    return f"{np.sign(value)}e300" if np.isinf(value) else float(value).hex()


def _tables(
    character: Character, elements: Elements, mutuals: between_bodies.Mutuals, crowds: crowd.Crowds
) -> tuple[dict[str, int], list[str]]:
    """Sizes and constant arrays of the character."""
    links = Links(character)
    singles = crowd.singles_of(character)
    live = [k for k in singles if links.of[character.contacts[k].body] >= 0]
    sizes: dict[str, int] = {
        "NX": character.nx,
        "NB": len(character.bodies),
        "NC": len(live),
        "NLINK": len(links.first),
        "NSLOT": 1 + max(links.slots(), default=0),
        "LEVELS": 1 + max(_levels(character), default=-1),
        "KIN": 12 * len(character.bodies) + 6 * character.nx,
        **elements.sizes,
        **crowds.sizes,
        **mutuals.sizes,
    }
    sizes["KIN"] += sizes.get("NG", 0) * sizes.get("JET", 0)  # octo_look
    tables = _kinematic_tables(character) + links.tables() + _path_tables(character, sizes)
    spheres = [character.contacts[k] for k in live]
    of = [links.of[body] for body in (*(sphere.body for sphere in spheres), *crowds.bodies)]
    tables += [
        numbers_table(
            "joint_table", [[getattr(j, name) for name in stages.JOINT] for j in character.joints]
        ),
        integers("contact_body", [sphere.body for sphere in spheres]),
        integers("contact_link", [*of[: len(live)], *elements.links, *of[len(live) :]]),
        numbers_table("contact_sphere", [[*sphere.position, sphere.radius] for sphere in spheres]),
    ]
    if character.elements:
        tables += [integers(f"element_{name}", own) for name, own in elements.integers.items()]
        tables.append(numbers_table("element_points", elements.points))
    tables += [integers(name, own) for name, own in crowds.integers.items()]
    tables += [numbers_table(name, own) for name, own in crowds.numbers.items()]
    tables += [integers(f"mutual_{name}", own) for name, own in mutuals.integers.items()]
    tables += [numbers_table(f"mutual_{name}", own) for name, own in mutuals.numbers.items()]
    return sizes, tables + _pair_tables(character, sizes)


def _kinematic_tables(character: Character) -> list[str]:
    joints = character.joints
    return [
        integers("body_parent", [body.parent for body in character.bodies]),
        integers("body_level", _levels(character)),
        numbers_table(
            "body_pose", [[*np.ravel(body.rotation), *body.position] for body in character.bodies]
        ),
        integers("body_first", [*character.first_joint, character.nx]),
        integers("joint_slides", [joint.kind == "slide" for joint in joints]),
        numbers_table("joint_axis", [joint.axis for joint in joints]),
        numbers_table("joint_anchor", [joint.anchor for joint in joints]),
        numbers_table("joint_reference", [joint.reference for joint in joints]),
    ]


def _levels(character: Character) -> list[int]:
    """How many bodies carry each body."""
    levels: list[int] = []
    for body in character.bodies:
        levels.append(levels[body.parent] + 1 if body.parent >= 0 else 0)
    return levels


def _path_tables(character: Character, sizes: dict[str, int]) -> list[str]:
    """Who is whose ancestor: as runs of neighbouring descendants, and as a list of pairs."""
    paths = slots.paths(character)
    below: list[list[int]] = [[] for _ in paths]
    for j, path in enumerate(paths):
        for i in path:
            below[i].append(j)
    runs = []
    for i, members in enumerate(below):
        inner = (k for k in range(1, len(members)) if members[k] != members[k - 1] + 1)
        breaks = [0, *inner, len(members)]
        runs += [(i, members[a], members[b - 1] + 1) for a, b in pairwise(breaks)]
    related = [(i, j) for i, members in enumerate(below) for j in members]
    sizes["NRUN"], sizes["NRELATED"] = len(runs), len(related)
    return [
        integers("before", [path[-2] if len(path) > 1 else -1 for path in paths]),
        integers("path_start", np.cumsum([0, *(len(path) for path in paths)])),
        integers("run", runs),
        integers("above", [i for i, _ in related]),
        integers("below", [j for _, j in related]),
    ]


def _pair_tables(character: Character, sizes: dict[str, int]) -> list[str]:
    """The pairs' spheres, and the coordinates that move one sphere of a pair alone (pairs.c)."""
    bodies, spheres, dofs, start, split = [], [], [], [0], []
    for (a, b), (loop, count) in zip(character.pairs, slots.loops(character), strict=True):
        first, second = character.contacts[a], character.contacts[b]
        if not loop:
            continue
        bodies += [first.body, second.body]
        spheres.append([*first.position, *second.position, first.radius + second.radius])
        dofs += loop
        split.append(count)
        start.append(len(dofs))
    sizes["NPAIR"], sizes["NLOOP"] = len(spheres), int(max(np.diff(start), default=0))
    return [
        integers("pair_body", bodies),
        numbers_table("pair_spheres", spheres),
        integers("loop_dof", dofs),
        integers("loop_start", start),
        integers("loop_split", split),
    ]


class Links:
    """Bodies welded together are one link: one inertia, in the frame of the link's first body.

    ``of`` is the link of each body (-1: fixed to the world), ``first`` each link's first body.
    """

    def __init__(self, character: Character):
        self.character = character
        self.of: list[int] = []
        self.first: list[int] = []
        # body and its pose in the link's frame
        self.members: list[list[tuple[int, Array, Array]]] = []
        place: dict[int, tuple[Array, Array]] = {}
        for b, body in enumerate(character.bodies):
            if body.joints:
                self.of.append(len(self.first))
                self.first.append(b)
                self.members.append([])
                place[b] = np.eye(3), np.zeros(3)
            else:
                self.of.append(self.of[body.parent] if body.parent >= 0 else -1)
                R, t = place[body.parent] if body.parent >= 0 else (np.eye(3), np.zeros(3))
                place[b] = R @ body.rotation, R @ body.position + t
            if self.of[b] >= 0:
                self.members[self.of[b]].append((b, *place[b]))

    def inertia(self, link: int) -> Array:
        """(10,) com (m), second moment about it xx xy xz yy yz zz (kg m²), mass (kg)."""
        parts = []
        for b, R, t in self.members[link]:
            body = self.character.bodies[b]
            parts.append((body.mass, R @ body.com + t, R @ mass_matrix_of_points(body) @ R.T))
        mass = sum(m for m, _, _ in parts)
        com = sum((m * c for m, c, _ in parts), np.zeros(3)) / (mass or 1.0)
        moment = sum((k + m * np.outer(c - com, c - com) for m, c, k in parts), np.zeros((3, 3)))
        return np.concatenate([com, moment[np.triu_indices(3)], [mass]])

    def parents(self) -> list[int]:
        above = [self.character.bodies[b].parent for b in self.first]
        return [self.of[b] if b >= 0 else -1 for b in above]

    def slots(self) -> list[int]:
        """Where each link's composite is kept, from the last link on, until its parent has it."""
        parents, slot, free = self.parents(), [0] * len(self.first), list(range(len(self.first)))
        for link in reversed(range(len(self.first))):
            slot[link] = free.pop(0)
            given_back = [slot[child] for child, parent in enumerate(parents) if parent == link]
            free = sorted(free + given_back)
        return slot

    def tables(self) -> list[str]:
        bodies, used = self.character.bodies, self.slots()
        return [
            integers("link_parent", self.parents()),
            integers("link_body", self.first),
            integers("link_first", [self.character.first_joint[b] for b in self.first]),
            integers("link_last", [self.character.path[b][-1] for b in self.first]),
            integers("link_of", [self.of[b] for b, body in enumerate(bodies) for _ in body.joints]),
            integers("link_slot", used),
            numbers_table("link_inertia", [self.inertia(k) for k in range(len(self.first))]),
        ]
