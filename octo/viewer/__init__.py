"""Moving pictures: one HTML file that any browser shows, also offline. A motion has a time line;
the character of a motion graph is steered."""

from __future__ import annotations

import contextlib
import html
import importlib
import io
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import ANIMATED, ending, flag, number
from octo.errors import MissingExtraError, OutputError, ProblemError, ShapeError
from octo.files import replacing
from octo.model.quantities import Array
from octo.motion_graph.graph import MotionGraph
from octo.result.even import even
from octo.result.solution import Solution
from octo.saved import Motion, motion_of
from octo.viewer.page import wrap
from octo.viewer.scene import Actor, Cycle, build, camera_path, frame_times
from octo.viewer.steer import steering

HEIGHT = 640  # pixels, of the frame in a notebook
PAGES = (".html", ".htm")  # endings


class Page:
    """A moving picture, as one page of HTML that needs no network.

    A notebook shows it; :meth:`save` writes it.
    """

    def __init__(self, text: str, path: Path | None = None):
        self.text = text
        self.path = path  # where it was written

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file beside, then rename it.

        Raises
        ------
        OutputError: it cannot be written, or its ending is not that of a page.
        """
        self.path = ending("path", path, PAGES)
        with replacing(self.path) as beside:
            beside.write_text(self.text, encoding="utf-8")

    def __repr__(self) -> str:
        where = "not written yet: .save(path)" if self.path is None else str(self.path)
        return f"a moving picture of {len(self.text) / 1e6:.1f} MB, {where}"

    def _repr_html_(self) -> str:
        """A frame: the page's script and style see nothing of the notebook."""
        document = html.escape(self.text, quote=True)
        return (
            f'<iframe srcdoc="{document}" width="100%" height="{HEIGHT}" frameborder="0"></iframe>'
        )


def view(
    solution: Motion | Sequence[Motion] | MotionGraph,
    path: str | os.PathLike[str] | None = None,
    *,
    follow: bool = True,
    forces: bool = True,
    apart: float | None = None,
    labels: Sequence[str] | None = None,
    loop: bool | None = None,
    visuals: bool = True,
) -> Page:
    """Draw the motion as one self-contained HTML page (about 1 MB) that plays without a network.

    A notebook shows what is returned where it is the last value of a cell. Under the scene are the
    loaded feet and the joint torques over time; the page steps single frames and plays at 0.05 to 2
    times real time. With the page of a motion graph its character is steered: arrow keys and
    buttons choose the motion, which begins at the next transition.

    Parameters
    ----------
    solution: one, or several that are shown side by side in one scene (a plan and what a plant
        made of it); also a Log, or the path of what octo wrote; or a MotionGraph, of which path,
        forces and visuals can be given.
    path: the file, written beside and then renamed; by default none is.
    follow: the camera travels with the (first) character; a mouse still turns it.
    forces: draw the contact forces as arrows; the weight is as long as 0.8 of the character. Of a
        graph key F shows them.
    apart: m, between neighbours of several; by default 1.5 times the larger one. 0 shows them in
        the same place.
    labels: one for each solution; by default the names of the robots.
    loop: play without a pause at the end, each lap from where the last one ended; by default for a
        cycle (``solution.cycle``).
    visuals: robots look as their files say; False: as the shapes that octo computes with.

    Raises
    ------
    MissingExtraError: viser is not installed. ModelError: user-written dynamics have no bodies.
    ShapeError: no solution, or not a label for each. OutputError: the file cannot be written, or
    its ending is not that of a page: :func:`octo.export` writes a video. ProblemError: no motion
    of the graph can be kept up, or something is given that it cannot have.
    """
    target = None if path is None else _page(path)
    viser = _viser()
    forces, visuals = flag("forces", forces), flag("visuals", visuals)
    if isinstance(solution, MotionGraph):
        _check_left_out(follow=not follow, apart=apart, labels=labels, loop=loop)
        with _server(viser) as server:
            text = steering(server, solution, forces, visuals)
    else:
        solutions = _motions(solution)
        names, follow = _names(solutions, labels), flag("follow", follow)
        loop = solutions[0].cycle is not None if loop is None else flag("loop", loop)
        with _server(viser) as server:
            text = _played(server, solutions, names, follow, forces, apart, loop, visuals)
    page = Page(text)
    if target is not None:
        page.save(target)
    return page


def _played(
    server: Any,
    solutions: Sequence[Solution],
    names: Sequence[str],
    follow: bool,
    forces: bool,
    apart: float | None,
    loop: bool,
    visuals: bool,
) -> str:
    """The text of a page with a time line; ``server``: of viser, whose scene is filled."""
    if loop:  # from half a stride on the other half is its mirror image
        half = [s.cycle is not None and s.cycle.mirrored for s in solutions]
        solutions = [s.tile(1) if h else s for s, h in zip(solutions, half, strict=True)]
    times = frame_times(solutions)
    actors = _side_by_side(solutions, times, apart, visuals)
    nodes, grounds, scale = build(server, actors, forces)
    scene = str(server.get_scene_serializer().as_html())
    cycle = Cycle.of(actors[0]) if loop else None
    shift = camera_path(actors[0], times, follow, scale, cycle)
    lap = cycle.on(grounds) if cycle is not None and follow else None
    return wrap(scene, actors, nodes, grounds, names, times, shift, loop, lap)


def _check_left_out(**given: object) -> None:
    for name, value in given.items():
        if value is not None and value is not False:
            raise ProblemError(f"{name} is given, must be left out of a motion graph's page")


def _page(path: str | os.PathLike[str]) -> Path:
    """The path of a page; OutputError, which says who writes what else moves."""
    kind = os.path.splitext(path)[1].lower() if isinstance(path, (str, os.PathLike)) else ""
    if kind in ANIMATED:
        call = f"octo.export(solution, {os.fspath(path)!r})"
        raise OutputError(f"path ends in {kind}, must end in .html or .htm; {call} writes a {kind}")
    return ending("path", path, PAGES)


def _viser() -> Any:
    try:
        import viser
    except ImportError:
        raise MissingExtraError("a moving picture", "view") from None
    return viser


def _motions(given: Any) -> list[Solution]:
    """What is shown side by side; ShapeError where it is nothing."""
    several = given if isinstance(given, (list, tuple)) else [given]
    motions = [even(motion_of(one)) for one in several]
    if not motions:
        raise ShapeError("solution", (0,), "one Solution or more")
    return motions


def _side_by_side(
    solutions: Sequence[Solution], times: Array, apart: float | None, visuals: bool
) -> list[Actor]:
    """One actor each, ``apart`` m from the next; by default 1.5 times the larger one."""
    if apart is None:
        apart = 1.5 * max((s.extent or 0.0 for s in solutions), default=0.0)
    apart = number("apart", apart)
    offsets = [np.array([0.0, -k * apart, 0.0]) for k in range(len(solutions))]
    return [Actor.of(s, times, o, visuals) for s, o in zip(solutions, offsets, strict=True)]


def _names(solutions: Sequence[Solution], labels: object) -> list[str]:
    """The labels, or the robots' names, numbered where one occurs twice; ShapeError."""
    if labels is None:
        names = [s.name for s in solutions]
        return [n if names.count(n) == 1 else f"{n} {k + 1}" for k, n in enumerate(names)]
    wanted = f"one for each solution: ({len(solutions)},)"
    if not isinstance(labels, (list, tuple)):
        raise ShapeError("labels", (), wanted)
    if len(labels) != len(solutions):
        raise ShapeError("labels", (len(labels),), wanted)
    return [str(label) for label in labels]


@contextlib.contextmanager
def _server(viser: Any) -> Iterator[Any]:
    """A viser server on a free local port: it is what collects a scene; nobody connects to it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with _quiet():
        try:
            server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        except ImportError as error:  # viser imports some of what it needs only now
            raise MissingExtraError(f"a moving picture ({error})", "view") from error
    try:
        yield server
    finally:
        with _quiet():
            server.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without viser's banner, which in a notebook would be an output of its own."""
    console = importlib.import_module("rich").get_console()
    before, console.quiet = console.quiet, True
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        console.quiet = before
