"""The site: ``make docs`` writes it to build/site."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import docstrings  # noqa: E402

import octo  # noqa: E402

project = "octo"
author = copyright = "The octo authors"
version = release = octo.__version__
extensions = ["sphinx.ext.autodoc", "myst_nb"]
exclude_patterns = ["**/.ipynb_checkpoints"]
html_theme = "furo"
html_title = "octo"
html_copy_source = False
html_show_sphinx = False

myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}
python_maximum_signature_line_length = 88

# Notebooks hold no outputs: they run here, again only when a cell changed.
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parents[1] / "build" / "notebooks")
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True

ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], "
    r"~?(?:numpy\.)?dtype\[~?(?:numpy\.)?float64\]\]"
)


def _docstring(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    if what == "data":  # autodoc gives the docstring of its type
        lines[:] = []
        return
    own = value if what in ("class", "function") else None
    lines[:] = docstrings.rendered("\n".join(lines), own)


def _signature(
    app: Any, what: str, name: str, value: Any, options: Any, signature: str | None, returned: Any
) -> tuple[str | None, Any]:
    shown = [text and ARRAY.sub("Array", text) for text in (signature, returned)]
    return shown[0] and shown[0].replace("<factory>", "..."), shown[1]


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-process-signature", _signature)
