"""Time steps in the lanes of a vector: the numbers of one step at a time, whatever stands in the
other lanes."""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest
from test_tree_pass import TERRAINS, harden, inflate, sink, touching, trajectory

from octo import native
from octo.dynamics import codegen
from octo.dynamics.evaluate import CustomDynamics, RobotDynamics, unfold
from octo.emit import function_of_numbers
from octo.errors import ModelError
from octo.model.gallery import CHARACTERS

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
COUNTS = (1, 7, 8, 9, 25)


def one_by_one(dynamics, nodes, p, lam, order):
    """The same from the text for one step."""
    library = native.load(dynamics.text() + codegen.batch_source())
    batch, steps, n = nodes.shape[0], nodes.shape[1] - 2, dynamics.nx
    shapes = (n,), (n, 3 * n), (dynamics.curvature_blocks, n, n)
    out = [np.zeros((batch, steps, *shape)) for shape in shapes]
    arrays = [np.ascontiguousarray(a) for a in (nodes, p, lam, *out)]
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in arrays]
    assert library.octo_batch(batch, steps, order, 1, *pointers) == 0
    return (out[0], out[1], unfold(out[2]))[: order + 1]


@pytest.fixture(scope="module")
def mixed():
    """Mammals that touch the ground, and themselves, at some steps only."""
    rng = np.random.default_rng(3)
    character = harden(CHARACTERS["mammal"](), rng)
    nodes = trajectory(character, rng, count=27, spread=0.2, step=0.2)
    nodes = np.concatenate([nodes, nodes[:, ::-1]])
    character = inflate(character, nodes[:, 5:8])
    sink(character, nodes[:, 2:8], TERRAINS["slope"])
    nodes[:, 1::3, 2] += 0.5  # off the ground
    dynamics = RobotDynamics(character, terrain=TERRAINS["slope"])
    p = np.stack([dynamics.layout.pack(), dynamics.layout.pack(dt=0.03)])
    return dynamics, nodes, p, rng.standard_normal((2, 25, character.nx))


def test_the_cases_are_mixed(mixed):
    """Some steps are off the ground, and some pairs touch at some nodes only."""
    dynamics, nodes, p, lam = mixed
    numbers = p.copy()
    numbers[:, [dynamics.layout.names.index(f"contact.{name}") for name in ("w_perp", "w_par")]] = (
        0.0
    )
    free = (dynamics.evaluate(nodes, numbers)[0] == dynamics.evaluate(nodes, p)[0]).all(axis=2)
    assert free.any() and not free.all()
    pairs = np.array([touching(dynamics.character, nodes[:1, k:]) for k in range(25)])
    assert (pairs.any(axis=0) & ~pairs.all(axis=0)).sum() > 3


@pytest.mark.parametrize("steps", COUNTS)
@pytest.mark.parametrize("batch", [1, 2])
def test_equal_one_step_at_a_time(mixed, batch, steps):
    dynamics, nodes, p, lam = mixed
    nodes, p, lam = nodes[:batch, : steps + 2], p[:batch], np.ascontiguousarray(lam[:batch, :steps])
    for order in (0, 1, 2):
        single = one_by_one(dynamics, nodes, p, lam, order)
        for found, wanted in zip(dynamics.evaluate(nodes, p, lam, order), single, strict=False):
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize("threads", [2, 3, 40])
def test_threads_do_not_change_a_bit(mixed, threads):
    dynamics, nodes, p, lam = mixed
    for one, other in zip(
        dynamics.evaluate(nodes, p, lam, 2),
        dynamics.evaluate(nodes, p, lam, 2, threads=threads),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("node", [0, 12, 26])
def test_a_nan_stays_in_its_lane(mixed, node):
    dynamics, nodes, p, lam = mixed
    clean = dynamics.evaluate(nodes, p, lam, 2)
    nodes = nodes.copy()
    nodes[0, node, 5] = np.nan
    touched = [k for k in (node - 2, node - 1, node) if 0 <= k < 25]
    others = np.setdiff1d(np.arange(25), touched)
    for one, other in zip(clean, dynamics.evaluate(nodes, p, lam, 2), strict=True):
        np.testing.assert_array_equal(one[0, others], other[0, others])
        np.testing.assert_array_equal(one[1], other[1])
        assert all(np.isnan(other[0, k]).any() for k in touched)


def every_operation(x_next, x, x_prev, p):
    """All that emit.py knows."""
    y, z = ca.sin(x) / 2, p["push"] + x_prev
    smooth = (
        ca.tan(y)
        + ca.asin(y)
        + ca.acos(y)
        + ca.atan(z)
        + ca.sinh(y)
        + ca.cosh(y)
        + ca.tanh(z)
        + ca.asinh(z)
    )
    smooth += (
        ca.acosh(2 + y)
        + ca.atanh(y)
        + ca.exp(y)
        + ca.expm1(y)
        + ca.log(2 + y)
        + ca.log1p(y)
        + ca.erf(z)
    )
    smooth += (
        ca.sqrt(2 + y)
        + ca.cos(z)
        + ca.fabs(z)
        + ca.sign(z)
        + (2 + y) ** 1.7
        + (2 + y) ** z
        + ca.atan2(y, z)
    )
    smooth += ca.hypot(y, z) + ca.fmin(y, z) + ca.fmax(y, x_next)
    steps = ca.floor(z) + ca.ceil(z) + ca.fmod(z, 0.7) + ca.copysign(y, z)
    steps += ca.if_else(ca.logic_and(z > 0, y < 0.2), z, -y * 3)
    choice = ca.if_else(ca.logic_or(ca.logic_not(z >= 0.1), x_next == x), 1 / (2 + y), y**2) + (
        y != z
    )
    return smooth + steps + choice + (x_next - 2 * x + x_prev) / p["dt"] ** 2


@pytest.mark.parametrize("n", [1, 2, 5])
def test_every_operation(n):
    """User-written dynamics against CasADi's own machine."""
    dynamics = CustomDynamics(every_operation, n, [0], {"push": 0.3})
    rng = np.random.default_rng(n)
    nodes, lam = rng.standard_normal((2, 12, n)), rng.standard_normal((2, 10, n))
    p = np.tile(dynamics.layout.pack(), (2, 1))
    for order in (0, 1, 2):
        found = dynamics.evaluate(nodes, p, lam, order)
        wanted = [
            np.empty((2, 10, n)),
            np.empty((2, 10, n, 3 * n)),
            np.empty((2, 10, 3 * n, 3 * n)),
        ]
        dynamics._interpret(nodes, p, lam, *wanted)
        for one, other in zip(found, wanted, strict=True):
            if one is not None:
                np.testing.assert_allclose(
                    one, other, rtol=0.0, atol=1e-12 * max(1.0, np.abs(other).max())
                )


def test_every_operation_over_numbers():
    """Values and derivatives as plain C, not-a-number and signed zeros too, against CasADi's own
    machine."""
    inputs = [ca.SX.sym(name) for name in ("x_next", "x", "x_prev", "push")]
    value = every_operation(*inputs[:3], {"push": inputs[3], "dt": 0.1})
    sign = ca.sign(inputs[0]) * ca.if_else(inputs[1] > 0.0, ca.inf, -2.0)
    outputs = ca.vertcat(
        value, ca.gradient(value, ca.vertcat(*inputs)), sign, 3.0 / inputs[0], inputs[1] / inputs[0]
    )
    function = ca.Function("octo_every", inputs, [outputs], {"cse": True})
    arrays = "const double *a[] = {x, x + 1, x + 2, x + 3}; double *r[] = {y};"
    entry = f"void run(const double *x, double *y) {{ {arrays} octo_every(a, r); }}"
    library = native.load("\n".join(["#include <math.h>", function_of_numbers(function), entry]))
    rows = np.random.default_rng(0).standard_normal((40, 4))
    rows[0, 0], rows[1, 0], rows[2, 1], rows[3] = 0.0, -0.0, np.nan, [1.0, 1.0, 2.0, 0.0]
    for row in rows:
        found, wanted = np.full(outputs.numel(), 7.0), function(*row).full().ravel()
        library.run(ctypes.c_void_p(row.ctypes.data), ctypes.c_void_p(found.ctypes.data))
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


def test_an_unknown_operation_is_refused_by_name():
    dynamics = CustomDynamics(
        lambda x_next, x, x_prev, p: ca.erfinv(x_next) + x - x_prev, 1, [0], {}
    )
    with pytest.raises(ModelError, match="erfinv"):
        dynamics.lanes_text()
    with pytest.raises(ModelError, match="erfinv"):
        function_of_numbers(ca.Function("f", [x := ca.SX.sym("x")], [ca.erfinv(x)]))
