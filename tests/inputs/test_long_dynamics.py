"""Long user-written dynamics compile; what a million instructions cost is said, more is refused."""

from __future__ import annotations

import ctypes
import re
import threading
import time
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.dynamics import codegen, long
from octo.emit import HEAD, function_in_lanes
from octo.errors import ModelError
from octo.problem.codegen import cost_text, derived, residuals_of

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def soft(points: int, n: int) -> octo.CustomDynamics:
    """Points of a soft body, each of which moves with all of n coordinates, as one expression."""
    weights = np.random.default_rng(0).standard_normal((points, n))

    def fd(x_next, x, x_prev, p):
        force = (x_next - 2 * x + x_prev) / p["dt"] ** 2
        for w in weights:
            heights = []
            for z in (x_next, x):
                h = z[0]
                for j in range(1, n):
                    h = h + w[j] * ca.sin(z[j] + w[j - 1] * h)
                heights.append(h)
            depth, speed = ca.fmax(0, -heights[0]), (heights[0] - heights[1]) / p["dt"]
            force -= ca.gradient(heights[0], x_next) * (1e3 * depth**2 - 10 * depth * speed)
        return force

    return octo.CustomDynamics(fd, n, [0], {})


def dense(n: int) -> octo.CustomDynamics:
    """Every row looks at every coordinate."""

    def fd(x_next, x, x_prev, p):
        del x_prev, p
        return ca.vertcat(*[ca.sin(ca.dot(x_next + k * x, x_next + k)) ** 3 for k in range(n)])

    return octo.CustomDynamics(fd, n, [0], {})


@needs_compiler
@pytest.mark.parametrize("section", [7, 64, 10**6])
def test_a_long_function_in_sections_is_right(section, monkeypatch):
    """Against CasADi's virtual machine; what a section needs of earlier ones is kept for it, in as
    few places as are needed at once."""
    monkeypatch.setattr(long, "LONG", 100)
    monkeypatch.setattr(long, "SECTION", section)
    model = soft(3, 4)
    text = model.lanes_text() + codegen.batch_source()
    assert 'optimize ("O1")' in text
    assert ("octo_fd2_1(arg, res" in text) == (section < 10**6)
    if section == 7:
        kept = re.search(r"real vectors\[(\d+)\];", text[text.index("static void octo_fd2(") :])
        assert kept and int(kept.group(1)) < 0.2 * text.count("vectors[")
    assert not re.search(r"[};]\s*#", text.replace("\n", "$"))  # a directive has a line of its own
    model.__dict__["_library"] = native.load(text)
    nodes = np.random.default_rng(1).standard_normal((1, 6, 4))
    given = (nodes, model.layout.pack(dt=0.1)[None], np.ones((1, 4, 4)), 2)
    found = model.evaluate(*given)
    model.__dict__["_library"] = None
    for own, expected in zip(found, model.evaluate(*given), strict=True):
        np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-9)


@needs_compiler
def test_sections_give_the_bits_of_the_whole():
    """Numbers that all lanes share, vectors and masks are kept, a negative zero and NaN too."""
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    below = x[0] < p[0]
    mixed = ca.if_else(below, ca.sin(x[1]) * p[1], -(p[0] * p[1]))
    out = ca.vertcat(
        mixed, ca.if_else(ca.logic_and(below, x[2] > 0.0), ca.sqrt(x[2]), -x[0]), -p[0]
    )
    f = ca.Function("f", [x, p], [ca.vertcat(out, ca.sqrt(out[2]) * out[0])], {"cse": True})
    rng = np.random.default_rng(0)
    given, shared = rng.standard_normal((50, 3)), np.array([0.0, -1.5])
    given[:3] = [[-0.0, 0.0, 0.0], [np.nan, 1.0, -1.0], [1.0, np.inf, 4.0]]
    entry = """
void run(const double *x, const double *p, double *out, int count) {
  for (int i = 0; i < count; ++i) {
    real own[3], made[4];
    for (int k = 0; k < 3; ++k) own[k] = ZERO + x[3 * i + k];
    for (int k = 0; k < 3; ++k) for (int s = 0; s < STEPS; ++s) own[k][s] = x[3 * i + k];
    const void *arg[] = {own, p};
    real *res[] = {made};
    f(arg, res);
    for (int k = 0; k < 4; ++k) out[4 * i + k] = made[k][STEPS - 1];
  }
}
"""
    made = []
    for section in (None, 1, 3):
        text = [HEAD, codegen.source("lanes.c"), function_in_lanes(f, {1}, section), entry]
        library = native.load("\n".join(text))
        assert library is not None
        out = np.empty((50, 4))
        library.run(*(ctypes.c_void_p(a.ctypes.data) for a in (given, shared, out)), 50)
        made.append(out)
    assert np.isnan(made[0]).any() and np.isfinite(made[0]).any()
    for other in made[1:]:
        np.testing.assert_array_equal(other.view(np.int64), made[0].view(np.int64))
    np.testing.assert_allclose(made[0], np.array(f(given.T, shared)).T, rtol=1e-12)


@needs_compiler
@pytest.mark.parametrize("limit", ["LONG", "HUGE"])
def test_long_functions_of_numbers_compile(limit, monkeypatch):
    """At -O1 and at -O0."""
    monkeypatch.setattr(long, limit, 100)
    text = soft(3, 4).text()
    assert f'optimize ("{"O0" if limit == "HUGE" else "O1"}")' in text
    assert native.load(text) is not None


@needs_compiler
def test_long_functions_need_little_of_the_stack():
    """A thread of half a megabyte: every value of a function would take more."""
    model = soft(4, 6)
    assert model.lanes_text().count("\n") > 20_000
    nodes, found = np.random.default_rng(1).standard_normal((1, 4, 6)), []

    def run() -> None:
        found.extend(model.evaluate(nodes, model.layout.pack(dt=0.1)[None], np.ones((1, 2, 6)), 2))

    before = threading.stack_size(1 << 19)
    try:
        thread = threading.Thread(target=run)
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    assert len(found) >= 3 and all(np.isfinite(each).all() for each in found[:3])


@needs_compiler
def test_more_than_3000_instructions_are_solved():
    model = soft(3, 5)
    assert model.symbolic.n_instructions() > 200
    problem = octo.Problem(model, steps=4, dt=0.05, x0=np.full(5, 0.3), costs=[octo.Effort()])
    assert octo.solve(problem, max_iterations=3, device="cpu").iterations > 0
    assert "#pragma GCC optimize" in model.lanes_text()


@needs_compiler
def test_a_long_ground_and_a_long_term_compile(monkeypatch):
    monkeypatch.setattr(long, "LONG", 50)
    bumps = octo.Terrain(lambda at, p: at[2] - sum(0.001 * ca.sin(k * at[0]) for k in range(1, 9)))
    robot = octo.gallery.chain()
    term = octo.CustomCost(lambda step, p: sum(ca.sin(k * step.x_next) for k in range(1, 30)))
    costs = [octo.Effort(), octo.Slip(), term]
    problem = octo.Problem(
        robot, steps=4, dt=0.05, x0=robot.default_pose, terrain=bumps, costs=costs
    )
    text = problem.dynamics.lanes_text()
    made = derived(residuals_of(problem.dynamics, problem.costs, problem.setting, False))
    assert "optimize" in text and "optimize" in cost_text(made, problem.dynamics)
    found = octo.solve(problem, max_iterations=2, passes=1, device="cpu")
    assert np.isfinite(found.energy)


@pytest.mark.parametrize("n", [60, 100])
def test_millions_of_instructions_are_refused_before_they_are_written(n):
    began = time.process_time()
    with pytest.raises(
        ModelError, match=r"user-written dynamics: \S+ million instructions of C.*at most 2 million"
    ):
        dense(n).lanes_text()
    assert time.process_time() - began < 60.0


def test_what_many_instructions_cost_is_said_once_before(monkeypatch, caplog):
    monkeypatch.setattr(long, "COSTLY", 2000)
    long._say.cache_clear()
    model = soft(2, 4)
    model.lanes_text(), model.text()
    said = caplog.messages
    assert len(said) == 1 and said[0].startswith("these user-written dynamics: 4 thousand instr")
    assert "s of processor time and 0.0 GB of memory, the first time" in said[0]


def test_a_limit_of_instructions_holds_for_terms_and_grounds_too(monkeypatch):
    monkeypatch.setattr(long, "MOST", 300)
    monkeypatch.setattr("octo.problem.codegen.COSTLY", 300)
    robot = octo.gallery.chain()
    given = {"steps": 4, "dt": 0.05, "x0": robot.default_pose}
    endless = octo.CustomCost(
        lambda step, p: sum(ca.sin(k * step.x_next) for k in range(1, 60)), name="Hum"
    )
    problem = octo.Problem(robot, **given, costs=[octo.Effort(), endless])
    with pytest.raises(ModelError, match="terms of E: .* the longest is Hum"):
        derived(residuals_of(problem.dynamics, problem.costs, problem.setting, False))
    with pytest.raises(ModelError, match="contact law and terrain: "):
        octo.Problem(robot, **given, costs=[octo.Effort()]).dynamics.lanes_text()


def test_a_limit_of_instructions_holds_for_second_derivatives(monkeypatch):
    """Of a term that is short itself, before they are written."""
    robot = octo.gallery.chain()
    long_one = octo.CustomCost(
        lambda step, p: ca.sin(ca.sumsqr(step.x_next)), name="Hum", curvature="exact"
    )
    given = {"steps": 4, "dt": 0.05, "x0": robot.default_pose}
    problem = octo.Problem(robot, **given, costs=[octo.Effort(), long_one])
    monkeypatch.setattr(long, "MOST", 400)
    monkeypatch.setattr(codegen, "MOST", 400)
    with pytest.raises(ModelError, match="second derivatives of Hum: .*gauss_newton"):
        derived(residuals_of(problem.dynamics, problem.costs, problem.setting, False))
    plain = problem.replace(costs=[octo.Effort(), replace(long_one, curvature="gauss_newton")])
    derived(residuals_of(plain.dynamics, plain.costs, plain.setting, False))


def test_sparse_dynamics_of_many_coordinates_are_not_refused():
    """A string of 300 masses: its curvature has a few columns a row, however long it is."""

    def fd(x_next, x, x_prev, p):
        stretch = ca.sin(ca.vertcat(x_next, 0) - ca.vertcat(0, x_next))
        return (x_next - 2 * x + x_prev) / p["dt"] ** 2 + stretch[:-1] ** 3 - stretch[1:] ** 3

    model = octo.CustomDynamics(fd, 300, [0], {})
    z, p, lam = ca.SX.sym("z", 900), ca.SX.sym("p", 1), ca.SX.sym("lam", 300)
    jac = ca.jacobian(model.symbolic(z[:300], z[300:600], z[600:], p), z)
    codegen.check_curvature("it", [z, p, lam], ca.mtimes(jac.T, lam), "")
