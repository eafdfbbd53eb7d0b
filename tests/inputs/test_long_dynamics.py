"""Long user-written dynamics compile; what a million instructions cost is said, more is refused."""

from __future__ import annotations

import re
import time
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.dynamics import codegen, long
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
@pytest.mark.parametrize("lanes", [False, True])
@pytest.mark.parametrize("limit", ["LONG", "HUGE"])
def test_long_functions_compile_and_are_right(lanes, limit, monkeypatch):
    """At -O1 and at -O0, in lanes and alone, against CasADi's virtual machine."""
    monkeypatch.setattr(long, limit, 100)
    model = soft(3, 4)
    text = (model.lanes_text() if lanes else model.text()) + codegen.batch_source()
    assert f'optimize ("{"O0" if limit == "HUGE" else "O1"}")' in text
    assert not re.search(r"[};]\s*#", text.replace("\n", "$"))  # a directive has a line of its own
    if not lanes:
        assert native.load(text.replace(codegen.batch_source(), "")) is not None
        return
    model.__dict__["_library"] = native.load(text)
    nodes = np.random.default_rng(1).standard_normal((1, 6, 4))
    given = (nodes, model.layout.pack(dt=0.1)[None], np.ones((1, 4, 4)), 2)
    found = model.evaluate(*given)
    model.__dict__["_library"] = None
    for own, expected in zip(found, model.evaluate(*given), strict=True):
        np.testing.assert_allclose(own, expected, rtol=1e-9, atol=1e-9)


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
