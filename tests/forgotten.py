"""As in a new process: for tests that change what texts are made of."""

from __future__ import annotations

from collections import OrderedDict

import pytest

from octo.dynamics import content
from octo.problem import structure


def forgotten(patch: pytest.MonkeyPatch) -> None:
    """Nothing that was generated is known, and nothing that is from here on is kept."""
    patch.setattr(content, "_texts", OrderedDict())
    patch.setattr(structure, "_programs", OrderedDict())
