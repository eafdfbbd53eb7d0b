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
from octo.learn.controls import count_of, first_control, nodes_of
from octo.learn.fit import Fit, command_of
from octo.learn.frame import Frame
from octo.learn.network import ACTIVATIONS, Network
from octo.library import Library
from octo.model.archive import opened
from octo.problem.phases import Described
from octo.problem.problem import Problem
from octo.starts import Starter

STATES = ("body", "world")
WIDEST, DEEPEST = 4096, 16


@dataclass(frozen=True, eq=False)
class Transition(Starter):
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
    command: names of numbers of a problem that are inputs too, the same at all of its steps: fields
        of terms as "CenterOfMassVelocity.velocity", parameters of the dynamics, as
        ``octo.Library.commands`` names them. It is trained on a library.

    Raises
    ------
    ValueRangeError, UnknownNameError: naming the field and what is allowed.
    """

    hidden: Sequence[int] = (128, 128, 128)
    activation: str = "softplus"
    state: str = "body"
    fit: Fit | None = None
    weights: Array | None = None
    command: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.hidden, (tuple, list)) or not 1 <= len(self.hidden) <= DEEPEST:
            allowed = f"a tuple of 1 to {DEEPEST} sizes of layers"
            raise ValueRangeError(f"Transition.hidden is {said(self.hidden)}, must be {allowed}")
        sizes = tuple(whole("Transition.hidden", size, 1, WIDEST) for size in self.hidden)
        object.__setattr__(self, "hidden", sizes)
        one_of("Transition.activation", self.activation, ACTIVATIONS)
        one_of("Transition.state", self.state, STATES)
        words = self.command
        if not isinstance(words, (tuple, list)) or not all(isinstance(w, str) for w in words):
            allowed = "a tuple of names of commands"
            raise ValueRangeError(f"Transition.command is {said(words)}, must be {allowed}")
        object.__setattr__(self, "command", tuple(words))
        if self.weights is not None:
            if self.fit is None:
                raise ProblemError("Transition.weights are given without fit: use started(problem)")
            w = numbers("Transition.weights", self.weights, (self.network.count,))
            object.__setattr__(self, "weights", np.array(w))

    def __repr__(self) -> str:
        layers = " × ".join(str(size) for size in self.hidden)
        told = f", told {', '.join(self.command)}" if self.command else ""
        fit = "not started" if self.fit is None else f"{self.network.count} weights, {self.fit}"
        return f"Transition of the {self.state}'s state: {layers} {self.activation}{told}, {fit}"

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
        inputs = len(frame.kept) + len(self.fit.command_size)
        return Network((inputs, *self.hidden, 2 * frame.n), self.activation)

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

    def started(self, problem: Problem | Library, seed: int = 0) -> Transition:
        """The same with weights to begin with, for controls of a problem.

        Parameters
        ----------
        problem: or a library of motions: a command is seen by how far it is from their mean, in
            parts of their standard deviation; of a problem, from its own, as it is.
        seed: of the random weights.

        Raises
        ------
        UnknownNameError: there is no such command.
        """
        whole("seed", seed, 0)
        begun = replace(self, fit=Fit.of(problem, self.command), weights=None)
        return replace(begun, weights=begun.network.started(seed))

    def with_weights(self, weights: Array) -> Transition:
        """The same with other weights (count,)."""
        return replace(self, weights=weights)

    def check(self, problem: Problem) -> None:
        """Refuse a problem of another robot, basis or time of a transition than it was made for, or
        without its command.

        Raises
        ------
        ProblemError: names what differs. ShapeError: another number of coordinates.
        UnknownNameError: there is no such command.
        """
        self.known.check(problem)
        told = command_of(problem, self.command)
        if told.shape != self.known.command_size.shape:
            expected = self.known.command_size.shape
            raise ShapeError(f"the command {', '.join(self.command)}", told.shape, expected)

    def at(self, problem: Problem) -> Transition:
        """The transition for the command of one problem, which stands in its biases from then on:
        what it says needs no command any more. Itself, where it has none.

        Parameters
        ----------
        problem: that has the command.

        Raises
        ------
        OctoError: as of :meth:`check`.
        """
        self.check(problem)
        if not self.command:
            return self
        fit, (matrix, bias), weights = self.known, self.layers[0], self.weights
        assert weights is not None
        told = (command_of(problem, self.command) - fit.command_center) / fit.command_size
        seen = len(self.frame.kept)
        first = [matrix[:, :seen].ravel(), bias + matrix[:, seen:] @ told]
        rest = weights[matrix.size + bias.size :]
        own = replace(self, fit=fit.plainly, weights=None, command=())
        return own.with_weights(np.concatenate([*first, rest]))

    def start_of(self, problem: Described) -> Array:
        """x_0 … x_N (N+1, nx), rad and m: unrolled from the start of a problem.

        Parameters
        ----------
        problem: without phases and without a cycle.

        Raises
        ------
        OctoError: the problem is not one that it was made for, or what it says is not finite.
        """
        if not isinstance(problem, Problem) or problem.cycle is not None:
            what = "a cycle" if isinstance(problem, Problem) else "phases"
            raise ProblemError(f"start is a transition and the problem has {what}: give nodes")
        made = self.at(problem).unroll(first_control(problem), count_of(problem))
        if not np.isfinite(made).all():
            raise ProblemError(
                "start is a transition that explodes from where the problem begins: train it with "
                "loss='recurrent', or leave it out"
            )
        return nodes_of(problem, made)

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
        """The layers where c is.

        Raises
        ------
        ProblemError: they wait for a command.
        """
        self.check_told()
        if isinstance(c, np.ndarray):
            return self.layers
        return [(like(matrix, c), like(bias, c)) for matrix, bias in self.layers]

    def check_told(self) -> None:
        """Refuse a transition that waits for a command.

        Raises
        ------
        ProblemError: names the command.
        """
        if self.command:
            raise ProblemError(
                f"the transition asks for the command {', '.join(self.command)}: take "
                "transition.at(problem), which has that of the problem"
            )

    # -- files -------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: arrays, and the rest as JSON."""
        fit, target = self.known, ending("path", path, (".npz",))
        plain = {
            "hidden": list(self.hidden),
            "activation": self.activation,
            "state": self.state,
            "command": list(self.command),
            **fit.plain(),
        }
        arrays: dict[str, Any] = {"weights": self.weights, **fit.arrays}
        arrays["plain"] = np.array(json.dumps(plain))
        with replacing(target) as beside, beside.open("wb") as file:
            np.savez(file, **arrays)

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
            told = file.words("command") if "command" in file.plain else ()
            fit = Fit.read(file)
            begun = Transition(hidden, *named, fit=fit, command=told)
            if bool(told) != bool(len(fit.command_size)):
                raise ValueRangeError("command_size is not that of the command")
            return begun.with_weights(file.array("weights", (begun.network.count,)))
