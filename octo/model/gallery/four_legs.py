"""Characters on four legs of three degrees of freedom: a mammal and a spider."""

from __future__ import annotations

import math

from octo.model.character import Character
from octo.model.gallery.parts import SIDES, Builder, Hinge


def mammal() -> Character:
    """Legs of hip abduction, hip pitch and knee under the trunk: 18 degrees of freedom, 5 kg, legs
    of 0.3 m."""
    builder = Builder("mammal")
    spine = ((-0.17, 0.0, 0.0), (0.17, 0.0, 0.0), 0.05)
    trunk = builder.base(
        "trunk", *spine, *(((x, -0.06, 0.0), (x, 0.06, 0.0), 0.035) for x in (-0.17, 0.17))
    )
    hip = (
        Hinge("abduction", "x", -0.6, 0.8, 0.05, 12.0),
        Hinge("pitch", "y", -0.9, 2.1, 0.7, 12.0),
    )
    knee = Hinge("knee", "y", -2.5, -0.2, -1.4, 12.0)
    for end, x in (("front", 0.17), ("hind", -0.17)):
        for side, s in SIDES:
            leg = f"{end}_{side}"
            hinges = [h.mirrored(s) for h in hip]
            thigh = builder.link(
                f"{leg}_thigh", trunk, (x, 0.09 * s, 0.0), hinges, (0.0, 0.0, -0.15), 0.022
            )
            shank = builder.link(
                f"{leg}_shank", thigh, (0.0, 0.0, -0.15), [knee], (0.0, 0.0, -0.15), 0.016
            )
            builder.sphere(leg, shank, (0.0, 0.0, -0.15), 0.02)
            builder.sphere(f"{leg}_knee", shank, (0.0, 0.0, 0.0), 0.022)
            builder.sphere(f"{leg}_shoulder", trunk, (x, 0.06 * s, 0.0), 0.04)
    feet = ("front_left", "front_right", "hind_left", "hind_right")
    builder.pairs += [
        (feet[0], feet[1]),
        (feet[2], feet[3]),
        (feet[0], feet[2]),
        (feet[1], feet[3]),
    ]
    builder.pairs += [(f"{end}_left_knee", f"{end}_right_knee") for end in ("front", "hind")]
    return builder.finish(mass=5.0, feet=feet)


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
            thigh = builder.link(
                f"{leg}_thigh",
                trunk,
                (0.09 * x, 0.06 * s, 0.0),
                hinges,
                (0.17, 0.0, 0.0),
                0.022,
                turn=turn,
            )
            shank = builder.link(
                f"{leg}_shank", thigh, (0.17, 0.0, 0.0), [knee], (0.22, 0.0, 0.0), 0.016
            )
            builder.sphere(leg, shank, (0.22, 0.0, 0.0), 0.02)
            builder.sphere(f"{leg}_knee", shank, (0.0, 0.0, 0.0), 0.022)
        builder.sphere(f"trunk_{end}", trunk, (0.06 * x, 0.0, 0.0), 0.07)
    feet = ("front_left", "front_right", "hind_left", "hind_right")
    builder.pairs += [
        (feet[0], feet[1]),
        (feet[2], feet[3]),
        (feet[0], feet[2]),
        (feet[1], feet[3]),
    ]
    return builder.finish(mass=5.0, feet=feet)
