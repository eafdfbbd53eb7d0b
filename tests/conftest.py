"""Random KKT systems in lag storage, for the linear solvers of the CPU and of the GPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from octo import native
from octo.solver.blocks import KKTBlocks

# With two processes these begin first, so that neither waits long for the other at the end.
LONGEST = (
    "test_sanitizers.py",
    "test_nvrtc.py",
    "test_step_pairs.py",
    "test_curvature.py",
    "test_model.py",
    "test_benchmark.py",
    "test_exact_terms.py",
    "test_linear.py",
    "test_bench.py",
)

# Their many libraries run a few steps and are compared with other code: compiled in a quarter of
# the time. What is in neither list is compiled as a user's code is.
PLAIN = ("dynamics", "extending", "problem", "reference", "test_exact_terms.py", "test_model.py")
AS_SHIPPED = ("test_lanes.py", "test_native.py", "test_numbers.py")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        place = {item.path.parent.name, item.path.name}
        if place.isdisjoint(AS_SHIPPED) and not place.isdisjoint(PLAIN):
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


def _compiled_with(optimisation: str) -> Iterator[None]:
    flags = native.FLAGS
    native.FLAGS = tuple(optimisation if flag == "-O3" else flag for flag in flags)
    yield
    native.FLAGS = flags


@pytest.fixture(scope="module")
def quick_compiler() -> Iterator[None]:
    """For the kernels in the emulator: compiled in half the time. What is neither this nor plain is
    compiled as a user's code is."""
    yield from _compiled_with("-O1")


@pytest.fixture(scope="module")
def plain_compiler() -> Iterator[None]:
    """See PLAIN."""
    yield from _compiled_with("-O0")


@pytest.fixture
def random_system() -> Callable[..., KKTBlocks]:
    return _random_system
