"""The one JSON file: of each figure what was measured, when, and on what."""

from __future__ import annotations

import json
import re
import subprocess
import time
from pathlib import Path
from typing import Any

import octo
from octo import native
from octo.bench.timing import processor

ROOT = Path(__file__).parents[2]
NUMBERS = re.compile(r"\[\s+([-+.e\d,\s]+?)\s+\]")  # lists of numbers alone


def commit() -> str:
    """Of the working tree, with a + behind it where files differ; "unknown" outside a clone."""
    words = ["git", "-C", str(ROOT), "describe", "--always", "--abbrev=10", "--dirty=+"]
    try:
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def circumstances() -> dict[str, Any]:
    """The date, and what the numbers depend on."""
    return {
        "date": time.strftime("%Y-%m-%d"),
        "processor": processor(),
        "cores": native.cores(),
        "octo": octo.__version__,
        "commit": commit(),
    }


def read(path: Path) -> dict[str, Any]:
    """The figures of a file, none where there is no file.

    Raises
    ------
    ValueError: the file holds something else.
    """
    if not path.exists():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    return dict(content["figures"])


def write(path: Path, figures: dict[str, Any]) -> None:
    """Beside, then renamed: an interrupted run leaves the file as it was."""
    beside = path.with_suffix(".part")
    text = json.dumps({"figures": figures}, indent=1, allow_nan=False, ensure_ascii=False)
    text = NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text)
    beside.write_text(text + "\n", encoding="utf-8")
    beside.replace(path)
