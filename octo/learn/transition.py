"""A learned transition (§7): a network that says from one control which one is next."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from octo.arrays import Array, array_module, like
from octo.checks import ending, numbers, one_of, whole
from octo.errors import ProblemError, ShapeError, ValueRangeError, said
from octo.files import replacing
from octo.learn.frame import Frame
from octo.learn.network import ACTIVATIONS, Network
from octo.model.archive import Archive, opened
from octo.problem.basis import Hermite
from octo.problem.problem import Problem

STATES = ("body", "world")
WIDEST, DEEPEST = 4096, 16
SAME = 1e-9  # relative, of the seconds of a transition


@dataclass(frozen=True, eq=False)
class Transition:
    """c_{i+1} ≈ RNN(c_i), a fully connected network of what changes from a pose at rest (Eq. 13).

    Controls are those of the basis: (x_i, x_i − x_{i−1}) of nodes, (x_k, τ ẋ_k) of Hermite splines.
    The network sees and says lengths in parts of the robot's ℓ and angles in rad.

    Parameters
    ----------
    hidden: how many numbers each hidden layer has.
    activation: "softplus" or "tanh".
    state: "body": the place on the ground and the yaw of a floating base are no inputs, and changes
        are in the frame of the heading; "world": all of a control is an input, as in the paper, and
        with its place a walk has a clock.
    fit: which robot, basis and time it is for; None until :meth:`started` or
        :func:`octo.learn.solve` fill it in.
    weights: (count,) of the network; the same.

    Raises
    ------
    ValueRangeError, UnknownNameError: naming the field and what is allowed.
    """

    hidden: Sequence[int] = (128, 128, 128)
    activation: str = "softplus"
    state: str = "body"
    fit: Fit | None = None
    weights: Array | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.hidden, (tuple, list)) or not 1 <= len(self.hidden) <= DEEPEST:
            allowed = f"a tuple of 1 to {DEEPEST} sizes of layers"
            raise ValueRangeError(f"Transition.hidden is {said(self.hidden)}, must be {allowed}")
        sizes = tuple(whole("Transition.hidden", size, 1, WIDEST) for size in self.hidden)
        object.__setattr__(self, "hidden", sizes)
        one_of("Transition.activation", self.activation, ACTIVATIONS)
        one_of("Transition.state", self.state, STATES)
        if self.weights is not None:
            if self.fit is None:
                raise ProblemError("Transition.weights are given without fit: use started(problem)")
            w = numbers("Transition.weights", self.weights, (self.network.count,))
            object.__setattr__(self, "weights", np.array(w))

    def __repr__(self) -> str:
        layers = " × ".join(str(size) for size in self.hidden)
        fit = "not started" if self.fit is None else f"{self.network.count} weights, {self.fit}"
        return f"Transition of the {self.state}'s state: {layers} {self.activation}, {fit}"

    @property
    def known(self) -> Fit:
        """``fit``, once there is one.

        Raises
        ------
        ProblemError: the transition was not started yet.
        """
        if self.fit is None or self.weights is None:
            raise ProblemError(
                "the transition has no weights yet: train it with octo.learn.solve, or begin with "
                "transition.started(problem)"
            )
        return self.fit

    @cached_property
    def network(self) -> Network:
        """The layers."""
        assert self.fit is not None
        frame = self.frame
        return Network((len(frame.kept), *self.hidden, 2 * frame.n), self.activation)

    @cached_property
    def frame(self) -> Frame:
        """What it sees of a control."""
        assert self.fit is not None
        heading = self.fit.heading if self.state == "body" else None
        return Frame(self.fit.size, self.fit.center, heading)

    @cached_property
    def layers(self) -> list[tuple[Array, Array]]:
        """The matrices (out, in) and biases (out,) of the layers."""
        _, weights = self.known, self.weights
        return self.network.layers(weights)

    def started(self, problem: Problem, seed: int = 0) -> Transition:
        """The same with weights to begin with, for controls of a problem.

        Parameters
        ----------
        seed: of the random weights.
        """
        whole("seed", seed, 0)
        begun = replace(self, fit=Fit.of(problem), weights=None)
        return replace(begun, weights=begun.network.started(seed))

    def with_weights(self, weights: Array) -> Transition:
        """The same with other weights (count,)."""
        return replace(self, weights=weights)

    def check(self, problem: Problem) -> None:
        """Refuse a problem of another robot, basis or time of a transition than it was made for.

        Raises
        ------
        ProblemError: names what differs. ShapeError: another number of coordinates.
        """
        self.known.check(problem)

    # -- what it says ------------------------------------------------------------------------------

    def next(self, c: Array) -> Array:
        """The controls (…, 2 nx) that it says come next.

        Parameters
        ----------
        c: controls (…, 2 nx), rad and m; of NumPy, or of a device.
        """
        layers = self._layers_at(c)
        return self.frame.following(c, self.network.value(layers, self.frame.inputs(c)))

    def unroll(self, c: Array, steps: int) -> Array:
        """Control after control, each from the one before: (…, steps + 1, 2 nx), c first.

        Parameters
        ----------
        c: (…, 2 nx) the first control, rad and m. steps: how many follow.
        """
        size = 2 * self.known.n
        c = numbers("c", c)
        if c.ndim < 1 or c.shape[-1] != size:
            raise ShapeError("c", c.shape, f"(…, {size})")
        whole("steps", steps, 0)
        made = np.empty((*c.shape[:-1], steps + 1, size))
        made[..., 0, :] = c
        with np.errstate(over="ignore", invalid="ignore"):  # where it explodes it is not finite
            for k in range(steps):
                made[..., k + 1, :] = self.next(made[..., k, :])
        return made

    def residual(self, c: Array, c_next: Array) -> Array:
        """(…, 2 nx) of Eq. 14: c_next − RNN(c) in the frame, lengths in ℓ.

        Parameters
        ----------
        c, c_next: controls (…, 2 nx), rad and m.
        """
        layers, frame = self._layers_at(c), self.frame
        return frame.change(c, c_next) - self.network.value(layers, frame.inputs(c))

    def residual_slopes(self, c: Array, c_next: Array) -> tuple[Array, Array]:
        """The :meth:`residual`, and its slopes (…, 2 nx, 4 nx) with respect to (c, c_next).

        Parameters
        ----------
        c, c_next: controls (…, 2 nx), rad and m.
        """
        layers, frame = self._layers_at(c), self.frame
        value, slopes = self.network.slopes(layers, frame.inputs(c))
        of_c, of_next = frame.change_slopes(c, c_next)
        both = [of_c - frame.through(c, slopes), of_next]
        return frame.change(c, c_next) - value, array_module(c).concatenate(both, axis=-1)

    def _layers_at(self, c: Array) -> list[tuple[Array, Array]]:
        """The layers where c is."""
        if isinstance(c, np.ndarray):
            return self.layers
        return [(like(matrix, c), like(bias, c)) for matrix, bias in self.layers]

    # -- files -------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: arrays, and the rest as JSON."""
        fit, target = self.known, ending("path", path, (".npz",))
        plain = {
            "hidden": list(self.hidden),
            "activation": self.activation,
            "state": self.state,
            **fit.plain(),
        }
        arrays = {"weights": self.weights, "size": fit.size, "center": fit.center}
        with replacing(target) as beside, beside.open("wb") as file:
            np.savez(file, plain=np.array(json.dumps(plain)), **arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Transition:
        """Read a transition that :meth:`save` wrote.

        Raises
        ------
        RobotFileError: the file is missing, or something in it is not as octo writes it.
        """
        with opened(path, "transition") as file:
            hidden = tuple(file.plain.get("hidden", ()))
            named = file.word("activation"), file.word("state")
            begun = Transition(hidden, *named, fit=Fit.read(file))
            return begun.with_weights(file.array("weights", (begun.network.count,)))


@dataclass(frozen=True, eq=False)
class Fit:
    """What a transition was made for.

    Attributes
    ----------
    robot: its name, "custom" of user-written dynamics. basis: "nodes" or "hermite".
    seconds: of one transition. heading: coordinates x, y and yaw of a floating base, if any.
    size: (nx,) m or rad, one of each coordinate for the network. center: (nx,) where it is zero.
    """

    robot: str
    basis: str
    seconds: float
    heading: tuple[int, int, int] | None
    size: Array
    center: Array

    def __str__(self) -> str:
        return f"for {self.robot} in {self.basis} of {self.seconds:.4g} s"

    @property
    def n(self) -> int:
        return len(self.size)

    @classmethod
    def of(cls, problem: Problem) -> Fit:
        """Of a problem's controls, with its start as the center.

        Raises
        ------
        ProblemError: the state of objects beside the robot, which have places of their own.
        """
        robot, size, heading = problem.character, np.ones(problem.dynamics.nx), None
        if robot is not None:
            size[[joint.kind == "slide" for joint in robot.joints]] = problem.length
            if robot.base == "floating" and not robot.objects:
                first = robot.base_coordinate
                heading = first, first + 1, first + 3
        name = "custom" if robot is None else robot.name
        basis, seconds = problem.basis_object.name, seconds_of(problem)
        return cls(name, basis, seconds, heading, size, np.array(problem.start))

    def check(self, problem: Problem) -> None:
        """Raises
        ------
        ProblemError, ShapeError: the problem's is another one."""
        other = Fit.of(problem)
        for name, own, its in (
            ("robot", self.robot, other.robot),
            ("basis", self.basis, other.basis),
        ):
            if own != its:
                raise ProblemError(f"the transition's {name} is {own!r}, the problem's is {its!r}")
        if self.n != other.n:
            raise ShapeError("the problem's x", (other.n,), f"the transition's ({self.n},)")
        if abs(self.seconds - other.seconds) > SAME * self.seconds:
            raise ProblemError(
                f"the transition is of {self.seconds:.6g} s, from one control of the problem to "
                f"the next it is {other.seconds:.6g} s"
            )

    def plain(self) -> dict[str, Any]:
        """For files, without the arrays."""
        own = {name: getattr(self, name) for name in ("robot", "basis", "seconds")}
        return {**own, "heading": None if self.heading is None else list(self.heading)}

    @classmethod
    def read(cls, file: Archive) -> Fit:
        """Raises
        ------
        ValueRangeError, ShapeError: what stands there is no such thing."""
        size = file.array("size", (None,))
        heading = file.plain.get("heading")
        legal = isinstance(heading, list) and len(heading) == 3
        if heading is not None and not (legal and all(k in range(len(size)) for k in heading)):
            raise ValueRangeError(f"heading is {said(heading)}, must be three coordinates")
        if not (size > 0.0).all():
            raise ValueRangeError("size has a number that is not positive")
        made = None if heading is None else (int(heading[0]), int(heading[1]), int(heading[2]))
        own = file.word("robot"), file.word("basis"), file.number("seconds", positive=True), made
        return cls(*own, size, file.array("center", size.shape))


def seconds_of(problem: Problem) -> float:
    """s, from one control to the next."""
    basis = problem.basis_object
    return float(problem.dt) * (basis.steps_per_segment if isinstance(basis, Hermite) else 1)
