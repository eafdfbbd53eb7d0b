"""Characters on two legs: a biped and a bird."""

from __future__ import annotations

from octo.model.character import Character
from octo.model.gallery.parts import SIDES, Builder, Hinge


def biped() -> Character:
    """A trunk on two legs of hip abduction, hip pitch, knee and ankle: 14 degrees of freedom, 20
    kg, 1.1 m."""
    builder = Builder("biped")
    chest = ((0.0, 0.0, 0.05), (0.0, 0.0, 0.30), 0.09)
    trunk = builder.base("trunk", (0.0, -0.06, 0.0), (0.0, 0.06, 0.0), 0.07, chest)
    abduction = Hinge("abduction", "x", -0.3, 0.7, 0.06, 60.0)
    hip, down = (abduction, Hinge("pitch", "y", -1.6, 0.8, -0.4, 80.0)), (0.0, 0.0, -0.35)
    for side, s in SIDES:
        turns = [h.mirrored(s) for h in hip]
        thigh = builder.link(f"{side}_thigh", trunk, (0.0, 0.1 * s, 0.0), turns, down, 0.05)
        knee = Hinge("knee", "y", 0.05, 2.3, 0.8, 80.0)
        shank = builder.link(f"{side}_shank", thigh, down, [knee], down, 0.04)
        ankle = Hinge("ankle", "y", -1.1, 0.7, -0.4, 40.0)
        heel, toe = (-0.07, 0.0, -0.04), (0.13, 0.0, -0.04)
        foot = builder.link(f"{side}_foot", shank, down, [ankle], toe, 0.025, start=heel)
        builder.sphere(f"{side}_heel", foot, heel, 0.025)
        builder.sphere(f"{side}_toe", foot, toe, 0.025)
        builder.sphere(f"{side}_knee", shank, (0.0, 0.0, 0.0), 0.05)
        builder.sphere(f"{side}_hip", trunk, (0.0, 0.06 * s, 0.0), 0.07)
    builder.sphere("head", trunk, (0.0, 0.0, 0.30), 0.09)
    builder.pairs += [(f"left_{part}", f"right_{part}") for part in ("heel", "toe", "knee")]
    return builder.finish(mass=20.0, feet=("left_heel", "left_toe", "right_heel", "right_toe"))


def bird() -> Character:
    """A horizontal body with neck and tail on two backward-kneed legs with long toes: 18 degrees of
    freedom, 4 kg."""
    builder = Builder("bird")
    body = builder.base("body", (-0.08, 0.0, 0.0), (0.08, 0.0, 0.02), 0.07)
    neck_hinge = Hinge("pitch", "y", -1.0, 1.0, 0.0, 4.0)
    head = ((0.06, 0.0, 0.16), (0.10, 0.0, 0.16), 0.03)
    nape, end = (0.11, 0.0, 0.04), (0.06, 0.0, 0.16)
    neck = builder.link("neck", body, nape, [neck_hinge], end, 0.025, head)
    tail_hinge = Hinge("pitch", "y", -0.8, 0.8, 0.0, 4.0)
    tail = builder.link("tail", body, (-0.12, 0.0, 0.01), [tail_hinge], (-0.16, 0.0, 0.03), 0.02)
    for side, s in SIDES:
        _bird_leg(builder, body, side, s)
    builder.sphere("breast", body, (0.08, 0.0, 0.02), 0.07)
    builder.sphere("rump", body, (-0.08, 0.0, 0.0), 0.07)
    builder.sphere("beak", neck, (0.10, 0.0, 0.16), 0.03)
    builder.sphere("tail", tail, (-0.16, 0.0, 0.03), 0.02)
    parts = ("heel", "toe", "tarsus", "knee")
    builder.pairs += [(f"left_{part}", f"right_{part}") for part in parts]
    return builder.finish(mass=4.0, feet=("left_heel", "left_toe", "right_heel", "right_toe"))


def _bird_leg(builder: Builder, body: int, side: str, s: float) -> None:
    """Femur forward, tibia backward, tarsus forward, toes flat."""
    abduction = Hinge("abduction", "x", -0.4, 0.7, 0.05, 12.0)
    turns = [h.mirrored(s) for h in (abduction, Hinge("pitch", "y", -1.7, 0.5, -0.7, 12.0))]
    ends = [(0.0, 0.0, -length) for length in (0.11, 0.20, 0.18)]
    femur = builder.link(f"{side}_femur", body, (0.0, 0.06 * s, -0.02), turns, ends[0], 0.025)
    knee = Hinge("knee", "y", 0.2, 2.4, 1.35, 12.0)
    tibia = builder.link(f"{side}_tibia", femur, ends[0], [knee], ends[1], 0.018)
    ankle = Hinge("ankle", "y", -2.2, -0.1, -0.95, 12.0)
    tarsus = builder.link(f"{side}_tarsus", tibia, ends[1], [ankle], ends[2], 0.012)
    toes_hinge = Hinge("pitch", "y", -0.8, 1.4, 0.3, 6.0)
    heel, toe = (-0.06, 0.0, 0.0), (0.12, 0.0, 0.0)
    toes = builder.link(f"{side}_toes", tarsus, ends[2], [toes_hinge], toe, 0.012, start=heel)
    builder.sphere(f"{side}_heel", toes, heel, 0.012)
    builder.sphere(f"{side}_toe", toes, toe, 0.012)
    builder.sphere(f"{side}_tarsus", tarsus, (0.0, 0.0, 0.0), 0.018)
    builder.sphere(f"{side}_knee", tibia, (0.0, 0.0, 0.0), 0.025)
