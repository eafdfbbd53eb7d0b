"""What a notebook shows, in a kernel that a notebook would start: tables, pictures, pages,
completion, and no noise."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("ipykernel")
nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
run_sync = pytest.importorskip("jupyter_core.utils").run_sync

ROOT = Path(__file__).parents[2]
CELLS = {
    "solve": "import octo\nrobot = octo.gallery.chain()\n"
    "problem = octo.Problem(robot, steps=6, dt=0.02, costs=[octo.Effort()])\n"
    "solution = octo.solve(problem, passes=1, max_iterations=3)",
    "robot": "robot",
    "problem": "problem",
    "solution": "solution",
    "view": "octo.view(solution)",
    "plot": "octo.plot(solution)",
    "filmstrip": "octo.filmstrip(solution, moments=2)",
    "summary": "robot.summary()",
    "wrong": "octo.solve(problem, pases=2)",
}


COMPLETED = {
    "octo.solve(problem, max_it": "max_iterations=",
    "octo.walk(robot, perio": "period=",
    "octo.Problem(robot, ste": "steps=",
}


async def completed(client: Any, text: str) -> list[str]:
    reply = await client.kc.complete(text, reply=True, timeout=60)
    return list(reply["content"]["matches"])


@pytest.fixture(scope="module")
def outputs() -> Iterator[dict[str, Any]]:
    """What each cell put out, by its name here, and what the tab key finds behind the texts of
    COMPLETED."""
    book = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(text) for text in CELLS.values()]
    )
    client = nbclient.NotebookClient(book, timeout=120, allow_errors=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)
        with client.setup_kernel():
            for k, cell in enumerate(book.cells):
                client.execute_cell(cell, k)
            found = {text: run_sync(completed)(client, text) for text in COMPLETED}
    yield {**{name: cell.outputs for name, cell in zip(CELLS, book.cells, strict=True)}, **found}


def shown(outputs: dict[str, Any], name: str) -> dict[str, str]:
    """The one output of a cell by its kinds: no banner, no log and no warning beside it."""
    (output,) = outputs[name]
    assert output.output_type == "execute_result", output
    return dict(output.data)


def test_solving_says_nothing_by_itself(outputs: dict[str, Any]) -> None:
    assert outputs["solve"] == []


@pytest.mark.parametrize("name", ["robot", "problem", "solution"])
def test_a_table_with_a_picture(outputs: dict[str, Any], name: str) -> None:
    data = shown(outputs, name)
    page, words = data["text/html"], data["text/plain"]
    assert page.startswith("<table>") and page.count("<tr>") >= 2 and "chain" in page
    picture = base64.b64decode(page.partition("src='data:image/png;base64,")[2].partition("'")[0])
    assert picture.startswith(b"\x89PNG") and len(page) < 200_000
    assert len(words.splitlines()) <= 5


def test_view_is_a_frame_and_no_banner(outputs: dict[str, Any]) -> None:
    data = shown(outputs, "view")
    assert data["text/html"].startswith("<iframe srcdoc=") and data["text/html"].endswith(
        "</iframe>"
    )
    assert "&lt;canvas" in data["text/html"] or "&lt;script" in data["text/html"]
    assert len(data["text/plain"]) < 100


@pytest.mark.parametrize("name", ["plot", "filmstrip"])
def test_figures_are_shown_inline(outputs: dict[str, Any], name: str) -> None:
    assert base64.b64decode(shown(outputs, name)["image/png"]).startswith(b"\x89PNG")


def test_a_wrong_option_says_the_right_one(outputs: dict[str, Any]) -> None:
    (output,) = outputs["wrong"]
    assert output.ename == "UnknownNameError" and "did you mean passes" in output.evalue
    assert "Body(" not in "".join(output.traceback)


def test_the_summary_is_printed_as_a_table(outputs: dict[str, Any]) -> None:
    words = shown(outputs, "summary")["text/plain"]
    assert "\\n" not in words and "N m" in words


@pytest.mark.parametrize("text", COMPLETED)
def test_options_are_completed(outputs: dict[str, Any], text: str) -> None:
    assert COMPLETED[text] in outputs[text]
