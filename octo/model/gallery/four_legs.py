"""Characters on four legs of three degrees of freedom: a mammal and a spider."""

from __future__ import annotations

import math

from octo.model.character import Character
from octo.model.gallery.parts import SIDES, Builder, Hinge

FEET = ("front_left", "front_right", "hind_left", "hind_right")
NEIGHBOURS = [(FEET[a], FEET[b]) for a, b in ((0, 1), (2, 3), (0, 2), (1, 3))]


def mammal() -> Character:
    """Legs of hip abduction, hip pitch and knee under the trunk: 18 degrees of freedom, 5 kg, legs
    of 0.3 m."""
    builder = Builder("mammal")
    spine = ((-0.17, 0.0, 0.0), (0.17, 0.0, 0.0), 0.05)
    shoulders = [((x, -0.06, 0.0), (x, 0.06, 0.0), 0.035) for x in (-0.17, 0.17)]
    trunk = builder.base("trunk", *spine, *shoulders)
    abduction = Hinge("abduction", "x", -0.6, 0.8, 0.05, 12.0)
    hip = (abduction, Hinge("pitch", "y", -0.9, 2.1, 0.7, 12.0))
    knee, down = Hinge("knee", "y", -2.5, -0.2, -1.4, 12.0), (0.0, 0.0, -0.15)
    for end, x in (("front", 0.17), ("hind", -0.17)):
        for side, s in SIDES:
            leg = f"{end}_{side}"
            hinges, place = [h.mirrored(s) for h in hip], (x, 0.09 * s, 0.0)
            thigh = builder.link(f"{leg}_thigh", trunk, place, hinges, down, 0.022)
            shank = builder.link(f"{leg}_shank", thigh, down, [knee], down, 0.016)
            builder.sphere(leg, shank, down, 0.02)
            builder.sphere(f"{leg}_knee", shank, (0.0, 0.0, 0.0), 0.022)
            builder.sphere(f"{leg}_shoulder", trunk, (x, 0.06 * s, 0.0), 0.04)
    builder.pairs += NEIGHBOURS
    builder.pairs += [(f"{end}_left_knee", f"{end}_right_knee") for end in ("front", "hind")]
    return builder.finish(mass=5.0, feet=FEET)


def spider() -> Character:
    """Sprawled legs of hip yaw, hip pitch and knee at the corners: 18 degrees of freedom, 5 kg."""
    builder = Builder("spider")
    trunk = builder.base("trunk", (-0.06, 0.0, 0.0), (0.06, 0.0, 0.0), 0.07)
    hip = (Hinge("yaw", "z", -0.8, 0.8, 0.0, 12.0), Hinge("pitch", "y", -1.4, 0.8, -0.35, 12.0))
    knee = Hinge("knee", "y", 0.3, 2.5, 1.5, 12.0)
    for end, x in (("front", 1.0), ("hind", -1.0)):
        for side, s in SIDES:
            leg = f"{end}_{side}"
            hinges, turn = [h.mirrored(s) for h in hip], math.atan2(s, x)
            hang = (trunk, (0.09 * x, 0.06 * s, 0.0), hinges)
            thigh = builder.link(f"{leg}_thigh", *hang, (0.17, 0.0, 0.0), 0.022, turn=turn)
            foot = (0.22, 0.0, 0.0)
            shank = builder.link(f"{leg}_shank", thigh, (0.17, 0.0, 0.0), [knee], foot, 0.016)
            builder.sphere(leg, shank, foot, 0.02)
            builder.sphere(f"{leg}_knee", shank, (0.0, 0.0, 0.0), 0.022)
        builder.sphere(f"trunk_{end}", trunk, (0.06 * x, 0.0, 0.0), 0.07)
    builder.pairs += NEIGHBOURS
    return builder.finish(mass=5.0, feet=FEET)
