"""From one motion into another (§8.6): transitions between motions, and the graph of all of them,
through which a character is steered."""

from octo.motion_graph.build import build
from octo.motion_graph.graph import MotionGraph
from octo.motion_graph.one_transition import Transition, transition
from octo.motion_graph.route import Route

__all__ = ["MotionGraph", "Route", "Transition", "build", "transition"]
