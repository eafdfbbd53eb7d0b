"""``python -m benchmarks.paper``: the page says what the records say, a figure that is done stays,
and the smallest one is right."""

from __future__ import annotations

import json
import math
import re
import types
from pathlib import Path
from typing import Any

import pytest

from benchmarks.paper import page, records, run
from benchmarks.paper.run import DOCS, FIGURES, PAGE, RESULTS, main, tables

TEXT = PAGE.read_text(encoding="utf-8")
DONE = records.read(RESULTS / "paper.json")


def test_the_page_says_what_the_records_say() -> None:
    assert page.written(TEXT, tables(DONE)) == TEXT


def test_every_figure_is_measured_drawn_and_on_the_page() -> None:
    marked = {found["name"] for found in page.MARKED.finditer(TEXT)}
    assert marked == {*FIGURES}
    assert set(FIGURES) == set(DONE)
    assert not [name for name, own in DONE.items() if own["short"]]
    for name, figure in FIGURES.items():
        drawn = f"paper_{name}.png"
        assert (DOCS / drawn).exists() == bool(figure.PANELS) == (f"]({drawn})" in TEXT), name


def test_the_records_say_when_and_on_what() -> None:
    for own in DONE.values():
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", own["date"])
        assert own["processor"] and own["cores"] >= 1 and own["octo"] and own["commit"]
        assert own["processor_seconds"] > 0.0


@pytest.mark.parametrize("name", DONE)
def test_a_changed_record_changes_the_page(name: str) -> None:
    """No number of a table is anything but the record's."""
    changed = {name: {**DONE[name], "records": _doubled(DONE[name]["records"])}}
    assert page.written(TEXT, tables(changed)) != TEXT


def _doubled(value: Any) -> Any:
    """The same with all numbers twice as large."""
    if isinstance(value, dict):
        return {key: _doubled(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_doubled(own) for own in value]
    return 2.0 * value if isinstance(value, float) else value


def test_a_block_on_a_slope_is_where_a_pencil_says(tmp_path: Path) -> None:
    """The friction of both laws, and the depth."""
    pytest.importorskip("matplotlib")
    assert main(["--short", "--only", "sec81", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "paper.json").read_text())
    found, tan = content["figures"]["sec81"]["records"], math.tan(0.25)
    for one in found["creep"]:
        assert one["speed"] == pytest.approx(tan / one["ratio"], rel=1e-4)
    for one in found["depth"]:
        assert one["depth"] == pytest.approx(math.sqrt(2.0 * 9.81 / (4.0 * one["w"])), rel=1e-6)
    held = found["coulomb"]
    assert held["speed"] == pytest.approx(0.2 * tan / math.sqrt(0.8**2 - tan**2), rel=1e-4)
    assert held["acceleration"] == pytest.approx(held["dry"], rel=0.05)
    assert (tmp_path / "paper_sec81.png").stat().st_size > 10_000
    assert f"{page.number(held['speed'], 3)} m/s" in (tmp_path / "paper.md").read_text()


def test_a_figure_that_is_done_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until it is asked for again, or in full; an interruption loses one figure."""
    calls: list[tuple[str, bool]] = []

    def figure(name: str) -> types.SimpleNamespace:
        def measure(short: bool) -> dict[str, Any]:
            calls.append((name, short))
            if name == "third" and len(calls) == 3:
                raise KeyboardInterrupt
            return {"calls": len(calls)}

        def rows(found: dict[str, Any]) -> list[page.Row]:
            return [page.Row(name, "", str(found["calls"]))]

        return types.SimpleNamespace(TITLE=name, PANELS=0, measure=measure, rows=rows)

    monkeypatch.setattr(
        run, "FIGURES", {name: figure(name) for name in ("first", "other", "third")}
    )
    words = ["--short", "--out", str(tmp_path)]
    with pytest.raises(KeyboardInterrupt):
        main(words)
    assert main(words) == 0
    assert calls == [("first", True), ("other", True), ("third", True), ("third", True)]
    assert main([*words, "--only", "other", "--again"]) == 0
    assert main([*words[1:], "--only", "first"]) == 0
    assert calls[4:] == [("other", True), ("first", False)]
    found = records.read(tmp_path / "paper.json")
    assert [own["records"]["calls"] for own in found.values()] == [6, 5, 4]


def test_again_reaches_the_benchmark_behind_a_figure(tmp_path: Path) -> None:
    """What its own file holds is measured anew when asked to, and never in a short run."""
    told: list[list[str]] = []
    behind = types.SimpleNamespace(RESULTS=tmp_path / "own.json", main=told.append)
    figure = types.ModuleType("figure")
    vars(figure).update(BENCHMARK=behind, measure=lambda short: {"short": short})
    for short, again in ((True, True), (False, False), (False, True)):
        assert run.measured(figure, short, again)["records"] == {"short": short}
    words = ["--json", str(tmp_path / "own.json")]
    assert told == [words, [*words, "--again"]]


def test_an_unknown_figure_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--only", "fig8,fig99"])
    assert "figure 'fig99' is not known, must be one of sec81, fig7" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "digits", "said"),
    [
        (0.0, 2, "0"),
        (0.25, 2, "0.25"),
        (0.00170, 3, "0.00170"),
        (3.0, 2, "3.0"),
        (99.7, 2, "100"),
        (12345.0, 2, "12,000"),
        (2e-5, 2, "2.0e-05"),
        (123.4, 3, "123"),
    ],
)
def test_numbers_have_the_digits_that_count(value: float, digits: int, said: str) -> None:
    assert page.number(value, digits) == said


def test_rows_escape_what_ends_a_cell() -> None:
    assert str(page.Row("a|b", "p", "o")) == "| a\\|b | p | o |  |\n"
    filled = page.written("<!-- one -->\n<!-- end -->\n<!-- two -->\n<!-- end -->\n", {"two": "x"})
    assert filled == "<!-- one -->\n<!-- end -->\n<!-- two -->\n\nx\n<!-- end -->\n"
