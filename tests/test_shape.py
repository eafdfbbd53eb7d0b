"""The shape of the code: no circle between files, no file over 400 lines, no function over 60."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import octo

ROOT = Path(octo.__file__).parent
LINES, FUNCTION = 400, 60


def files() -> dict[str, Path]:
    """Module names and files of the package, but for the front door, which knows all names."""
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = ("octo", *path.relative_to(ROOT).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    del found["octo"]
    return found


MODULES = files()


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules that a file imports, also in functions and for types alone."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                yield name if name in MODULES else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def test_no_circle_between_files() -> None:
    graph = {
        name: {*imported(ast.parse(path.read_text()))} & MODULES.keys() - {name}
        for name, path in MODULES.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" - ".join(circle.args[1]))


@pytest.mark.parametrize("name", MODULES)
def test_files_and_functions_are_short(name: str) -> None:
    text = MODULES[name].read_text()
    assert text.count("\n") <= LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            assert (node.end_lineno or 0) - node.lineno < FUNCTION, node.name
