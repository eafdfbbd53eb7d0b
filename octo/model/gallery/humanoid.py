"""A person: 35 degrees of freedom."""

from __future__ import annotations

from octo.model.character import Character
from octo.model.gallery.parts import SIDES, Builder, Hinge


def humanoid() -> Character:
    """Legs of 6, arms of 6, waist of 3 and neck of 2 degrees of freedom on a floating pelvis: 60
    kg, 1.6 m."""
    builder = Builder("humanoid")
    pelvis = builder.base("pelvis", (0.0, -0.07, 0.0), (0.0, 0.07, 0.0), 0.09)
    waist = (
        Hinge("yaw", "z", -0.9, 0.9, 0.0, 150.0),
        Hinge("roll", "x", -0.6, 0.6, 0.0, 150.0),
        Hinge("pitch", "y", -0.5, 1.1, 0.05, 150.0),
    )
    belly = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.10), 0.10)
    left, right = ((0.0, y, 0.26) for y in (0.08, -0.08))
    chest = builder.link("chest", pelvis, (0.0, 0.0, 0.10), waist, left, 0.11, belly, start=right)
    neck = (Hinge("yaw", "z", -1.2, 1.2, 0.0, 15.0), Hinge("pitch", "y", -0.7, 0.7, 0.0, 15.0))
    head = builder.link(
        "head", chest, (0.0, 0.0, 0.38), neck, (0.01, 0.0, 0.16), 0.085, start=(0.0, 0.0, 0.10)
    )
    for side, s in SIDES:
        _leg(builder, pelvis, side, s)
        _arm(builder, chest, side, s)
        builder.sphere(f"{side}_pelvis", pelvis, (0.0, 0.07 * s, 0.0), 0.09)
        builder.sphere(f"{side}_chest", chest, (0.0, 0.08 * s, 0.26), 0.11)
    builder.sphere("head", head, (0.01, 0.0, 0.16), 0.085)
    inner = [f"foot_{end}_inner" for end in ("heel", "toe")]
    builder.pairs += [(f"left_{part}", f"right_{part}") for part in (*inner, "knee", "hand")]
    near = (("hand", "pelvis"), ("elbow", "chest"))
    builder.pairs += [(f"{side}_{part}", f"{side}_{to}") for side, _ in SIDES for part, to in near]
    corners = [f"{end}_{edge}" for end in ("heel", "toe") for edge in ("inner", "outer")]
    feet = [f"{side}_foot_{corner}" for side, _ in SIDES for corner in corners]
    return builder.finish(mass=60.0, feet=feet)


def _leg(builder: Builder, pelvis: int, side: str, s: float) -> None:
    """Hip yaw, abduction, pitch; knee; ankle pitch, roll."""
    hip = (
        Hinge("yaw", "z", -0.7, 0.7, 0.0, 100.0),
        Hinge("abduction", "x", -0.4, 0.8, 0.03, 150.0),
        Hinge("pitch", "y", -2.0, 0.7, -0.4, 200.0),
    )
    turns, down = [h.mirrored(s) for h in hip], (0.0, 0.0, -0.38)
    thigh = builder.link(f"{side}_thigh", pelvis, (0.0, 0.09 * s, -0.04), turns, down, 0.065)
    knee = Hinge("knee", "y", 0.05, 2.4, 0.8, 200.0)
    shank = builder.link(f"{side}_shank", thigh, down, [knee], down, 0.045)
    ankle = (
        Hinge("pitch", "y", -1.1, 0.6, -0.4, 100.0),
        Hinge("roll", "x", -0.4, 0.4, -0.03, 60.0),
    )
    sole = [(name, x, y * s) for name, x in (("heel", -0.06), ("toe", 0.14)) for y in (-0.03, 0.03)]
    edges = [((-0.06, y, -0.05), (0.14, y, -0.05), 0.025) for y in (-0.03, 0.03)]
    turns, (start, end, radius) = [h.mirrored(s) for h in ankle], edges[0]
    foot = builder.link(f"{side}_foot", shank, down, turns, end, radius, edges[1], start=start)
    for name, x, y in sole:
        edge = "outer" if y * s > 0 else "inner"
        builder.sphere(f"{side}_foot_{name}_{edge}", foot, (x, y, -0.05), 0.025)
    builder.sphere(f"{side}_knee", shank, (0.0, 0.0, 0.0), 0.055)


def _arm(builder: Builder, chest: int, side: str, s: float) -> None:
    """Shoulder pitch, abduction, twist; elbow; wrist pitch, roll."""
    shoulder = (
        Hinge("pitch", "y", -2.6, 1.0, 0.1, 60.0),
        Hinge("abduction", "x", -0.2, 2.2, 0.2, 60.0),
        Hinge("twist", "z", -1.2, 1.2, 0.0, 40.0),
    )
    turns, place = [h.mirrored(s) for h in shoulder], (0.0, 0.20 * s, 0.28)
    upper = builder.link(f"{side}_upper_arm", chest, place, turns, (0.0, 0.0, -0.26), 0.04)
    elbow, place, end = (
        Hinge("elbow", "y", -2.3, -0.05, -0.6, 40.0),
        (0.0, 0.0, -0.26),
        (0.0, 0.0, -0.23),
    )
    forearm = builder.link(f"{side}_forearm", upper, place, [elbow], end, 0.032)
    wrist = (Hinge("pitch", "y", -0.9, 0.9, 0.0, 10.0), Hinge("roll", "x", -0.6, 0.6, 0.0, 10.0))
    turns = [h.mirrored(s) for h in wrist]
    hand = builder.link(f"{side}_hand", forearm, end, turns, (0.0, 0.0, -0.08), 0.03)
    builder.sphere(f"{side}_elbow", forearm, (0.0, 0.0, 0.0), 0.04)
    builder.sphere(f"{side}_hand", hand, (0.0, 0.0, -0.08), 0.035)
