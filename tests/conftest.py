"""Random KKT systems in lag storage, for the linear solvers of the CPU and of the GPU."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from octo import native
from octo.solver.blocks import KKTBlocks

# With two processes these begin first, so that neither waits long for the other at the end.
LONGEST = (
    "test_sanitizers.py",
    "test_motions.py",
    "test_kick.py",
    "test_world_ground.py",
    "test_identical.py",
    "test_graph.py",
    "test_nvrtc.py",
    "test_step_pairs.py",
    "test_tracebacks.py",
    "test_crowd.py",
    "test_motions_within_limits.py",
    "test_one_file.py",
    "test_docs.py",
    "test_benchmark.py",
)

# Compiled as a user's code is, as is what asks how long something takes: the native code beside
# other code, and solves that take longer than their compiling. All else runs a few steps, and is
# compiled without optimisation, in a quarter of the time.
AS_SHIPPED = (
    "test_graph.py",
    "test_kick.py",
    "test_lanes.py",
    "test_motions.py",
    "test_motions_within_limits.py",
    "test_native.py",
    "test_numbers.py",
    "test_robots.py",
    "test_solve_command.py",
)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        timed = item.get_closest_marker("timed") is not None
        if item.path.name not in AS_SHIPPED and not timed:
            item.fixturenames.insert(0, "plain_compiler")
    if hasattr(config, "workerinput"):  # a process of pytest-xdist
        order = {name: k for k, name in enumerate(LONGEST)}
        items.sort(key=lambda item: order.get(item.path.name, len(order)))


def _random_system(
    seed: int,
    batch: int,
    K: int,
    nc: int,
    ma: int,
    *,
    lowered: float = 0.0,
    rows_touch: tuple[int, ...] = (0, 1, 2),
) -> KKTBlocks:
    """H a sum of squares over three neighbouring units plus I, minus a random diagonal in [0,
    lowered).

    Row block k of A touches units k − o for o in rows_touch.
    """
    random = np.random.default_rng(seed)
    H, A = np.zeros((batch, K, 3, nc, nc)), np.zeros((batch, K, 3, ma, nc))
    diagonal = np.arange(nc)
    for k in range(K):
        reach = min(k, 2) + 1
        jacobian = [random.standard_normal((batch, nc, nc)) / np.sqrt(nc) for _ in range(reach)]
        for o in range(reach):
            for p in range(o, reach):
                H[:, k - o, p - o] += np.swapaxes(jacobian[o], -1, -2) @ jacobian[p]
        for o in rows_touch:
            if o < reach:
                A[:, k, o] = random.standard_normal((batch, ma, nc))
    H[:, :, 0, diagonal, diagonal] += 1.0 - lowered * random.random((batch, K, nc))
    return KKTBlocks(
        H, A, random.standard_normal((batch, K, nc)), random.standard_normal((batch, K, ma))
    )


@pytest.fixture(scope="module")
def plain_compiler() -> Iterator[None]:
    """Without optimisation, see AS_SHIPPED."""
    flags = native.FLAGS
    native.FLAGS = tuple("-O0" if flag == "-O3" else flag for flag in flags)
    yield
    native.FLAGS = flags


@pytest.fixture(scope="session")
def plain_environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Of other processes, which compile without optimisation then."""
    words = native.compiler()
    if words is None:
        return {**os.environ}
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@" -O0\n')
    script.chmod(0o700)
    return {**os.environ, "CC": str(script)}


@pytest.fixture
def random_system() -> Callable[..., KKTBlocks]:
    return _random_system
