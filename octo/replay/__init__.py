"""A plan in another simulator: its torques, a PD on the joints, a wrench on the base."""

from octo.replay.run import Replay, Start, replay

__all__ = ["Replay", "Start", "replay"]
