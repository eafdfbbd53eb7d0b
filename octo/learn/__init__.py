"""Learned transitions (§7): a network that says from one control which one is next, trained beside
a motion, which it makes one that a network can say."""

from octo.learn.alternate import solve
from octo.learn.controls import controls
from octo.learn.markovian import Markovian
from octo.learn.rounds import Learned, Round
from octo.learn.training import Training, train
from octo.learn.transition import Transition
from octo.learn.unrolled import unrolled

__all__ = [
    "Learned",
    "Markovian",
    "Round",
    "Training",
    "Transition",
    "controls",
    "solve",
    "train",
    "unrolled",
]
