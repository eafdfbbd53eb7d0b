"""What a notebook shows of octo's objects: a small table, and a picture under it."""

from __future__ import annotations

import base64
import html as markup
import io

import numpy as np

from octo.errors import OctoError
from octo.model.character import Character
from octo.model.scene import Scene
from octo.mpc.log import Log
from octo.picture import filmstrip
from octo.problem.problem import Problem
from octo.result.solution import Solution, recorded

DPI, TALLEST = 60, 240  # of a picture: dots an inch, and dots
MOST = 12  # names that a row lists
Row = tuple[str, str]
Known = Character | Problem | Solution | Log


def html(value: Known | Scene) -> str:
    """A table and a picture as HTML; the table alone without the extra 'view', or where there is
    nothing to draw."""
    value = value.character if isinstance(value, Scene) else value
    title, rows = _facts(value)
    head = f"<caption style='text-align:left'><b>{markup.escape(title)}</b></caption>"
    cells = "".join(
        f"<tr><th style='text-align:left'>{markup.escape(name)}</th><td "
        f"style='text-align:left'>{markup.escape(text)}</td></tr>"
        for name, text in rows
    )
    return f"<table>{head}{cells}</table>{_picture(value)}"


def _facts(value: Known) -> tuple[str, list[Row]]:
    """A title, and what the rows of the table say."""
    if isinstance(value, Solution):
        return _of_solution(value)
    if isinstance(value, Character):
        rows = [
            ("base", value.base),
            ("coordinates", f"{value.nx}, of which {value.nu} are actuated"),
            ("bodies", str(len(value.bodies))),
            ("mass", f"{value.mass:.4g} kg"),
            ("contacts", _few([contact.name for contact in value.contacts])),
            ("poses", _few(list(value.poses))),
        ]
        missing = [("not modelled", _few(list(value.dropped)))] if value.dropped else []
        return value.name, rows + missing
    title, *lines = repr(value).splitlines()
    return title, [("", line.strip()) for line in lines]


def _of_solution(solution: Solution) -> tuple[str, list[Row]]:
    relative = solution.violation / solution.weight
    rows = [
        ("status", solution.sentence),
        ("iterations", f"{solution.iterations} in {solution.seconds:.2f} s on {solution.device}"),
        ("E", f"{solution.energy:.5g}"),
        ("‖C‖∞", f"{solution.violation:.1e} N, {relative:.1e} of the weight"),
    ]
    if solution.extent is not None:
        travel = ", ".join(f"{metres:.2f}" for metres in solution.com[-1] - solution.com[0])
        how = f"{1e3 * solution.penetration:.1f} mm, slip {solution.slip:.3f} m/s"
        rows.append(("centre of mass travels", f"({travel}) m"))
        if solution.soft is None:
            rows += [
                ("feet", f"sink {how}"),
                ("largest |u|/limit", f"{solution.torque_excess:.2f}"),
            ]
        else:
            rows += [("surface", f"sinks {how}"), ("bends by", f"{solution.bends:.3g} m at most")]
    if solution.gait is not None:
        rows.append(("gait", str(solution.gait)))
    return f"{solution.name}, {solution.sampling} ({solution.basis})", rows


def _few(names: list[str]) -> str:
    more = f", … ({len(names)})" if len(names) > MOST else ""
    return ", ".join(names[:MOST]) + more if names else "none"


def _picture(value: Known) -> str:
    """An <img> element, or nothing."""
    try:
        if isinstance(value, (Character, Problem)):
            still = _still(value)
            figure = None if still is None else filmstrip(still, moments=1)
        else:
            known = getattr(value, "extent", None)
            nothing = value.count < 2 if isinstance(value, Log) else known is None
            figure = None if nothing else filmstrip(value)
    # no matplotlib, or a motion that is not finite: the table says what there is
    except (OctoError, ValueError):
        return ""
    if figure is None:
        return ""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=min(DPI, TALLEST / figure.get_figheight()))
    data = base64.b64encode(drawn.getvalue()).decode()
    return f"<img alt='a picture of it' style='max-width:100%' src='data:image/png;base64,{data}'>"


def _still(value: Character | Problem) -> Solution | None:
    """The robot in its default pose, or at the problem's start if that is known already."""
    robot = value if isinstance(value, Character) else value.character
    if robot is None:
        return None
    pose = robot.start_pose
    if isinstance(value, Problem):
        pose = value.__dict__.get("start", pose if value.x0 is None else value.x0)
    x, u = np.stack([pose, pose]), np.zeros((0, robot.nu))
    force = np.zeros((0, len(robot.terrain_contacts), 3))
    return recorded(character=robot, dt=1.0, x=x, u=u, weight=1.0, length=1.0, contact_force=force)
