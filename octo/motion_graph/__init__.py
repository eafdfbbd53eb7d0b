"""From one motion into another (§8.6): how alike moments of motions are, and transitions between
them."""

from octo.motion_graph.one_transition import Transition, transition

__all__ = ["Transition", "transition"]
