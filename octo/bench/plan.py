"""How much one run of ``octo bench`` measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from octo import native

WORDS = "machine dynamics iteration degrees threads solvers compile symbolic"
GROUPS = tuple(WORDS.split())
# what the number depends on and its name does not say, by how the name begins; the last that fits
# counts
SIZES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("dynamics.", "threads.", "symbolic.", "degrees."), ("steps",)),
    "solvers.": ("motion_steps", "seeds"),
    **{f"degrees.{name}": ("steps", "links") for name in ("power", "longest/shortest")},
}
for _name in ("slope", "constant", "largest_error_of_fit"):
    SIZES |= {f"iteration.{basis}.{_name}": (basis,) for basis in ("nodes", "hermite")}


@dataclass(frozen=True)
class Plan:
    """Sizes and repetitions.

    Attributes
    ----------
    rounds: of interleaved measurements, each of ``burst`` runs in a row of one candidate after one
        that warms the caches.
    steps: N of everything that is not measured against N.
    robots: whose dynamics are measured; staged: those whose iteration is, too (14, 18 and 35
        degrees of freedom).
    nodes, hermite: the N of the cost against N. links: of the chains of the cost against degrees of
        freedom.
    symbolic: robots whose FD and Jacobian are compared with CasADi's whole expression (minutes of
        gcc the first time).
    motion_steps, seeds: of the problem that IPOPT and fatrop solve too, and its starts.
    cold: measure compilation with an empty cache.
    """

    rounds: int = 12
    burst: int = 3
    steps: int = 400
    robots: tuple[str, ...] = ("chain", "biped", "bird", "mammal", "spider", "humanoid")
    staged: tuple[str, ...] = ("chain", "mammal", "humanoid")
    nodes: tuple[int, ...] = (20, 50, 100, 200, 400, 800)
    hermite: tuple[int, ...] = (100, 200, 400, 800)
    links: tuple[int, ...] = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12)
    symbolic: tuple[str, ...] = ("spider", "humanoid")
    motion_steps: int = 80
    seeds: int = 3
    cold: bool = True

    @property
    def threads(self) -> tuple[int, ...]:
        """Counts beside one thread: 2, 4, … up to the cores."""
        return tuple(2**k for k in range(1, 6) if 2**k <= native.cores())

    def record(self) -> dict[str, Any]:
        """As JSON keeps it."""
        found = asdict(self).items()
        return {name: list(v) if isinstance(v, tuple) else v for name, v in found}

    def compares(self, name: str, other: Mapping[str, Any]) -> bool:
        """Whether a record of this name is of the same sizes in the plan that ``other`` is the
        record of."""
        fields = [fields for begin, fields in SIZES.items() if name.startswith(begin)]
        mine = self.record()
        return not fields or all(mine[field] == other[field] for field in fields[-1])


FULL = Plan()
QUICK = Plan(
    rounds=4,
    robots=("chain", "mammal", "humanoid"),
    nodes=(20, 100, 400),
    hermite=(200, 400),
    links=(3, 5, 8),
    symbolic=(),
    motion_steps=40,
    seeds=1,
    cold=False,
)
