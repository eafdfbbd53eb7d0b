"""FD, its Jacobian and the curvature of lamᵀFD over all steps of a batch, in NumPy."""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property
from types import NoneType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.checks import Array, doubles
from octo.dynamics import codegen, content, slots
from octo.dynamics.crowd import singles_of
from octo.dynamics.laws import ContactLaw, Smooth
from octo.dynamics.parameters import Layout, bound, robot_layout, unbound
from octo.dynamics.symbolic import LOOKED, element_law, forward_dynamics
from octo.errors import ModelError, ProblemError, ShapeError, ValueRangeError, said
from octo.interrupts import postponed
from octo.model.character import Character
from octo.model.element import parameters_of
from octo.model.kinematics import sphere_centers
from octo.model.scene import Scene
from octo.model.terrain import ADDRESS, Ground, Plane, Terrain, World, own_parameters, world_at
from octo.world.jet import SIZES

MOST_WRITTEN = 1000  # contacts in one expression: to build it takes 10 to 30 s
Evaluation = tuple[Array, Array | None, Array | None]


class Dynamics:
    """Implicit dynamics FD(x_next, x, x_prev, p) = Uᵀu and its derivatives.

    Parameters
    ----------
    symbolic: SX function FD(x_next, x, x_prev, p) -> (n,).
    actuated: indices into x of the actuated rows; ``nu`` of them.
    layout: names and defaults of p (NP,).
    """

    name: str = "custom"
    names: tuple[str, ...] | None = None  # (n,) of the coordinates, where they have any
    curvature_blocks = 6  # of the C text, (n, n) each: CURVATURE
    # (3n, 3n) where the curvature may not be zero, if not what CasADi says of ``symbolic``
    curvature_pattern: NDArray[np.bool_] | None = None
    weight = 1.0  # N, that forces are measured in; a robot's is its character's
    looks = 0  # contacts that a world is asked about, at each node: all but those of crowds
    # from the rest, and large or of this process alone
    generated = frozenset(("_text", "_lanes_text", "_library", "_machine"))

    def __init__(
        self, symbolic: ca.Function, actuated: Sequence[int] | NDArray[np.intp], layout: Layout
    ):
        self.symbolic = symbolic
        self.nx = int(symbolic.size1_in(0))
        self.layout = layout
        self.actuated = np.array(actuated, dtype=np.intp).reshape(-1)
        self.unactuated = np.setdiff1d(np.arange(self.nx), self.actuated).astype(np.intp)

    @property
    def nu(self) -> int:
        return len(self.actuated)

    @property
    def jacobian_pattern(self) -> NDArray[np.bool_]:
        """(n, 3n) where ∂FD/∂(x_next, x, x_prev) may not be zero."""
        return np.ones((self.nx, 3 * self.nx), dtype=bool)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copies: all but what was generated and compiled."""
        return {name: value for name, value in self.__dict__.items() if name not in self.generated}

    def interpreted(self) -> Dynamics:
        """The same on CasADi's virtual machine, as where there is no compiler."""
        plain = copy.copy(self)
        plain.__dict__["_library"] = None
        return plain

    @property
    def key(self) -> Hashable:
        """Dynamics with the same key have the same text: only itself, where nothing is known of
        it."""
        return self

    def text(self) -> str:
        """The C text: macros NX, NB, NC, NP, KIN, WORK, CURVATURE and the functions octo_kin and
        octo_step."""
        return self._text

    def lanes_text(self) -> str:
        """The C text for a time step in every lane of a vector: octo_lanes_* of lanes_group.c in
        place of octo_step."""
        return self._lanes_text

    def _written(self, lanes: bool) -> str:
        return codegen.function_text(self.symbolic, lanes)

    @cached_property
    def _text(self) -> str:
        return content.kept(self.key, "scalar", lambda: self._written(lanes=False))

    @cached_property
    def _lanes_text(self) -> str:
        return content.kept(self.key, "lanes", lambda: self._written(lanes=True))

    @cached_property
    def _library(self) -> ctypes.CDLL | None:
        return native.load(self.lanes_text() + codegen.batch_source())

    @cached_property
    @postponed()
    def _machine(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """FD, Jacobian and curvature for CasADi's virtual machine: (3n, seen[, n]) -> rows."""
        n, size = self.nx, self.symbolic.numel_in(3)
        z, p, lam = ca.SX.sym("z", 3 * n), ca.SX.sym("p", size), ca.SX.sym("lam", n)
        fd = self.symbolic(z[:n], z[n : 2 * n], z[2 * n :], p)
        jac = ca.densify(ca.jacobian(fd, z))
        hess = ca.densify(ca.jacobian(ca.gradient(ca.dot(lam, fd), z), z))
        # no search for common subexpressions: it takes 20 times longer and finds 3 % of them
        value = ca.Function("fd", [z, p], [ca.densify(fd)])
        jacobian = ca.Function("jacobian", [z, p], [jac.T])
        return value, jacobian, ca.Function("curvature", [z, p, lam], [hess])

    def rest(self, p: Array) -> Array | None:
        """(n,) a configuration in which nothing moves without a motor's force, where one is known:
        what a motion begins in by default."""
        return None

    def length(self, start: Array) -> float:
        """m, that moments are measured in."""
        return 1.0

    def row_scale(self, length: float) -> Array:
        """(m,) of the unactuated rows."""
        return np.ones(len(self.unactuated))

    def effort(self, length: float) -> float:
        """A motor's usual force, in the unit of u."""
        return 1.0

    def bound(self, p: Array) -> Array:
        """p (..., NP) as this process hands it to generated code: with the address of the world's
        numbers, where there is a world."""
        return p

    def unbound(self, p: Array) -> Array:
        """The same p without that: what is pickled, or of a copy."""
        return p

    def seen(self, p: Array, x_next: Array) -> Array:
        """What ``symbolic`` takes for p in each of some steps, (…, steps): p (NP,) and behind it
        what the world says at x_next (steps, n)."""
        return np.repeat(np.asarray(p, dtype=float)[:, None], len(x_next), axis=1)

    def evaluate(
        self, nodes: Array, p: Array, lam: Array | None = None, order: int = 0, threads: int = 1
    ) -> Evaluation:
        """FD of every step, and its derivatives.

        Parameters
        ----------
        nodes: (batch, N+2, n), the configurations x_{-1}, x_0, x_1 … x_N.
        p: (batch, NP).
        lam: (batch, N, n), read when ``order`` is 2.
        order: 0 FD, 1 and its Jacobian, 2 and the curvature of lamᵀFD.

        Returns
        -------
        fd (batch, N, n); jac (batch, N, n, 3n), columns [x_next, x, x_prev], or None; hess
        (batch, N, 3n, 3n) or None.
        """
        nodes, n = np.ascontiguousarray(nodes, dtype=float), self.nx
        if nodes.ndim != 3 or nodes.shape[1] < 3 or nodes.shape[2] != n:
            raise ShapeError("nodes", nodes.shape, f"(batch, N+2, {n})")
        batch, steps = nodes.shape[0], nodes.shape[1] - 2
        p = self.bound(doubles("p", p, (batch, self.layout.size)))
        if order not in (0, 1, 2):
            raise ValueRangeError(f"order is {order}, must be 0, 1 or 2")
        if order == 2:
            lam = doubles("lam", np.empty(0) if lam is None else lam, (batch, steps, n))
        fd = np.empty((batch, steps, n))
        jac = np.empty((batch, steps, n, 3 * n)) if order >= 1 else None
        if self._library is None:
            hess = np.empty((batch, steps, 3 * n, 3 * n)) if order == 2 else None
            self._interpret(nodes, p, lam, fd, jac, hess)
            return fd, jac, hess
        blocks = np.empty((batch, steps, self.curvature_blocks, n, n)) if order == 2 else None
        arrays = (nodes, p, lam, fd, jac, blocks)
        pointers = [None if a is None else ctypes.c_void_p(a.ctypes.data) for a in arrays]
        if self._library.octo_batch(batch, steps, order, max(1, int(threads)), *pointers) != 0:
            raise MemoryError("octo_batch could not allocate its work arrays")
        return fd, jac, None if blocks is None else unfold(blocks)

    def _interpret(
        self,
        nodes: Array,
        p: Array,
        lam: Array | None,
        fd: Array,
        jac: Array | None,
        hess: Array | None,
    ) -> None:
        value, jacobian, curvature = self._machine
        steps, n = fd.shape[1], self.nx
        for k in range(len(nodes)):
            z = np.concatenate([nodes[k, 2:], nodes[k, 1:-1], nodes[k, :-2]], axis=1).T  # (3n, N)
            at = self.seen(p[k], nodes[k, 2:])
            fd[k] = np.asarray(value.map(steps)(z, at)).T
            if jac is not None:
                jac[k] = np.asarray(jacobian.map(steps)(z, at)).T.reshape(steps, n, 3 * n)
            if hess is not None and lam is not None:
                found = np.asarray(curvature.map(steps)(z, at, lam[k].T))
                hess[k] = found.T.reshape(steps, 3 * n, 3 * n)


def unfold(blocks: Array) -> Array:
    """The curvature (…, 3n, 3n) of blocks (…, 5 or 6, n, n): H00, H01, H02, H11, H22 and, in
    user-written dynamics, H12."""
    n = blocks.shape[-1]
    hess = np.zeros((*blocks.shape[:-3], 3, n, 3, n))
    for k, (a, b) in enumerate(slots.BLOCKS[: blocks.shape[-3]]):
        hess[..., b, :, a, :] = blocks[..., k, :, :].swapaxes(-1, -2)
        hess[..., a, :, b, :] = blocks[..., k, :, :]
    return hess.reshape(*blocks.shape[:-3], 3 * n, 3 * n)


def modelled(model: object) -> Character | Dynamics:
    """What a ``model`` describes, of a Scene its character.

    Raises
    ------
    ProblemError: it is none.
    """
    if isinstance(model, Scene):
        return model.character
    if not isinstance(model, (Character, Dynamics)):
        what = f"model is a {type(model).__name__}"
        raise ProblemError(f"{what}, must be a Character, a Scene or a Dynamics")
    return model


def check_surroundings(terrain: object, law: object, model: object = None) -> None:
    """Refuse a ground or a contact law that is none, and beside a Dynamics any; None is octo's own.

    Raises
    ------
    ProblemError: naming it and what is allowed.
    """
    if isinstance(model, Dynamics) and (terrain is not None or law is not None):
        raise ProblemError("terrain and law belong to a Character: a Dynamics brings its own")
    if not isinstance(terrain, (Plane, Terrain, World, NoneType)):
        raise ProblemError(
            f"terrain is {said(terrain)}, must be an octo.Plane, an octo.Terrain or an octo.World"
        )
    if law is not None and not all(hasattr(law, name) for name in ("parameters", "reach", "force")):
        raise ProblemError(
            f"law is {said(law)}, must be one of octo.laws, or have parameters, reach and force"
        )


class RobotDynamics(Dynamics):
    """The dynamics of §4 of a character, with a contact law and a terrain."""

    curvature_blocks = 5
    generated = Dynamics.generated | {"symbolic", "key"}

    def __init__(
        self,
        character: Character | Scene,
        law: ContactLaw | None = None,
        terrain: Ground | None = None,
    ):
        check_surroundings(terrain, law)
        self.character = character.character if isinstance(character, Scene) else character
        self.law: ContactLaw = Smooth() if law is None else law
        self.terrain: Ground = Plane() if terrain is None else terrain
        self.nx = self.character.nx
        own = parameters_of(self.character.elements)
        self.layout = robot_layout(self.law.parameters, own_parameters(self.terrain), own)
        for element in self.character.elements:
            element_law(element)  # what is wrong with it is said here
        self.actuated, self.unactuated = self.character.actuated, self.character.unactuated

    @cached_property
    def symbolic(self) -> ca.Function:
        """FD(x_next, x, x_prev, p), built when first asked for: the tree pass does not need it.

        Raises
        ------
        ModelError: the robot has more than MOST_WRITTEN contacts with the terrain.
        """
        contacts = len(self.character.terrain_contacts)
        if contacts > MOST_WRITTEN:
            raise ModelError(
                f"{self.character.name}: {contacts} contacts with the terrain, at most "
                f"{MOST_WRITTEN} without a C compiler or for another solver: install gcc, or keep "
                "fewer contacts"
            )
        return forward_dynamics(self.character, self.law, self.terrain, self.layout)

    @cached_property
    def key(self) -> Hashable:
        known = content.content_of(self.character, self.law, self.terrain)
        return self if known is None else known

    @property
    def on_world(self) -> bool:
        """Whether the ground is looked up."""
        return isinstance(self.terrain, World)

    @property
    def looks(self) -> int:  # type: ignore[override]
        return len(singles_of(self.character)) if isinstance(self.terrain, World) else 0

    def bound(self, p: Array) -> Array:
        return bound(self.layout, self.terrain, p)

    def unbound(self, p: Array) -> Array:
        return unbound(self.layout, self.terrain, p)

    def jets(self, p: Array, x: Array) -> Array:
        """What the world says at the centre of each terrain contact, at configurations x (k, n):
        (k, contacts, 3 + 20), the place in m and φ with its derivatives there; nothing where the
        ground is no world."""
        if not isinstance(self.terrain, World):
            return np.empty((len(x), 0, LOOKED))
        world = world_at(float(p[self.layout.index(ADDRESS)])) or self.terrain
        own = list(self.character.terrain_contacts)
        centers = sphere_centers(self.character, x)[..., own, :].reshape(-1, 3)
        made = np.concatenate([centers, world.jets(centers, len(SIZES) - 1)], axis=1)
        return made.reshape(len(x), len(own), LOOKED)

    def seen(self, p: Array, x_next: Array) -> Array:
        jets = self.jets(p, x_next)
        return np.concatenate([super().seen(p, x_next), jets.reshape(len(x_next), -1).T])

    @property
    def jacobian_pattern(self) -> NDArray[np.bool_]:
        jac = slots.of_robot(self.character)[2]
        return np.asarray(jac.reshape(self.nx, 3 * self.nx) != 0)

    def _written(self, lanes: bool) -> str:
        return codegen.robot_text(self.character, self.law, self.terrain, self.layout, lanes)


class CustomDynamics(Dynamics):
    """User-written implicit dynamics FD(x_next, x, x_prev, p) = Uᵀu.

    Parameters
    ----------
    fd: a CasADi function of (x_next, x, x_prev, p), or a callable ``fd(x_next, x, x_prev, view)``
        of SX symbols with ``view`` the parameters by name, that returns (n,) N m or N.
    nx: n.
    actuated: indices into x of the actuated coordinates.
    parameters: names and defaults of p; ``dt`` (0.025 s) is added in front when it is not there.
    """

    @postponed()
    def __init__(
        self,
        fd: ca.Function | Callable[..., ca.SX],
        nx: int,
        actuated: Sequence[int],
        parameters: Mapping[str, float],
    ):
        layout = Layout.of({**({} if "dt" in parameters else {"dt": 0.025}), **parameters})
        x_next, x, x_prev = (ca.SX.sym(name, nx) for name in ("x_next", "x", "x_prev"))
        p = ca.SX.sym("p", layout.size)
        last = p if isinstance(fd, ca.Function) else layout.view(p)
        try:
            value = ca.SX(fd(x_next, x, x_prev, last))
        except Exception as error:  # a user's code may raise anything
            said = str(error).strip().split("\n")[0]
            raise ModelError(
                f"user-written FD cannot be built: {type(error).__name__}: {said}"
            ) from error
        if value.numel() != nx:
            raise ModelError(f"user-written FD returns {value.numel()} entries, must be nx = {nx}")
        driven = list(actuated)
        if not {int(j) for j in driven} <= set(range(nx)) or len(set(driven)) != len(driven):
            raise ModelError(f"actuated is {driven}, must be different indices in 0…{nx - 1}")
        inputs, names = [x_next, x, x_prev, p], ["x_next", "x", "x_prev", "p"]
        function = ca.Function("FD", inputs, [ca.densify(ca.vec(value))], names, ["fd"])
        super().__init__(function, actuated, layout)
