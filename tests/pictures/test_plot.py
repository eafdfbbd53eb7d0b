"""Plots of whole and of degenerate solutions."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from pathlib import Path

import motions
import numpy as np
import pytest
from matplotlib.image import imread

import octo
from octo.errors import MissingExtraError
from octo.model.gallery import CHARACTERS
from octo.plot import MOST_ROWS, plot
from octo.result.solution import Solution
from octo.solver.status import Status


def titles(figure: object) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["chain", "mammal", "humanoid"])
def test_all_panels_of_a_character(name: str, tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS[name]())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = plot(solution, tmp_path / "plot.png")
    shown = titles(figure)
    assert [t.split()[0] for t in shown] == ["centre", "its", "normal", "torque", "E", "‖C‖∞"]
    assert imread(tmp_path / "plot.png").shape[0] > 500
    text = [label.get_text() for axes in figure.axes for label in axes.texts]
    assert set(solution.contact_names) <= set(text) or len(solution.contact_names) > MOST_ROWS
    assert {"1", "2"} <= set(text), "the passes are numbered"


def without_history(solution: Solution) -> Solution:
    return dataclasses.replace(solution, history={name: np.zeros(0) for name in solution.history})


def in_the_air(solution: Solution) -> Solution:
    return dataclasses.replace(solution, contact_force=0.0 * solution.contact_force)


DEGENERATE = {
    "custom": (lambda: motions.custom(), ["coordinates", "their", "torque", "E", "‖C‖∞"]),
    "custom without torques": (
        lambda: motions.custom(nx=9, nu=0),
        ["coordinates", "their", "E", "‖C‖∞"],
    ),
    "one step": (
        lambda: motions.wandering(CHARACTERS["mammal"](), steps=1),
        ["centre", "its", "normal", "torque", "E", "‖C‖∞"],
    ),
    "no history": (
        lambda: without_history(motions.wandering(CHARACTERS["chain"]())),
        ["centre", "its", "normal", "torque"],
    ),
    "in the air": (
        lambda: in_the_air(motions.wandering(CHARACTERS["chain"]())),
        ["centre", "its", "torque", "E", "‖C‖∞"],
    ),
    "no limits": (lambda: motions.custom(nu=8), ["coordinates", "their", "torque", "E", "‖C‖∞"]),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_what_is_missing_leaves_its_panel_out(name: str, tmp_path: Path) -> None:
    make, wanted = DEGENERATE[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = plot(make(), tmp_path / "plot.png")
    assert [t.split()[0] for t in titles(figure)] == wanted


def test_a_failure_is_said_in_full() -> None:
    solution = dataclasses.replace(motions.custom(), status=Status.STALLED)
    assert Status.STALLED.value in plot(solution).get_suptitle()


def test_values_that_are_not_finite_do_not_break_it(tmp_path: Path) -> None:
    solution = motions.custom()
    broken = {**solution.history, "energy": np.full(60, np.nan), "violation": np.zeros(60)}
    plot(dataclasses.replace(solution, history=broken), tmp_path / "plot.svg")
    assert (tmp_path / "plot.svg").stat().st_size > 1000


def test_matplotlib_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "octo.figure", raising=False)
    for picture in (octo.plot, octo.filmstrip):
        with pytest.raises(MissingExtraError, match="'view'"):
            picture(motions.wandering(CHARACTERS["chain"]()))
