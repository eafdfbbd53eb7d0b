"""What Algorithm 2 keeps: a record of each round, and the result of all, with its files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from octo.errors import OutputError, RobotFileError
from octo.files import reason, replacing
from octo.learn.transition import Transition
from octo.model.archive import Archive
from octo.result.solution import Solution
from octo.shown import Shown

MOTION, NETWORK, ROUNDS = "solution.npz", "transition.npz", "rounds.json"


@dataclass(frozen=True)
class Round:
    """One round of Algorithm 2 (Fig. 11c).

    Attributes
    ----------
    number: from 1 on. weight: λ.
    iterations: of the motion. status: how its solve ended, as in reports.
    accepted: whether the motion of the solve was taken; else that of the round before stayed.
    energy: E of the other terms. markovian: E_RNN, λ left out, after the motion.
    violation: ‖C‖∞, N.
    before, between, after: Eq. 15 with the decay, before the round, after the motion and after the
        network: E + λ (E_RNN + decay · mean w²); None before the first motion.
    first_loss, loss: of the training, with the decay, before and after.
    training: iterations of L-BFGS. unrolled: Eq. 16 after it; None where it is not finite.
    motion_seconds, network_seconds: processor time.
    """

    number: int
    weight: float
    iterations: int
    status: str
    accepted: bool
    energy: float
    markovian: float
    violation: float
    before: float | None
    between: float
    after: float
    first_loss: float
    loss: float
    training: int
    unrolled: float | None
    motion_seconds: float
    network_seconds: float

    def __str__(self) -> str:
        kept = "" if self.accepted else ", not taken"
        unrolled = "explodes" if self.unrolled is None else f"{self.unrolled:.3g}"
        return (
            f"round {self.number}: λ = {self.weight:.3g}, motion {self.iterations} iterations "
            f"({self.status}{kept}), E = {self.energy:.4g}, E_RNN = {self.markovian:.3g}; network "
            f"{self.training} iterations, {self.first_loss:.3g} -> {self.loss:.3g}, unrolled "
            f"{unrolled}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Learned(Shown):
    """What :func:`octo.learn.solve` found.

    Attributes
    ----------
    motion: of the problem with E_RNN among its terms.
    transition: the network, trained on it.
    rounds: a record of each.
    unrolled: the motion that the network makes from the first control, with its own residual; None
        where it explodes, and between two rounds.
    interrupted: whether Ctrl-C, or the callback, ended it before the last round.
    """

    motion: Solution
    transition: Transition
    rounds: tuple[Round, ...]
    unrolled: Solution | None = None
    interrupted: bool = False

    def __str__(self) -> str:
        lines = [str(self.motion), *(f"  {one}" for one in self.rounds)]
        far = f"{self.error:.3g} from the motion (rms of a control, lengths in ℓ)"
        if self.unrolled is not None:
            far += f", pointwise residual {self.unrolled.pointwise_residual:.3g} N"
        explodes = self.error == float("inf")
        lines.append(f"  unrolled, the network {'explodes' if explodes else f'is {far}'}")
        return "\n".join(lines)

    @property
    def error(self) -> float:
        """√ of Eq. 16 after the last round: how far the unrolled network is from the motion, root
        mean square of a control, rad and ℓ; infinite where it explodes."""
        last = self.rounds[-1].unrolled if self.rounds else None
        return float("inf") if last is None else float(last**0.5)

    @property
    def seconds(self) -> tuple[float, float]:
        """Processor time of all rounds, of motions and of networks."""
        own = [(one.motion_seconds, one.network_seconds) for one in self.rounds]
        return sum(a for a, _ in own), sum(b for _, b in own)

    def report(self) -> dict[str, Any]:
        """The numbers of the rounds, and of what is unrolled."""
        motions, networks = self.seconds
        residual = None if self.unrolled is None else self.unrolled.pointwise_residual
        return {
            "rounds": [asdict(one) for one in self.rounds],
            "motion_seconds": motions,
            "network_seconds": networks,
            "unrolled_residual": residual,
            "interrupted": self.interrupted,
        }

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write a folder from which :func:`octo.learn.solve` goes on: solution.npz, transition.npz
        and rounds.json.

        Parameters
        ----------
        folder: where; it is made if it is not there.
        """
        to = Path(folder)
        try:
            to.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{to} cannot be written: {reason(error)}") from error
        self.motion.save(to / MOTION)
        self.transition.save(to / NETWORK)
        with replacing(to / ROUNDS) as beside:
            beside.write_text(json.dumps(self.report(), indent=1), encoding="utf-8")

    @staticmethod
    def load(folder: str | os.PathLike[str]) -> Learned:
        """Read a folder that :meth:`save` wrote, without what is unrolled.

        Raises
        ------
        RobotFileError: a file is missing, or something in it is not as octo writes it.
        """
        own = Path(folder)
        motion, network = Solution.load(own / MOTION), Transition.load(own / NETWORK)
        try:
            found = json.loads((own / ROUNDS).read_text(encoding="utf-8"))
            rounds = tuple(_round(one) for one in Archive({}, found).records("rounds"))
        except FileNotFoundError as error:
            raise RobotFileError(f"{own / ROUNDS} does not exist") from error
        except Exception as error:  # a damaged file may raise anything
            raise RobotFileError(f"{own / ROUNDS} is not a record of rounds: {error}") from error
        return Learned(motion, network, rounds)


def _round(record: Mapping[str, Any]) -> Round:
    """A record, each of its numbers checked."""
    plain = Archive({}, dict(record))
    made: dict[str, Any] = {}
    for name in (own.name for own in fields(Round)):
        if name in ("number", "iterations", "training"):
            made[name] = plain.whole(name)
        elif name == "status":
            made[name] = plain.word(name)
        elif name == "accepted":
            made[name] = plain.flag(name)
        elif name in ("unrolled", "before") and record.get(name) is None:
            made[name] = None
        else:
            made[name] = plain.number(name)
    return Round(**made)
