"""A robot file as elements that know their line; what is wrong with it is one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from octo.errors import RobotFileError

DEEPEST = 200  # elements in one another: what walks through a tree calls itself for each
# the same of an MJCF, in which bodies are in one another: MuJoCo's limit is near, and its time
# grows
DEEPEST_BODIES = 1000


class Element(ElementTree.Element):
    """An element, and the line of the file on which it begins."""

    line = 0


def line_of(element: ElementTree.Element) -> int:
    """Counted from 1; 0 of an element that no file has."""
    return int(getattr(element, "line", 0))


class _Enough(Exception):
    """The top element is all that is wanted."""


def read(path: Path) -> ElementTree.Element:
    """The top element of a file, with all that is in it.

    Raises
    ------
    RobotFileError: the text is no XML, in an encoding that cannot be read, or nested too deep.
    """
    return _read(path, DEEPEST)


def check(path: Path) -> None:
    """Refuse an MJCF as :func:`read` refuses a file."""
    _read(path, DEEPEST_BODIES)


def top_of(path: Path) -> str:
    """The name of the top element; nothing behind it is read."""
    return str(_read(path, 0).tag)


def _read(path: Path, deepest: int) -> ElementTree.Element:
    tree = ElementTree.TreeBuilder(element_factory=Element)
    parser = expat.ParserCreate(namespace_separator="}")
    opened: list[Any] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        made = tree.start(_named(tag), {_named(key): value for key, value in attributes.items()})
        made.line = parser.CurrentLineNumber  # type: ignore[attr-defined]
        opened.append(made)
        if not deepest:
            raise _Enough
        if len(opened) > deepest:
            raise RobotFileError(
                f"{path.name}: elements are nested deeper than {deepest} (line "
                f"{parser.CurrentLineNumber})"
            )

    def end(tag: str) -> None:
        tree.end(_named(tag))
        opened.pop()

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = tree.data
    try:
        with path.open("rb") as stream:
            parser.ParseFile(stream)
        return tree.close()
    except _Enough:
        return Element(opened[0].tag)
    except expat.ExpatError as error:
        hint = "; macros of xacro must be expanded" if "unbound prefix" in str(error) else ""
        raise RobotFileError(f"{path.name}: not well-formed XML: {error}{hint}") from None
    except (ValueError, LookupError) as error:  # of Python's codecs
        raise RobotFileError(
            f"{path.name}: its encoding cannot be read, must be UTF-8: {error}"
        ) from None
    except OSError as error:
        raise RobotFileError(f"{path.name}: cannot be read: {error.strerror}") from None


def text_of(tree: ElementTree.Element) -> str:
    """The text of a tree in which every element is on the line that it has in its file, for what
    else will name lines."""
    line = 1

    def blank(element: ElementTree.Element) -> str:
        nonlocal line
        missing = max(0, line_of(element) - line)
        line += missing
        return "\n" * missing

    def place(element: ElementTree.Element) -> None:
        last = None
        for child in element:
            if last is None:
                element.text = blank(child)
            else:
                last.tail = blank(child)
            place(child)
            last = child

    before = blank(tree)
    place(tree)
    return before + ElementTree.tostring(tree, encoding="unicode")


def _named(tag: str) -> str:
    """With ElementTree's mark of a namespace."""
    return f"{{{tag}" if "}" in tag else tag
