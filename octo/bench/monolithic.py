"""FD and its Jacobian as one SX function, as anybody would write it, compiled at -O1."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np

from octo import cache, native
from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics
from octo.interrupts import postponed
from octo.model.quantities import Array

SWEEP = """
#include <string.h>
void sweep(int steps, const double *nodes, const double *p, double *fd, double *jac) {
  static double w[WORK + 1];
  for (int i = 0; i < steps; ++i) {
    double z[3 * NX];
    for (int node = 0; node < 3; ++node) memcpy(z + node * NX, nodes + (i + 2 - node) * NX, NX *
      sizeof(double));
    const double *arg[2] = {z, p};
    double *res[2] = {fd + i * NX, jac + (size_t)i * NJAC};
    fd_jacobian(arg, res, 0, w, 0);
  }
}
"""


class Monolithic:
    """FD and Jacobian of all contacts and pairs, compiled and cached.

    ``plain``: without common-subexpression elimination, and with the dense n × 3n Jacobian row by
    row (the form of the first measurements); otherwise octo's own symbolic FD and the sparse
    Jacobian.
    """

    @postponed()
    def __init__(self, dynamics: RobotDynamics, plain: bool = False):
        n, self.plain = dynamics.nx, plain
        own = (dynamics.character, dynamics.law, dynamics.terrain, dynamics.layout)
        with _without_cse() if plain else nullcontext():
            made = symbolic.forward_dynamics(*own)
        z, p = ca.SX.sym("z", 3 * n), ca.SX.sym("p", dynamics.layout.size)
        fd = made(z[:n], z[n : 2 * n], z[2 * n :], p)
        jac = ca.jacobian(fd, z)
        self.sparsity = jac.sparsity()
        function = ca.Function("fd_jacobian", [z, p], [fd, ca.densify(jac.T) if plain else jac])
        self.n = n
        self.entries = int(function.nnz_out(1))
        self.operations = int(function.n_instructions())
        generator = ca.CodeGenerator("fd_jacobian.c", {"with_header": False, "casadi_int": "int"})
        generator.add(function)
        sizes = {"NX": n, "WORK": function.sz_w(), "NJAC": self.entries}
        defined = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
        text = generator.dump() + defined + SWEEP
        self.library = ctypes.CDLL(str(_compiled(text)))

    def sweep(self, nodes: Array, p: Array, count: int) -> tuple[Array, Array, Callable[[], None]]:
        """FD (count, n), the Jacobian's entries (count, entries), and the function that writes them
        for ``count`` steps after ``count`` steps."""
        fd, jac = np.zeros((count, self.n)), np.zeros((count, self.entries))
        held = (nodes, p, fd, jac)
        firsts = [ctypes.c_void_p(nodes[k:].ctypes.data) for k in range(0, len(nodes) - 2, count)]
        others = [ctypes.c_void_p(array.ctypes.data) for array in held[1:]]

        def run() -> None:
            for first in firsts:
                self.library.sweep(count, first, *others)

        return fd, jac, run

    def dense(self, jac: Array) -> Array:
        """(N, n, 3n) of the entries."""
        if self.plain:
            return jac.reshape(len(jac), self.n, 3 * self.n)
        full = np.zeros((len(jac), self.n, 3 * self.n))
        full[:, self.sparsity.row(), self.sparsity.get_col()] = jac
        return full


@contextmanager
def _without_cse() -> Iterator[None]:
    """``ca.Function`` ignores its options inside."""
    original = ca.Function

    def function(*arguments: Any) -> Any:
        return original(*(argument for argument in arguments if not isinstance(argument, dict)))

    with mock.patch.object(symbolic.ca, "Function", function):
        yield


def _compiled(text: str) -> Path:
    """The library at -O1, in octo's cache: a humanoid takes minutes."""
    words = native.compiler()
    assert words is not None

    def make(path: Path) -> None:
        source = path.with_suffix(".c")
        source.write_text(text, encoding="utf-8")
        flags = ["-O1", "-fPIC", "-shared", "-o", str(path), str(source), "-lm"]
        native.run_compiler([*words, *flags], path.parent)

    return cache.path_of(f"monolithic-{hashlib.sha256(text.encode()).hexdigest()[:24]}.so", make)
