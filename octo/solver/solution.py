"""What a solve returns: the motion, what it costs, how far it is from the laws of physics, and how
it was found."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from octo.checks import ending
from octo.errors import ProblemError, UnknownNameError, said
from octo.files import replacing
from octo.model import archive, store
from octo.model.character import Character
from octo.model.kinematics import body_poses, center_of_mass
from octo.problem.asked import Asked
from octo.shown import Shown
from octo.solver import export, saved
from octo.solver.doubts import largest_step, warnings
from octo.solver.gait import Gait, measure_cycle, measure_gait, stances
from octo.solver.stride import ARRAYS as STRIDE
from octo.solver.stride import Stride, tiled

Array = NDArray[np.float64]
LOADED = 0.01  # of the weight: a contact that carries more counts as loaded


class Status(Enum):
    """Why the solver stopped, in words."""

    CONVERGED = (
        "converged: the full step, the constraints and the gradient of the Lagrangian are "
        "within tolerance"
    )
    ACCEPTABLE = (
        "acceptable: the constraints are within tolerance and E has changed by less than "
        "1e-4 of itself in 20 iterations"
    )
    STALLED = (
        "stalled: no step improves the merit any more, and the tests of convergence do not hold"
    )
    ITERATION_LIMIT = "stopped at the limit of iterations before it converged"
    TIME_LIMIT = "stopped at the time limit before it converged"
    JOINED = (
        "joined: every piece converged with its ends fixed; as one problem it did not "
        "converge, or stumbled"
    )
    INTERRUPTED = "interrupted: this is the best iterate so far"
    NOT_FINITE = "stopped: the dynamics at the start are not finite"
    SIMULATED = "simulated: every implicit step was solved"
    UNSOLVED = "simulated, but some implicit steps were not solved"

    @property
    def converged(self) -> bool:
        return self in (Status.CONVERGED, Status.ACCEPTABLE, Status.JOINED, Status.SIMULATED)

    @property
    def label(self) -> str:
        """The name reports use: "converged", "iteration_limit", …"""
        return self.name.lower()


HISTORY = (
    "pass",  # counted from 1
    "iteration",  # counted from 0, the start of the pass
    "energy",  # E
    "violation",  # N, ‖C‖∞ scaled back by mg
    "dual",  # ‖∇E + Aᵀlam‖∞
    "step",  # ‖Δ‖∞ of the full KKT step, rad and m
    "taken",  # ‖Δ‖∞ of the step taken, 0 where it was rejected
    "ratio",  # actual/predicted reduction of the merit
    "radius",  # trust radius
    "sigma",  # largest regularisation weight
    "factorizations",
    "seconds",  # since the first iterate
)


@dataclass(frozen=True, eq=False, repr=False)
class Solution(Shown):
    """A motion that octo found. All arrays are plain NumPy; nothing here needs the problem it came
    from.

    A motion of N steps has N+1 moments, 0, dt … N·dt. How long its arrays are, and which moment a
    row is of:

    =========================  =================  ============================================
    array                      shape              row i
    =========================  =================  ============================================
    times                      (N+1,)             moment i, s
    x[1:]                      (N+1, nx)          configuration at moment i
    x                          (N+2, nx)          the same behind one row for moment −1
    v                          (N+1, nx)          velocity over the step that ends at moment i
    com, yaw                   (N+1, 3), (N+1)    at moment i
    u                          (N, nu)            torque from moment i to moment i+1
    contact arrays             (N, c, …)          at moment i+1
    =========================  =================  ============================================

    The row of x for moment −1 says v[0]; contact arrays are normal_force, loaded, stance and all
    whose names begin with ``contact_``, but contact_names.

    Attributes
    ----------
    name: of the robot, or "custom".
    character: None for user-written dynamics.
    dt: s, of one step.
    basis: "nodes" or "hermite".
    x: (N+2, nx) configurations x_{-1}, x_0 … x_N, rad and m.
    u: (N, nu) N m or N; u[i] acts from x_i to x_{i+1}.
    unknowns: (K, nc) the solver's own variables, for warm starts.
    multipliers: (K, ma) of C, for warm starts.
    status: how the solve ended, with its sentence.
    iterations: of all passes.
    factorizations: of the KKT matrix, in all passes.
    terms: E by term; ``energy`` is their sum.
    violation: ‖C‖∞ in N.
    pointwise_residual: ‖U_/FD‖∞ in N (moments over ℓ).
    contact_names: the spheres that touch the terrain (c of them).
    contact_force: (N, c, 3) N, at x_1 … x_N.
    contact_point: (N, c, 3) m.
    contact_velocity: (N, c, 3) m/s.
    contact_normal: (N, c, 3).
    contact_depth: (N, c) m.
    ground: sampled terrain under the motion: x (a,), y (b,), z (a, b) m.
    history: one column per name of HISTORY, one row per iteration of every pass.
    seconds: of the solve.
    setup_seconds: before it: compiling and the start.
    processor_seconds: processor time of the solve, all threads; equals seconds on one thread of an
        idle machine.
    cycle: what a cycle is carried on with; None of other motions.
    stages: seconds by stage.
    passes: a record (dict) per pass.
    starts: a record per start of a batch.
    asked: what the terms, or the goal, ask of the whole motion, and what came of it.
    """

    FILE: ClassVar[str] = "solution.npz"  # in a folder that octo wrote

    name: str
    character: Character | None
    dt: float
    basis: str
    x: Array
    u: Array
    unknowns: Array
    multipliers: Array
    status: Status
    iterations: int
    factorizations: int
    terms: dict[str, float]
    violation: float
    pointwise_residual: float
    weight: float  # N
    length: float  # m, ℓ
    torque_limit: Array  # (nu,)
    contact_names: tuple[str, ...]
    contact_force: Array
    contact_point: Array
    contact_velocity: Array
    contact_normal: Array
    contact_depth: Array
    ground: dict[str, Array]
    history: dict[str, Array]
    parameters: dict[str, float]  # of the dynamics, of the last pass
    seconds: float
    setup_seconds: float
    processor_seconds: float = 0.0
    seed: int = 0
    device: str = "cpu"
    cycle: Stride | None = None
    stages: dict[str, float] = field(default_factory=dict)
    passes: tuple[dict[str, Any], ...] = ()
    starts: tuple[dict[str, Any], ...] = ()
    asked: tuple[Asked, ...] = ()

    # -- the motion --------------------------------------------------------------------------------

    @property
    def steps(self) -> int:
        return len(self.x) - 2

    @property
    def times(self) -> Array:
        """(N+1,) s, of x_0 … x_N."""
        return np.asarray(self.dt * np.arange(self.steps + 1), dtype=float)

    @property
    def v(self) -> Array:
        """(N+1, nx) rad/s and m/s, (x_i − x_{i-1})/dt of x_0 … x_N: of the chart's coordinates, as
        x."""
        return np.diff(self.x, axis=0) / self.dt

    @property
    def converged(self) -> bool:
        return self.status.converged

    @property
    def energy(self) -> float:
        return float(sum(self.terms.values()))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the coordinates in the order of x."""
        if self.character is None:
            return tuple(f"x{j}" for j in range(self.x.shape[1]))
        return tuple(joint.name for joint in self.character.joints)

    @property
    def actuated_names(self) -> tuple[str, ...]:
        """Names of the coordinates that u drives, in its order."""
        if self.character is None:
            return tuple(f"u{j}" for j in range(self.u.shape[1]))
        return tuple(self.character.joints[j].name for j in self.character.actuated)

    @property
    def com(self) -> Array:
        """(N+1, 3) m, centre of mass at x_0 … x_N; zeros for user-written dynamics."""
        if self.character is None:
            return np.zeros((self.steps + 1, 3))
        return center_of_mass(self.character, self.x[1:])

    @property
    def yaw(self) -> Array:
        """(N+1,) rad, unwrapped heading of the base at x_0 … x_N."""
        if self.character is None:
            return np.zeros(self.steps + 1)
        rotation = body_poses(self.character, self.x[1:])[0][:, self.character.base_body]
        return np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))

    def tile(self, strides: int) -> Solution:
        """Whole strides of a cycle one after the other: a mirrored one has two pieces a stride.

        Raises
        ------
        ProblemError: the motion is no cycle. ValueRangeError: fewer than one stride.
        """
        return tiled(self, strides)

    # -- what the feet do --------------------------------------------------------------------------

    @property
    def normal_force(self) -> Array:
        """(N, c) N."""
        return np.sum(self.contact_force * self.contact_normal, axis=-1)

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(N, c) contacts that carry at least 1 % of the weight."""
        return self.normal_force >= LOADED * self.weight

    @property
    def stance(self) -> NDArray[np.bool_]:
        """(N, c) contacts that stand at x_1 … x_N, without the flicker of a threshold: what
        ``gait`` counts."""
        return stances(self.normal_force, self.weight)

    def _loaded(self, values: Array) -> Array:
        chosen = values[self.loaded]
        return chosen if chosen.size else np.zeros(1)

    @property
    def penetration(self) -> float:
        """m, mean over loaded contact-steps."""
        return float(self._loaded(np.maximum(self.contact_depth, 0.0)).mean())

    @property
    def penetration_max(self) -> float:
        return float(self._loaded(np.maximum(self.contact_depth, 0.0)).max())

    @property
    def slip(self) -> float:
        """m/s, root mean square of the tangential velocity over loaded contact-steps."""
        normal = self.contact_normal
        along = self.contact_velocity - normal * np.sum(
            normal * self.contact_velocity, axis=-1, keepdims=True
        )
        return float(np.sqrt(np.mean(self._loaded(np.sum(along**2, axis=-1)))))

    def _friction_use(self) -> Array:
        force = self.normal_force
        tangential = np.linalg.norm(
            self.contact_force - self.contact_normal * force[..., None], axis=-1
        )
        return self._loaded(tangential / np.where(self.loaded, force, 1.0))

    @property
    def friction_use(self) -> float:
        """Largest |f_t|/f_n of a loaded contact."""
        return float(self._friction_use().max())

    @property
    def friction_use_95(self) -> float:
        """95 % quantile of |f_t|/f_n over loaded contact-steps."""
        return float(np.quantile(self._friction_use(), 0.95))

    @property
    def torque_excess(self) -> float:
        """Largest |u|/limit over the joints that have a limit; 0 where none has."""
        limited = np.isfinite(self.torque_limit) & (self.torque_limit > 0)
        if not limited.any() or not self.steps:
            return 0.0
        return float(np.max(np.abs(self.u[:, limited]) / self.torque_limit[limited]))

    @property
    def power(self) -> float:
        """W, mean of Σ|u dq/dt| over the motion: work done by the joints and on them; 0 for
        user-written dynamics."""
        if self.character is None:
            return 0.0
        turned = np.diff(self.x[1:], axis=0)[:, self.character.actuated]  # (N, nu) rad and m
        return float(np.abs(self.u * turned).sum(axis=1).mean()) / self.dt

    @cached_property
    def gait(self) -> Gait | None:
        """How good the motion is, in figures; of a cycle, carried on for some strides. None for
        user-written dynamics."""
        return measure_gait(self) if self.cycle is None else measure_cycle(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before the motion is used, whatever its status: leaps from one node to the
        next, a dt too long."""
        return warnings(self)

    # -- words and numbers -------------------------------------------------------------------------

    def report(self) -> dict[str, Any]:
        """The numbers of report.json; every one is finite, or None in ``gait`` where there is
        nothing to measure.

        A cycle has more: period, speed, sideways, turn, mirrored, and power.
        """
        travel = self.com[-1] - self.com[0]
        carried_on = {} if self.cycle is None else {**self.cycle.plain(), "power": self.power}
        return {
            "status": self.status.label,
            "status_sentence": self.status.value,
            "converged": self.converged,
            "iterations": self.iterations,
            "factorizations": self.factorizations,
            "energy": self.energy,
            "terms": dict(self.terms),
            "asked": [one.report() for one in self.asked],
            "warnings": list(self.warnings),
            "largest_step": largest_step(self),
            "violation": self.violation,
            "pointwise_residual": self.pointwise_residual,
            "weight": self.weight,
            "com_travel": [float(v) for v in travel],
            "penetration": self.penetration,
            "penetration_max": self.penetration_max,
            "slip": self.slip,
            "friction_use": self.friction_use,
            "friction_use_95": self.friction_use_95,
            "torque_excess": self.torque_excess,
            "gait": None if self.gait is None else self.gait.report(),
            "seconds": self.seconds,
            "processor_seconds": self.processor_seconds,
            "setup_seconds": self.setup_seconds,
            "seconds_per_iteration": self.seconds / max(self.iterations, 1),
            "stages": dict(self.stages),
            "passes": [dict(record) for record in self.passes],
            "device": self.device,
            "basis": self.basis,
            "steps": self.steps,
            "dt": self.dt,
            "robot": self.name,
            "seed": self.seed,
            **carried_on,
        }

    @property
    def _sampled(self) -> str:
        carried_on = "" if self.cycle is None else f"{self.cycle.in_words(self.steps * self.dt)}, "
        return f"{carried_on}{self.steps} steps of {self.dt:.6g} s ({self.basis})"

    @property
    def _piece(self) -> str:
        return "in half a stride the " if self.cycle is not None and self.cycle.mirrored else ""

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        lines = [
            f"{self.name}, {self._sampled}: {self.status.value}",
            f"  {self.iterations} iterations in {self.seconds:.2f} s on {self.device}, E = "
            f"{self.energy:.5g} "
            f"({', '.join(f'{name} {value:.3g}' for name, value in self.terms.items())})",
            f"  ‖C‖∞ = {self.violation:.1e} N of {self.weight:.0f} N weight, pointwise residual "
            f"{self.pointwise_residual:.1e} N",
        ]
        if self.character is not None:
            travel = self.com[-1] - self.com[0]
            lines.append(
                f"  {self._piece}centre of mass travels ({travel[0]:.2f}, {travel[1]:.2f}, "
                f"{travel[2]:.2f}) m; feet sink "
                f"{1e3 * self.penetration:.1f} mm and slip {self.slip:.3f} m/s; largest "
                f"|u|/limit {self.torque_excess:.2f}"
            )
        if self.gait is not None:
            lines.append(f"  {self.gait}")
        lines += [f"  {one}" for one in self.asked if not one.met]
        lines += [f"  warning: {sentence}" for sentence in self.warnings]
        return "\n".join(lines)

    # -- other tools -------------------------------------------------------------------------------

    def to_mujoco(self) -> tuple[Array, Array]:
        """MuJoCo's qpos (N+1, nq) and qvel (N+1, nv)."""
        return export.to_mujoco(self)

    def to_pinocchio(
        self, joints: Sequence[str] | None = None, circular: Collection[str] = ()
    ) -> tuple[Array, Array]:
        """Pinocchio's q (N+1, nq) and v (N+1, nv).

        ``joints`` names the order of its joints after the free flyer, ``circular`` those it keeps
        as cosine and sine.
        """
        return export.to_pinocchio(self, joints, circular)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """A table: time, coordinates, torques, contact forces; the first line has names and
        units."""
        export.to_csv(self, path)

    # -- files -------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: arrays, and the rest as JSON. Written beside, then renamed."""
        target = ending("path", path, (".npz",))
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _ARRAYS}
        arrays |= {f"ground_{k}": v for k, v in self.ground.items()} | {
            f"history_{k}": v for k, v in self.history.items()
        }
        plain = {
            f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in _ARRAYS
        }
        for name in ("ground", "history"):
            plain.pop(name)
        if self.cycle is not None:
            arrays |= {f"cycle_{name}": getattr(self.cycle, name) for name in STRIDE}
            plain["cycle"] = self.cycle.plain()
        plain["status"] = self.status.label
        plain["asked"] = [one.plain() for one in self.asked]
        plain["character"] = None if self.character is None else store.to_plain(self.character)
        arrays["plain"] = np.array(json.dumps(plain))
        with replacing(target) as beside, beside.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Solution:
        """Read a solution that :meth:`save` wrote: the file, or the folder of a command that holds
        a solution.npz.

        Raises
        ------
        RobotFileError: the file is missing, or something in it is not as octo writes it; one line
            that says what.
        """
        with archive.opened(store.file_of(path, Solution.FILE), "solution") as file:
            status = _status(file.word("status"))
            # what may be not finite
            failed = status in (Status.NOT_FINITE, Status.UNSOLVED, Status.INTERRUPTED)
            return Solution(**saved.fields_of(file, failed), status=status)


def _status(label: str) -> Status:
    """The status of the name that reports use."""
    known = {status.label: status for status in Status}
    if label not in known:
        raise UnknownNameError("status", label, known)
    return known[label]


def solution_of(given: Solution | str | os.PathLike[str]) -> Solution:
    """A Solution as it is, or the one that a file or a folder of octo's holds.

    Raises
    ------
    RobotFileError: there is none at that path. ProblemError: it is nothing of that kind.
    """
    found = Solution.load(given) if isinstance(given, (str, os.PathLike)) else given
    if not isinstance(found, Solution):
        raise ProblemError(
            f"solution is {said(found)}, must be a Solution, or the path of a file or folder of "
            "octo's"
        )
    return found


_ARRAYS = (
    "x",
    "u",
    "unknowns",
    "multipliers",
    "torque_limit",
    "contact_force",
    "contact_point",
    "contact_velocity",
    "contact_normal",
    "contact_depth",
)
