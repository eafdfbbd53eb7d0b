"""A snake of five links: 14 degrees of freedom, standing like a low bridge."""

from __future__ import annotations

from octo.model.character import Character
from octo.model.gallery.parts import Builder, Hinge

LINK = 0.4  # m
RADIUS = 0.06  # m


def chain() -> Character:
    """Five equal capsules, the middle one is the base; each of the four joints pitches, then yaws. 5 kg, 2 m."""
    builder = Builder("chain")
    half = LINK / 2
    middle = builder.base("middle", (-half, 0.0, 0.0), (half, 0.0, 0.0), RADIUS)
    builder.sphere("middle_front", middle, (half, 0.0, 0.0), RADIUS)
    builder.sphere("middle_back", middle, (-half, 0.0, 0.0), RADIUS)
    for end, sign in (("front", 1.0), ("back", -1.0)):
        parent, position = middle, (sign * half, 0.0, 0.0)
        for name, pitch, yaw in ((f"{end}_inner", 1.3 * sign, 0.0), (f"{end}_outer", -1.3 * sign, 0.6)):
            hinges = (Hinge("pitch", "y", -1.8, 1.8, pitch, 10.0), Hinge("yaw", "z", -1.4, 1.4, yaw, 10.0))
            parent = builder.link(name, parent, position, hinges, (sign * LINK, 0.0, 0.0), RADIUS)
            position = (sign * LINK, 0.0, 0.0)
            builder.sphere(name, parent, position, RADIUS)
    builder.pairs += [("front_outer", "back_outer"), ("front_outer", "middle_back"), ("back_outer", "middle_front")]
    return builder.finish(mass=5.0, feet=("front_outer", "front_inner", "back_outer", "back_inner"))
