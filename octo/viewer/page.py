"""The page around the scene: its title, its legend, its numbers, and the script that plays them."""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.result.solution import Solution
from octo.viewer.ground import Ground
from octo.viewer.scene import (
    ARROW,
    FOOT,
    FORCE,
    LOADED_FOOT,
    Actor,
    Cycle,
    Nodes,
    arrows_of,
    color_of,
)

HOLD = 0.6  # s, that the last frame stays before the motion begins anew
GRAIN = 2.0**-13  # m and parts of a quaternion: poses are rounded to it, which halves the file
MOST_STEPS = 1500  # in the charts; several steps are one bin where a motion has more


class Numbers:
    """Arrays of a page, as one block of float32."""

    def __init__(self) -> None:
        self.parts: list[NDArray[np.float32]] = []
        self.length = 0

    def add(self, values: Any, grain: float | None = None) -> list[int]:
        """Keep ``values``, rounded to ``grain``; where they are: offset and length, in numbers."""
        exact = np.asarray(values, dtype=float).ravel()
        rounded = exact if grain is None else np.round(exact / grain) * grain
        self.parts.append(rounded.astype(np.float32))
        place = [self.length, exact.size]
        self.length += exact.size
        return place

    def text(self) -> str:
        """Base64 of the gzipped block, little-endian."""
        block = np.concatenate(self.parts).astype("<f4").tobytes()
        return base64.b64encode(gzip.compress(block, compresslevel=9, mtime=0)).decode()


def wrap(
    scene: str,
    actors: Sequence[Actor],
    nodes: Sequence[Nodes],
    grounds: Sequence[Ground],
    labels: Sequence[str],
    times: NDArray[np.float64],
    shift: NDArray[np.float64],
    loop: bool,
    cycle: Cycle | None,
) -> str:
    """Put octo's page around viser's: ``scene`` is the HTML of a recording that does not move."""
    numbers = Numbers()
    data = {
        "times": numbers.add(times),
        "shift": numbers.add(shift, GRAIN),
        "hold": HOLD,
        "loop": loop,
        "cycle": cycle and {"yaw": cycle.yaw, "way": cycle.way.tolist()},
        "grounds": [
            {"name": g.name, "position": g.position.tolist(), "wxyz": g.wxyz.tolist()}
            for g in grounds
        ],
        "foot": FOOT,
        "loadedFoot": LOADED_FOOT,
        "characters": [
            _character(actor, names, labels[k], k, numbers)
            for k, (actor, names) in enumerate(zip(actors, nodes, strict=True))
        ],
    }
    data["numbers"] = numbers.text()
    solutions = [actor.solution for actor in actors]
    forces, feet = any(n.arrows for n in nodes), any(n.feet for n in nodes)
    body = _head(solutions, labels, loop, forces, feet) + _panel(float(times[-1]), len(times) - 1)
    title = f"{', '.join(dict.fromkeys(s.name for s in solutions))}: {float(times[-1]):g} s"
    scripts = ("viser.js", "controls.js", "scene.js", "charts.js", "page.js")
    return document(scene, title, body, data, scripts)


def document(
    scene: str, title: str, body: str, data: Any, scripts: Sequence[str], style: str = "page.css"
) -> str:
    """octo's page around viser's: ``data`` is what its scripts, files of this folder, read."""
    script = "".join(_text(name) for name in scripts)
    body += f'<script type="application/json" id="octo-data">{_json(data)}</script>'
    body += f'<script>"use strict";(() => {{{script}}})();</script>'
    scene = scene.replace("<title>Viser</title>", f"<title>{html.escape(title)}</title>", 1)
    # The last of each: viser's own script, earlier in the file, may hold any text.
    before, _, after = scene.rpartition("<body>")
    inside, closing, rest = after.rpartition("</body>")
    look = f"<style>{_text(style)}</style>"
    return "".join((before, '<body class="octo">', look, inside, body, closing, rest))


def _text(name: str) -> str:
    return files("octo.viewer").joinpath(name).read_text(encoding="utf-8")


def _json(data: Any) -> str:
    """JSON that is safe inside a script element."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _character(actor: Actor, names: Nodes, label: str, k: int, numbers: Numbers) -> dict[str, Any]:
    solution, bodies, feet = actor.solution, list(names.bodies), list(names.feet)
    count = -(-solution.steps // MOST_STEPS)  # steps in a bin of the charts
    strips, loaded = _strips(solution)
    torque = np.nan_to_num(solution.u, posinf=0.0, neginf=0.0)
    return {
        "label": label,
        "color": f"rgb{color_of(k)}",
        "end": solution.steps * solution.dt,
        "bodies": list(names.bodies.values()),
        "rotation": numbers.add(actor.rotation[:, bodies], GRAIN),
        "origin": numbers.add(actor.origin[:, bodies], GRAIN),
        "feet": list(names.feet.values()),
        "carries": numbers.add(actor.loaded[:, feet]),
        "arrows": names.arrows,
        "force": numbers.add(arrows_of(actor) if names.arrows else (), GRAIN),
        "chartStep": count * solution.dt,
        "bent": _bent(actor, names, numbers),
        "contacts": strips,
        "contactLoaded": numbers.add(_largest(loaded.astype(float), count)),
        "joints": list(solution.actuated_names) if torque.size else [],
        "units": list(solution.effort_units),
        "limits": [_limit(value) for value in solution.torque_limit],
        "torque": numbers.add(_largest(torque, count), 1e-4),
    }


def _strips(solution: Solution) -> tuple[list[str], NDArray[np.bool_]]:
    """Names and load (N, rows) of the contacts that carry at some time; all of a soft body are
    one."""
    if solution.soft is not None:
        return ["surface"], np.asarray(solution.loaded.any(axis=1, keepdims=True))
    shown = np.flatnonzero(solution.loaded.any(axis=0))
    return [solution.contact_names[c] for c in shown], solution.loaded[:, shown]


def _bent(actor: Actor, names: Nodes, numbers: Numbers) -> dict[str, Any] | None:
    """How the surface of a soft body follows from its modes."""
    soft = actor.solution.soft
    if soft is None or actor.bend is None:
        return None
    return {
        "names": names.bent,
        "points": numbers.add(soft.body.points, GRAIN**2),
        "modes": numbers.add(soft.body.modes.swapaxes(0, 1), GRAIN**2),
        "z": numbers.add(actor.bend, GRAIN * float(np.sqrt(soft.body.mass))),
    }


def _limit(value: float) -> float | None:
    return float(value) if np.isfinite(value) and value > 0.0 else None


def _largest(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The value of largest magnitude of every ``count`` rows."""
    if count <= 1:
        return values
    starts = range(0, len(values), count)
    bins = (values[start : start + count] for start in starts)
    largest = [np.take_along_axis(b, np.abs(b).argmax(axis=0)[None], axis=0)[0] for b in bins]
    return np.stack(largest)


def _head(
    solutions: Sequence[Solution], labels: Sequence[str], loop: bool, forces: bool, feet: bool
) -> str:
    first = solutions[0]
    several = len(solutions) > 1
    names = ", ".join(dict.fromkeys(s.name for s in solutions))
    words = in_words(first, loop)
    lines = [
        f"{label}: {s.status.value}" if several else s.status.value
        for label, s in zip(labels, solutions, strict=True)
    ]
    entries = []
    for k, label in enumerate(labels if several else ()):
        entries.append(f'<li><i style="background:rgb{color_of(k)}"></i>{html.escape(label)}</li>')
    entries += legend(first, forces, feet)
    return head(f"{names}: {words}", lines, entries)


def head(title: str, lines: Sequence[str], entries: Sequence[str]) -> str:
    """Above the scene: what it is, and a legend with such entries."""
    paragraphs = "".join(f"<p>{html.escape(line)}</p>" for line in lines)
    return (
        f'<header class="octo-head"><div><h1>{html.escape(title)}</h1>{paragraphs}</div>'
        f'<ul class="octo-legend" aria-label="legend">{"".join(entries)}</ul></header>'
    )


def legend(solution: Solution, forces: bool, feet: bool) -> list[str]:
    """The entries of feet, and of forces of a motion such as this one."""
    entries = []
    if feet:
        for color, meaning in ((FOOT, "foot"), (LOADED_FOOT, "loaded foot")):
            entries.append(f'<li><i class="foot" style="background:rgb{color}"></i>{meaning}</li>')
    if forces:
        meaning = "contact force"
        if solution.extent is not None and solution.weight > 0.0:
            newtons = 0.1 * solution.weight / (ARROW * solution.extent)  # of 0.1 m
            meaning += f" (0.1 m is {newtons:.2g} N)"
        style = f"background:rgb{FORCE};color:rgb{FORCE}"
        entries.append(f'<li><i class="arrow" style="{style}"></i>{meaning}</li>')
    return entries


def in_words(solution: Solution, loop: bool) -> str:
    """What the motion is: how long, how far, how fast, how much it turns."""
    seconds = solution.steps * solution.dt
    words = [f"one cycle of {seconds:g} s, repeated" if loop else f"{seconds:g} s"]
    room, robot = solution.extent, solution.character
    if room is None or (robot is not None and robot.base == "fixed"):
        return words[0]
    way = solution.com[-1] - solution.com[0]
    travel = float(np.hypot(way[0], way[1]))
    turn = float(np.degrees(solution.yaw[-1] - solution.yaw[0]))
    if travel > 0.25 * room:
        words.append(f"{travel:.2f} m at {travel / seconds:.2f} m/s")
    if abs(turn) > 15.0:
        words.append(f"turns {abs(turn):.0f}° {'left' if turn > 0.0 else 'right'}")
    if abs(way[2]) > 0.1 * room:
        words.append(f"{'rises' if way[2] > 0.0 else 'sinks'} by {abs(way[2]):.2f} m")
    return ", ".join(words) if len(words) > 1 else f"{words[0]}, on the spot"


def _panel(end: float, frames: int) -> str:
    """The controls and the charts, which the script fills."""
    return (
        '<section class="octo-panel" aria-label="time line and charts"><div class="octo-bar">'
        '<div data-octo="buttons"></div>'
        f'<div class="octo-clock"><b data-octo="time">0.000</b>&nbsp;<span>of {end:.3f} s, frame '
        f'<span data-octo="frame">0</span> of {frames}</span></div>'
        '<div data-octo="speeds"></div>'
        '<div class="octo-hint">space: play · ← →: one frame · drag in the chart: seek</div></div>'
        '<svg class="octo-chart" data-octo="chart" role="slider" tabindex="0" aria-label="time" '
        f'aria-valuemin="0" aria-valuemax="{end:.3f}" aria-valuenow="0"></svg>'
        '<div class="octo-tabs" data-octo="tabs" hidden></div>'
        '<div class="octo-joints" data-octo="joints"></div></section>'
        '<p class="octo-notice" data-octo="notice" role="alert"></p>'
    )
