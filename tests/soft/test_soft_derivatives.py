"""FD of a reduced deformable body and its derivatives: against one CasADi expression, a rigid
robot, differences, and all vertices one by one."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from soft.clouds import cloud

import octo
from octo import laws, native, soft
from octo.dynamics.codegen import batch_source
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.dynamics.symbolic import contact_state
from octo.model.body import floating_base
from octo.model.character import Body, Character, ContactSphere
from octo.soft.moments import Moments
from octo.soft.near import spheres_of


def hilly(at: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    return at[2] - 0.03 * ca.sin(9.0 * at[0]) * ca.cos(7.0 * at[1])


HILLS = octo.Terrain(hilly)
BOXES = octo.World(
    [octo.shapes.Ground(), octo.shapes.Box((0.3, 0.4, 0.1), 0.04, position=(0.1, 0.0, 0.0))]
)
CASES = {
    "plane": (laws.Smooth(onset=0.03), octo.Plane(slope=0.2), "zyx"),
    "compliant": (laws.Compliant(), octo.Plane(), "zxy"),
    "hills": (laws.Smooth(onset=0.02), HILLS, "zyx"),
}


def moving(dynamics: soft.SoftDynamics, height: float = 0.13, seed: int = 1, steps: int = 5):
    """Nodes (1, steps+2, n) of a body that turns and bends near the ground, p and lam."""
    rng = np.random.default_rng(seed)
    x = np.zeros((1, steps + 2, dynamics.nx))
    x[..., 2] = height
    x[..., 3:6] = rng.normal(size=3)
    x += 0.02 * rng.normal(size=x.shape)
    lam = rng.normal(size=(1, steps, dynamics.nx))
    return x, dynamics.layout.pack()[None], lam


def on_numbers(dynamics: soft.SoftDynamics) -> soft.SoftDynamics:
    """The same in C for one time step at a time, as for CUDA."""
    made = copy.copy(dynamics)
    made.__dict__["_library"] = native.load(made.text() + batch_source())
    return made


def close(found: tuple, wanted: tuple, tolerance: float) -> None:
    for own, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(own, other, rtol=0.0, atol=tolerance * np.abs(other).max())


@pytest.mark.parametrize("case", CASES)
def test_loops_say_what_one_expression_says(case: str) -> None:
    law, terrain, chart = CASES[case]
    body = cloud(4, 14, bent=case == "compliant")  # with St. Venant–Kirchhoff's energy
    dynamics = soft.SoftDynamics(body, law, terrain, chart=chart)
    x, p, lam = moving(dynamics)
    wanted = tuple(np.empty_like(one) for one in dynamics.interpreted().evaluate(x, p, lam, 2))
    Dynamics._interpret(dynamics, x, p, lam, *wanted)  # the expression, differentiated by CasADi
    without = dynamics.evaluate(x + 5.0 * np.eye(dynamics.nx)[2], p)[0]
    assert np.abs(without - wanted[0]).max() > 1.0  # it touches
    close(dynamics.interpreted().evaluate(x, p, lam, 2), wanted, 1e-12)
    close(dynamics.evaluate(x, p, lam, 2), wanted, 1e-12)
    again = pickle.loads(pickle.dumps(dynamics))
    close(on_numbers(again).evaluate(x, p, lam, 2), wanted, 1e-12)
    for order in (0, 1):
        close(dynamics.evaluate(x, p, None, order)[: order + 1], wanted[: order + 1], 1e-12)


def test_a_world_is_looked_up_alike() -> None:
    """In C lane by lane, in NumPy all at once; a plane in it is the plane."""
    body, law = cloud(4, 120), laws.Smooth(onset=0.02)
    dynamics = soft.SoftDynamics(body, law, BOXES)
    x, p, lam = moving(dynamics, 0.2, steps=9)
    wanted = dynamics.interpreted().evaluate(x, p, lam, 2)
    close(dynamics.evaluate(x, p, lam, 2), wanted, 1e-11)
    close(on_numbers(dynamics).evaluate(x, p, lam, 2), wanted, 1e-11)
    level = soft.SoftDynamics(body, law, octo.World([octo.shapes.Ground()]))
    plane = soft.SoftDynamics(body, law)
    x[..., 2] -= 0.08
    on_level = level.evaluate(x, level.layout.pack()[None], lam, 2)
    close(on_level, plane.evaluate(x, plane.layout.pack()[None], lam, 2), 1e-12)
    assert np.abs(wanted[0] - level.evaluate(x, level.layout.pack()[None])[0]).max() > 1.0


@pytest.mark.parametrize("modes", [0, 3])
def test_a_body_that_does_not_bend_is_a_rigid_robot(modes: int) -> None:
    """Its vertices are spheres without a radius."""
    body, law = cloud(modes, 20), laws.Smooth(onset=0.03)
    dynamics = soft.SoftDynamics(body, law)
    x, p, lam = moving(dynamics, steps=9)
    x[..., 6:], lam[..., 6:] = 0.0, 0.0
    second = body.inertia[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    vertices = [ContactSphere(f"v{k}", 0, at, 0.0) for k, at in enumerate(body.points)]
    block = Body("block", -1, floating_base(), mass=body.mass, inertia=inertia)
    rigid = RobotDynamics(Character("block", (block,), tuple(vertices)), law)
    own = {name: p[0, k] for k, name in enumerate(dynamics.layout.names)}
    at = rigid.layout.pack(**{n: v for n, v in own.items() if not n.startswith("elastic.")})
    wanted = rigid.evaluate(x[..., :6], at[None], lam[..., :6], 2)
    fd, jac, hess = dynamics.evaluate(x, p, lam, 2)
    n = dynamics.nx
    assert jac is not None and hess is not None
    jac = jac.reshape(*jac.shape[:3], 3, n)[..., :6, :, :6].reshape(wanted[1].shape)
    hess = hess.reshape(*hess.shape[:2], 3, n, 3, n)[:, :, :, :6, :, :6].reshape(wanted[2].shape)
    close((fd[..., :6], jac, hess), wanted, 1e-13)


def test_slopes_are_those_of_differences() -> None:
    """FD(x + h d) = FD + h J d + O(h²): the remainder falls by four where h is halved."""
    dynamics = soft.SoftDynamics(cloud(6, 80), laws.Compliant())
    x, p, _ = moving(dynamics, steps=1)
    way = np.random.default_rng(3).normal(size=x.shape)
    fd, jac, _ = dynamics.evaluate(x, p, None, 1)
    assert jac is not None
    along = jac[0, 0] @ way[0, ::-1].ravel()  # columns are next, now, previous
    left = []
    for h in 1e-4 * 0.5 ** np.arange(4):
        left.append(np.abs(dynamics.evaluate(x + h * way, p)[0][0, 0] - fd[0, 0] - h * along).max())
    np.testing.assert_allclose(np.log2(np.divide(left[:-1], left[1:])), 2.0, atol=0.05)


def test_curvature_is_that_of_differences() -> None:
    """Of λᵀJ, fourth order, to 1e-9."""
    dynamics = soft.SoftDynamics(cloud(5, 80), laws.Compliant())
    x, p, lam = moving(dynamics, steps=1)
    hess = dynamics.evaluate(x, p, lam, 2)[2]
    assert hess is not None
    n, h = dynamics.nx, 2e-5

    def pulled(change: np.ndarray) -> np.ndarray:
        jac = dynamics.evaluate(x + change[::-1].reshape(x.shape), p, None, 1)[1]
        assert jac is not None
        return np.asarray(lam[0, 0] @ jac[0, 0])

    made = []
    for column in np.eye(3 * n):
        d = h * column.reshape(3, n)
        near, far = (pulled(s * d) - pulled(-s * d) for s in (1.0, 2.0))
        made.append((8.0 * near - far) / (12.0 * h))
    close((hess[0, 0],), (np.array(made),), 1e-9)


@pytest.mark.parametrize("height", [0.05, 0.14])
def test_contacts_are_those_of_all_vertices(height: float) -> None:
    """One by one, by virtual work; many of them are out of reach."""
    body, law, terrain = cloud(5, 400), laws.Smooth(onset=0.01), HILLS
    dynamics = soft.SoftDynamics(body, law, terrain)
    x, p, _ = moving(dynamics, height, steps=12)
    free = dynamics.layout.pack(**{"contact.w_perp": 0.0, "contact.w_par": 0.0})[None]
    found = dynamics.evaluate(x, p)[0] - dynamics.evaluate(x, free)[0]
    n = dynamics.nx
    node, now, Y = ca.SX.sym("x", n), ca.SX.sym("now", n), ca.SX.sym("Y", len(body.inertia))
    places = [soft.symbolic.embedding(one, "zyx") @ Y for one in (node, now)]
    state = contact_state(*places, 0.0, law, terrain, dynamics.layout.view(ca.SX(ca.DM(p[0]))))
    work = ca.jtimes(places[0], node, state.force, True)
    one = ca.Function("one", [node, now, Y], [work, state.force])
    shapes = np.column_stack([body.points, body.modes.reshape(400, -1), np.ones(400)]).T
    wanted, touching = np.zeros_like(found), []
    for k in range(12):
        own, force = one(x[0, k + 2], x[0, k + 1], shapes)
        wanted[0, k] = -np.sum(np.asarray(own), axis=1)
        touching.append(np.count_nonzero(np.asarray(force)[2]))
    assert 0 < np.mean(touching) < 300
    close((found,), (wanted,), 1e-12)


def test_every_vertex_is_in_the_spheres_around_it() -> None:
    shapes = np.concatenate([(b := cloud(5, 200)).points[:, None], b.modes], axis=1)
    spheres, rng = spheres_of(shapes), np.random.default_rng(0)
    for scale in (0.0, 0.1, 10.0):
        z = scale * rng.normal(size=5)
        weights = np.concatenate([[1.0], z])
        at = np.einsum("k,pkj->pj", weights, shapes)
        centers = np.einsum("k,ekj->ej", weights, spheres.shapes)
        radii = spheres.around + spheres.spread @ np.abs(z)
        for e in np.flatnonzero(spheres.member < 0):
            below = spheres.member[e : spheres.skip[e]]
            ways = np.linalg.norm(at[below[below >= 0]] - centers[e], axis=1)
            assert (ways <= radii[e] * (1.0 + 1e-12)).all()


def test_made_up_modes_move_no_mass() -> None:
    """What the other tests rely on: no momentum, mass-normalised."""
    moments = Moments.of(cloud(6, 30))
    np.testing.assert_allclose(moments.first, 0.0, atol=1e-14)
    np.testing.assert_allclose(moments.modal, np.eye(6), atol=1e-13)
    spin = moments.second[1:, 0] - np.swapaxes(moments.second[1:, 0], 1, 2)
    np.testing.assert_allclose(spin, 0.0, atol=1e-14)


def test_a_wrong_argument_is_named() -> None:
    body = cloud(3, 50)
    for name, given in (("actuated", [3]), ("actuated", [0, 0]), ("chart", "xyz")):
        with pytest.raises(octo.errors.ProblemError, match=name):
            soft.SoftDynamics(body, **{name: given})
    with pytest.raises(octo.errors.ProblemError, match="body is"):
        soft.SoftDynamics(octo.gallery.mammal())  # type: ignore[arg-type]
    on_world = soft.SoftDynamics(body, terrain=BOXES)
    with pytest.raises(octo.errors.ModelError, match="World"):
        on_world.symbolic  # noqa: B018
    with pytest.raises(octo.errors.ModelError, match="50 vertices"):
        soft.SoftDynamics(body).symbolic  # noqa: B018
    assert soft.SoftDynamics(replace(body, modes=body.modes), actuated=[2]).nu == 1


def test_the_pattern_has_all_that_is_not_zero() -> None:
    dynamics = soft.SoftDynamics(cloud(3, 40), laws.Smooth(onset=0.03), HILLS)
    x, p, lam = moving(dynamics, steps=20)
    hess = dynamics.evaluate(x, p, lam, 2)[2]
    assert hess is not None
    size = np.abs(hess[0]).max(axis=0)
    pattern = dynamics.curvature_pattern
    np.testing.assert_array_equal(pattern, pattern.T)
    assert (size[~pattern] == 0.0).all()
    assert (size[pattern] > 0.0).mean() > 0.8
