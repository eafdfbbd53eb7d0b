"""A plan in another simulator: its torques as feed-forward beside a PD on the joints and a wrench
on the base."""

from octo.replay.run import Replay, Start, replay

__all__ = ["Replay", "Start", "replay"]
