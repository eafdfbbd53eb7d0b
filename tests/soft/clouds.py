"""Bodies of point masses with smooth made-up modes, for tests that need no finite elements."""

from __future__ import annotations

import numpy as np

from octo import soft


def cloud(
    modes: int = 10, count: int = 60, seed: int = 0, size: float = 0.15, bent: bool = False
) -> soft.Body:
    """Points on a sphere of ``size`` m, 1.5 kg, and as many inside; quadratic and cubic fields."""
    rng = np.random.default_rng(seed)
    axes = _spread(count)
    inside = 0.6 * _spread(count) + 0.05 * rng.normal(size=(count, 3))
    at = size * np.vstack([axes, inside])
    mass = rng.uniform(0.5, 1.5, len(at))
    mass *= 1.5 / mass.sum()
    at -= mass @ at / mass.sum()
    fields = [np.cross(one, at) for one in np.eye(3)]
    rigid = [np.broadcast_to(one, at.shape) for one in np.eye(3)] + fields
    fields = list(rigid)
    for _ in range(modes):
        linear, square = rng.normal(size=(3, 3)), rng.normal(size=(3, 3, 3)) / size
        fields.append(at @ linear.T + 0.5 * np.einsum("ijk,pj,pk->pi", square, at, at))
    made: list[np.ndarray] = []
    for field in fields:  # Gram-Schmidt with the masses, twice
        own = np.array(field, dtype=float)
        for _ in range(2):
            for other in made:
                own = own - other * np.einsum("p,pi,pi->", mass, own, other)
        made.append(own / np.sqrt(np.einsum("p,pi,pi->", mass, own, own)))
    phi = np.array(made[6:]).reshape(modes, len(at), 3).swapaxes(0, 1)
    Y = np.concatenate([at, phi.reshape(len(at), -1), np.ones((len(at), 1))], axis=1)
    stiffness = np.diag((2.0 * np.pi * np.linspace(6.0, 14.0, modes)) ** 2)
    given = {
        "name": "cloud",
        "points": at[:count],
        "faces": np.zeros((0, 3), dtype=np.intp),
        "modes": phi[:count],
        "inertia": np.einsum("p,pa,pb->ab", mass, Y, Y),
        "stiffness": stiffness,
        "damping": (0.3, 0.004),
    }
    made_of: dict[str, object] = {} if not bent else {"stvk": _gram(stiffness, rng)}
    made_of |= {"young": 1e4, "poisson": 0.3, "density": 100.0, "elements": 0, "nodes": len(at)}
    return soft.Body(**given, **made_of)


def _gram(stiffness: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A matrix of an elastic energy with products, whose linear part is the stiffness."""
    r = len(stiffness)
    root = np.linalg.cholesky(stiffness)
    more = 200.0 * rng.normal(size=(r * (r + 1) // 2, r + 3))
    rows = np.vstack([np.column_stack([root, np.zeros((r, 3))]), more])
    return rows @ rows.T


def _spread(count: int) -> np.ndarray:
    """Points on the unit sphere (Fibonacci's spiral)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], 1)
