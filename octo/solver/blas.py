"""One BLAS thread for products of small blocks: its threads wait for one another longer than they work."""

from __future__ import annotations

import contextlib
import functools
import importlib
from typing import Any


@functools.cache
def _controller() -> Any:
    """threadpoolctl's handle on the BLAS that is loaded; None without threadpoolctl."""
    try:
        return importlib.import_module("threadpoolctl").ThreadpoolController()
    except ImportError:
        return None


def one_thread() -> contextlib.AbstractContextManager[Any]:
    """``with one_thread():`` BLAS has one thread inside (25 µs); nothing changes where threadpoolctl is missing."""
    controller = _controller()
    return contextlib.nullcontext() if controller is None else controller.limit(limits=1, user_api="blas")
