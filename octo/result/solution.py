"""What a solve returns: the motion, its cost, its error, and how it was found."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from octo.checks import Array, ending
from octo.errors import ProblemError, said
from octo.model import archive, store
from octo.result import export, saved
from octo.result.explanation import LEFT_OUT, MOST, Explanation, explained, sentence_of
from octo.result.footfalls import Footfalls, footfalls
from octo.result.gait import Gait, measure_cycle, measure_gait
from octo.result.trajectory import VECTORS, Trajectory
from octo.shown import Shown
from octo.solver.status import HISTORY, Status

REPORTED = (  # numbers and words that a report has as they are
    "converged iterations factorizations energy violation pointwise_residual weight penetration "
    "penetration_max slip friction_use friction_use_95 torque_excess seconds processor_seconds "
    "setup_seconds device basis steps dt seed"
)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Solution(Trajectory, Shown):
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

    The row of x for moment −1 says v[0]; contact arrays are normal_force, loaded, stance, touched
    and all whose names begin with ``contact_`` or ``touch_``, but contact_names and touch_names.

    Attributes
    ----------
    name: of the robot, or of the soft body; "custom".
    character: None for user-written dynamics and soft bodies.
    dt: s, of one step; of phases the mean of all (``times`` says when each begins).
    basis: "nodes" or "hermite".
    x: (N+2, nx) configurations x_{-1}, x_0 … x_N, rad and m.
    u: (N, nu) N m or N; u[i] acts from x_i to x_{i+1}.
    unknowns: (K, nc) the solver's own variables, for warm starts.
    multipliers: (K, ma) of C, for warm starts.
    slacks: of rows between bounds, for warm starts: slacks s, multipliers of their lower and upper
        bounds and of equalities, (N, rows) each, and the barrier's weight mu (1,); empty without
        such rows.
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
    touch_force: (N, m, 3) N between bodies, of ``touch_names`` (m,): on the body of the sphere; the
        opposite acts on the body of the solid.
    touch_point: (N, m, 3) m, where both act.
    ground: sampled terrain under the motion: x (a,), y (b,), z (a, b) m.
    soft: of a soft body's motion what x means: its surface, modes and chart; None of others.
    world: the shapes that the motion is on; None on a plane or a user-written terrain.
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
    bounds: of each constraint the row that is nearest to breaking it, or breaks it most: where, its
        value and its bound, and how far beyond it is.
    residuals: of each row of C the moment at which most of a force or a moment is missing.
    phases: of ``octo.phases`` the motion of each, with what was found of it alone; how it was found
        is told of the whole. Everything else here is of the whole, with the ground and the
        ``parameters`` of the first phase.
    """

    FILE: ClassVar[str] = "solution.npz"  # in a folder that octo wrote

    multipliers: Array  # (K, ma)
    status: Status
    iterations: int
    factorizations: int
    history: dict[str, Array]
    seconds: float
    setup_seconds: float
    processor_seconds: float = 0.0
    slacks: dict[str, Array] = field(default_factory=dict)
    seed: int = 0
    device: str = "cpu"
    stages: dict[str, float] = field(default_factory=dict)
    passes: tuple[dict[str, Any], ...] = ()
    starts: tuple[dict[str, Any], ...] = ()
    phases: tuple[Solution, ...] = ()

    @property
    def converged(self) -> bool:
        return self.status.converged

    def tile(self, strides: int) -> Solution:
        """Whole strides of a cycle one after the other: a mirrored one has two pieces a stride.

        Raises
        ------
        ProblemError: the motion is no cycle. ValueRangeError: fewer than one stride.
        """
        return replace(super().tile(strides), multipliers=self.multipliers[:0], slacks={})

    @cached_property
    def gait(self) -> Gait | None:
        """How good the motion is, in figures; of a cycle, carried on for some strides. None for
        user-written dynamics."""
        return measure_gait(self) if self.cycle is None else measure_cycle(self)

    @cached_property
    def footfalls(self) -> list[Footfalls]:
        """Where and when each foot touches down, and how even that is (``unevenness``); none of
        user-written dynamics."""
        return footfalls(self)

    def explain(self) -> Explanation:
        """Why the solve ended as it did: ``print(solution.explain())``.

        It says which constraints are broken, which laws of physics do not hold yet, which terms
        dominate E, and what may help. :func:`octo.explain` also looks for constraints that
        contradict each other, which costs solves.
        """
        return explained(self, self.status, self.passes)

    def _why_leaps(self) -> str:
        why = [f"; octo.solve does not: {own[LEFT_OUT]}" for own in self.passes if LEFT_OUT in own]
        return "".join(why)

    @property
    def row_multipliers(self) -> Array:
        """(N, rows) of the rows between bounds: positive where an upper bound holds one back."""
        if not self.slacks:
            return np.zeros((len(self.u), 0))
        return self.slacks["upper"] - self.slacks["lower"] + self.slacks["equal"]

    @property
    def sentence(self) -> str:
        """How the solve ended; where it did not converge, with the constraints left violated."""
        return sentence_of(self.status, self.bounds)

    # -- words and numbers -------------------------------------------------------------------------

    def report(self) -> dict[str, Any]:
        """The numbers of report.json; every one is finite, or None in ``gait`` where there is
        nothing to measure.

        A cycle has more: period, speed, sideways, turn, mirrored, and power.
        """
        travel = self.com[-1] - self.com[0]
        more = {} if self.cycle is None else {**self.cycle.plain(), "power": self.power}
        if self.phases:
            more["phases"] = [phase.report() for phase in self.phases]
        return {
            "status": self.status.label,
            "status_sentence": self.sentence,
            **{name: getattr(self, name) for name in REPORTED.split()},
            "terms": dict(self.terms),
            "asked": [one.report() for one in self.asked],
            "bounds": [one.report() for one in self.bounds],
            "residuals": [one.plain() for one in self.residuals],
            "warnings": list(self.warnings),
            "largest_step": self.largest_step,
            "com_travel": [float(v) for v in travel],
            "gait": None if self.gait is None else self.gait.report(),
            "seconds_per_iteration": self.seconds / max(self.iterations, 1),
            "stages": dict(self.stages),
            "passes": [dict(record) for record in self.passes],
            "robot": self.name,
            **more,
        }

    def __str__(self) -> str:
        carried_on = "" if self.cycle is None else f"{self.cycle.in_words(self.steps * self.dt)}, "
        sampled = f"{carried_on}{self.sampling} ({self.basis})"
        terms = ", ".join(f"{name} {value:.3g}" for name, value in self.terms.items())
        lines = [
            f"{self.name}, {sampled}: {self.sentence}",
            f"  {self.iterations} iterations in {self.seconds:.2f} s on {self.device}, E = "
            f"{self.energy:.5g} ({terms})",
            f"  ‖C‖∞ = {self.violation:.1e} N of {self.weight:.0f} N weight, pointwise residual "
            f"{self.pointwise_residual:.1e} N",
        ]
        if self.extent is not None:
            travel = ", ".join(f"{metres:.2f}" for metres in self.com[-1] - self.com[0])
            half = self.cycle is not None and self.cycle.mirrored
            if self.soft is None:
                feet, more = "feet", ""
                end = f"largest |u|/limit {self.torque_excess:.2f}"
            else:
                feet, more = "it", "s"
                air = float(self.intervals[~self.loaded.any(axis=1)].sum())
                end = f"it bends by {self.bends:.3g} m at most, and is in the air for {air:.3g} s"
            lines.append(
                f"  {'in half a stride the ' if half else ''}centre of mass travels ({travel}) m; "
                f"{feet} sink{more} {1e3 * self.penetration:.1f} mm and slip{more} "
                f"{self.slip:.3f} m/s; {end}"
            )
        if self.gait is not None:
            lines.append(f"  {self.gait}")
        lines += [f"  {phase.as_phase(k)}" for k, phase in enumerate(self.phases)]
        lines += [f"  {one}" for one in self.bounds]
        lines += [f"  {one}" for one in self.asked if not one.met]
        lines += [f"  warning: {sentence}" for sentence in self.warnings]
        return "\n".join(lines)

    def as_phase(self, number: int) -> str:
        """One line of the motion as a phase of another one, with the terms that dominate."""
        largest = sorted(self.terms.items(), key=lambda item: -item[1])[:MOST]
        terms = ", ".join(f"{name} {value:.3g}" for name, value in largest)
        more = ", …" if len(self.terms) > MOST else ""
        return f"phase {number}: {self.sampling}, E = {self.energy:.5g} ({terms}{more})"

    # -- other tools -------------------------------------------------------------------------------

    to_mujoco = export.to_mujoco
    to_pinocchio = export.to_pinocchio
    to_csv = export.to_csv

    # -- files -------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: arrays, and the rest as JSON. Written beside, then renamed."""
        target = ending("path", path, (".npz",))
        saved.write(target, {f.name: getattr(self, f.name) for f in fields(self)})

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
            found = saved.fields_of(file)
            phases = tuple(Solution(**own) for own in found.pop("phases"))
            return Solution(**found, phases=phases)


def recorded(**fields: Any) -> Solution:
    """A motion in the nodes basis that nobody solved: what a plant did, or a robot that stands.

    Of its fields those that have no default are what was seen; the others, zeros or nothing, say
    that no solver found it and that no terms were asked for. ``contact_force`` (N, c, 3) gives the
    shape of what is not known of the contacts.
    """
    steps, contacts = fields["contact_force"].shape[:2]
    known: dict[str, Any] = {
        "basis": "nodes",
        "unknowns": fields["x"][2:],
        "multipliers": np.zeros((steps, 0)),
        "status": Status.SIMULATED,
        "contact_depth": np.zeros((steps, contacts)),
        "history": {name: np.zeros(0) for name in HISTORY},
        **{name: np.zeros((steps, contacts, 3)) for name in VECTORS},
        **{name: {} for name in ("terms", "parameters", "ground")},
        **dict.fromkeys(("iterations", "factorizations"), 0),
        **dict.fromkeys(("violation", "pointwise_residual", "seconds", "setup_seconds"), 0.0),
    }
    robot = fields["character"]
    if robot is not None:
        names = tuple(robot.contacts[k].name for k in robot.terrain_contacts)
        known |= {"name": robot.name, "torque_limit": robot.torque_limit, "contact_names": names}
    return Solution(**{**known, **fields})


def solution_of(given: Solution | str | os.PathLike[str]) -> Solution:
    """A Solution as it is, or the one that a file or a folder of octo's holds."""
    found = Solution.load(given) if isinstance(given, (str, os.PathLike)) else given
    if not isinstance(found, Solution):
        allowed = "a Solution, or the path of a file or folder of octo's"
        raise ProblemError(f"solution is {said(found)}, must be {allowed}")
    return found
