"""What a soft body is: as plain numbers, and as a table to read."""

from __future__ import annotations

from typing import Any

from octo.soft.body import Body

UNITS = {"length": "m", "mass": "kg", "frequency": "Hz", "young": "Pa", "density": "kg/m³"}


def described(body: Body) -> dict[str, Any]:
    """Its sizes, material and modes, as lists and plain numbers.

    ``coordinates`` are its modes and the 6 of where it is; ``frequencies`` in Hz and
    ``damping_ratios`` of each mode; ``sag`` (m) under its own weight; ``cautions`` a sentence
    each; ``units``.
    """
    return {
        "name": body.name,
        "kind": "soft body",
        "coordinates": 6 + body.modes.shape[1],
        "modes": body.modes.shape[1],
        "mass": body.mass,
        "size": body.size.tolist(),
        "elements": body.elements,
        "nodes": body.nodes,
        "points": len(body.points),
        "faces": len(body.faces),
        "young": body.young,
        "poisson": body.poisson,
        "density": body.density,
        "elasticity": "linear" if body.stvk is None else "stvk",
        "damping": list(body.damping),
        "frequencies": body.frequencies.tolist(),
        "damping_ratios": body.damping_ratios.tolist(),
        "sag": body.sag,
        "cautions": list(body.cautions),
        "units": UNITS,
    }


def table(body: Body) -> str:
    """A line for each, then one for each mode."""
    alpha, beta = body.damping
    law = "linear" if body.stvk is None else "St. Venant–Kirchhoff"
    size = " × ".join(f"{span:.4g}" for span in body.size)
    lines = [
        f"name      {body.name}, a soft body",
        f"nx        {6 + body.modes.shape[1]}: {body.modes.shape[1]} modes, and 6 of where it is",
        f"mass      {body.mass:.6g} kg",
        f"size      {size} m",
        f"elements  {body.elements} quadratic tetrahedra, {body.nodes} nodes",
        f"surface   {len(body.points)} points, {len(body.faces)} triangles",
        f"material  young {body.young:g} Pa, poisson {body.poisson:g}, density {body.density:g} "
        f"kg/m³, {law}",
        f"damping   {alpha:g} 1/s of the mass, {beta:g} s of the stiffness",
        f"sag       {1e3 * body.sag:.3g} mm, about, under its own weight",
        "",
        "mode      Hz  of the critical damping",
    ]
    for k, (hertz, ratio) in enumerate(zip(body.frequencies, body.damping_ratios, strict=True), 1):
        lines.append(f"{k:4d}{hertz:8.4g}  {100.0 * ratio:.3g} %")
    return "\n".join(lines)
