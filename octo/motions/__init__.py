"""Motions from rest to rest: walk, stride sideways, turn, go to a place. A cycle is found first,
then how to get into it and out of it.

A walk of ten seconds is found in pieces, each of which is small: a stride that repeats (several
starts and periods, the best kept), from rest into it and out of it to rest, with both ends fixed
(several phases, the best kept), strides between. Joined they satisfy Newton's law; the whole is
then polished as one problem, which begins and ends at rest.
"""

from octo.motions.steady import go_to, stride, turn, walk

__all__ = ["go_to", "stride", "turn", "walk"]
