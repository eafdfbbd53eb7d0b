"""The pages: every public name is in the reference with its parameters, what architecture.md names
is there, links and anchors lead somewhere, the examples of extending.md run."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def _docstrings() -> ModuleType:
    spec = importlib.util.spec_from_file_location("octo_docstrings", DOCS / "docstrings.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


docstrings = _docstrings()
PUBLIC = dict(docstrings.public())
DIRECTIVE = re.compile(r"^\.\. auto(?:class|function|exception|data):: (\S+)$", re.MULTILINE)
LISTED = [
    name
    for page in (DOCS / "reference").glob("*.md")
    for name in DIRECTIVE.findall(page.read_text())
]


# -- the reference ---------------------------------------------------------------------------------


def test_every_public_name_is_in_the_reference_once() -> None:
    assert len(set(LISTED)) == len(LISTED)
    listed = [PUBLIC.get(name) for name in LISTED]
    assert None not in listed, [name for name in LISTED if name not in PUBLIC]
    # a term is octo.X and octo.costs.X: one of the two is listed
    missing = [name for name, value in PUBLIC.items() if not any(value is one for one in listed)]
    assert not missing


@pytest.mark.parametrize("name", [name for name, value in PUBLIC.items() if callable(value)])
def test_a_public_name_says_what_it_is_and_what_each_parameter_means(name: str) -> None:
    value = PUBLIC[name]
    assert value.__doc__ and not value.__doc__.startswith(f"{value.__name__}("), "no docstring"
    assert docstrings.undocumented(value) == []


def test_parameters_are_read_one_a_line() -> None:
    doc = "x: (nx,) rad. speed: m/s; slow\n    as a rule. Note: no parameter.\na, b (N,): both"
    found = docstrings.entries(doc, ["x", "speed", "a", "b"])
    assert found["x"] == "(nx,) rad."
    assert found["speed"] == "m/s; slow as a rule. Note: no parameter."
    assert found["a"] == "both" and found["b"] == "(N,) both"


def test_sections_of_docstrings_are_whole() -> None:
    """A formatter that refills lines puts what follows an underline behind it."""
    broken = re.compile(r"^ +(?:-{4,} \S|={4,} *[^= \n]).*$", re.MULTILINE)
    for path in (ROOT / "octo").rglob("*.py"):
        assert not broken.findall(path.read_text()), path


def test_text_is_text_in_the_reference() -> None:
    lines = docstrings.rendered("|x|² of ``a_`` and b_.\n\nRaises\n------\nOctoError: s. It is.\n")
    assert lines[0] == r"\|x\|² of ``a_`` and b\_."
    assert ":raises OctoError: s. It is." in [line.replace("\\ ", "") for line in lines]


# -- the table of architecture.md ------------------------------------------------------------------

PLACE = re.compile(r"`(octo/[\w/]+\.\w+)`(?:: ((?:`\w+`(?:, )?)+))?")


def named_places() -> list[tuple[str, str, str]]:
    """(row, file, name or "") of everything that the table names."""
    found = []
    for line in (DOCS / "architecture.md").read_text().splitlines():
        if line.startswith("| ") and "octo/" in line:
            row = line.split("|")[1].strip()
            for file, names in PLACE.findall(line):
                found += [(row, file, name) for name in re.findall(r"`(\w+)`", names) or [""]]
    return found


@pytest.mark.parametrize(("row", "file", "name"), named_places())
def test_what_the_table_names_is_there(row: str, file: str, name: str) -> None:
    where = f"docs/architecture.md, row {row!r}: "
    assert (ROOT / file).is_file(), f"{where}no file {file}"
    defined = {
        one.name
        for one in ast.walk(ast.parse((ROOT / file).read_text()))
        if isinstance(one, ast.ClassDef | ast.FunctionDef)
    }
    assert not name or name in defined, f"{where}{file} defines no {name}"


def test_the_table_has_every_equation_of_the_paper() -> None:
    text = (DOCS / "architecture.md").read_text()
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| ")]
    said: set[int] = set()
    for first, last in re.findall(r"Eq\. (\d+)(?:–(\d+))?", " ".join(rows)):
        said |= set(range(int(first), int(last or first) + 1))
    said |= {
        k for row in rows for a, b in re.findall(r"Eq\. (\d+)–(\d+)", row) for k in (int(a), int(b))
    }
    assert said == set(range(1, 19))
    assert {"Algorithm 1", "Algorithm 2"} <= set(re.findall(r"Algorithm \d", " ".join(rows)))


def test_the_floors_are_those_that_are_checked() -> None:
    text = (DOCS / "architecture.md").read_text().partition("```text")[2].partition("```")[0]
    cfg = (ROOT / "setup.cfg").read_text()
    layers = cfg.partition("\nlayers =\n")[2].partition("\n\n")[0]
    floors = set(re.findall(r"\w+", layers)) - {"__main__"}
    missing = floors - set(re.findall(r"\w+", text))
    assert not missing, f"docs/architecture.md, the floors: {missing} of setup.cfg"


# -- links -----------------------------------------------------------------------------------------


def anchor(heading: str) -> str:
    """As a code host and the site make it."""
    plain = re.sub(r"[`*]|\[([^]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_anchors_lead_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text())
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in link:
            continue
        file, _, target = link.partition("#")
        to = (page.parent / file).resolve() if file else page
        assert to.exists(), link
        if target and to.suffix == ".md":
            headings = re.findall(r"^#+ (.+)$", FENCE.sub("", to.read_text()), re.MULTILINE)
            assert target in map(anchor, headings), link


def test_every_page_is_in_the_contents() -> None:
    listed: set[Path] = set()
    for page in DOCS.rglob("*.md"):
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL):
            names = [line for line in block.splitlines() if line and not line.startswith(":")]
            listed |= {(page.parent / name).resolve() for name in names}
    pages = {page.with_suffix("") for page in [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]}
    assert pages - listed == {DOCS / "index"}


# -- what runs -------------------------------------------------------------------------------------

BLOCKS = re.findall(
    r"^## (.+?)$|```python\n(.*?)```", (DOCS / "extending.md").read_text(), re.DOTALL | re.MULTILINE
)


def examples() -> list[Any]:
    title, found = "", []
    for heading, code in BLOCKS:
        title = heading or title
        if code:
            found.append(pytest.param(code, id=title))
    return found


@pytest.mark.parametrize("code", examples())
def test_an_example_of_extending_runs_as_it_stands(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "extending.md", "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_holds_no_outputs(path: Path) -> None:
    cells = json.loads(path.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code and all(not cell["outputs"] and cell["execution_count"] is None for cell in code)


def test_the_paper_is_cited_alike_everywhere() -> None:
    for page in (ROOT / "README.md", DOCS / "index.md", ROOT / "CITATION.cff"):
        text = " ".join(page.read_text().split())
        assert "10.1145/3309486.3340246" in text and "Manocha" in text, page
        assert "GPU-Based Contact-Aware Trajectory Optimization Using A Smooth Force Model" in text
