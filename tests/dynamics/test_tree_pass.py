"""FD, its Jacobian and its curvature by composites equal CasADi's derivatives of the summed
expression."""

from __future__ import annotations

import dataclasses
import itertools

import casadi as ca
import numpy as np
import pytest

from octo import native
from octo.dynamics.evaluate import CustomDynamics, RobotDynamics
from octo.dynamics.laws import Compliant, Coulomb, Smooth, Viscous
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import sphere_centers
from octo.model.terrain import Plane, Terrain

# of the largest entry; both sides round at 1e-15, amplified by 1/dt² and stiff contacts
TOLERANCE = 1e-11

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def hills(point, p):
    return (point[2] - p["height"] * ca.sin(3.0 * point[0]) * ca.cos(2.0 * point[1])) / ca.sqrt(
        1.0 + p["height"] ** 2
    )


LAWS = {
    "viscous": Smooth(),
    "viscous, soft onset": Smooth(onset=0.02),
    "coulomb": Smooth(friction=Coulomb()),
    "coulomb, soft onset": Smooth(onset=0.02, friction=Coulomb(mu=0.6)),
    "compliant": Compliant(),
    "compliant, viscous": Compliant(friction=Viscous(w_par=50.0)),
}
TERRAINS = {
    "slope": Plane(slope=0.2, direction=0.7, height=0.1),
    "hills": Terrain(hills, {"height": 0.15}),
}


def harden(character, rng):
    """The same character with every joint force at work and pairs between the spheres of all
    bodies."""
    bodies = tuple(
        dataclasses.replace(body, joints=tuple(harden_joint(joint, rng) for joint in body.joints))
        for body in character.bodies
    )
    spheres = character.contacts
    pairs = [
        pair
        for pair in itertools.combinations(range(len(spheres)), 2)
        if spheres[pair[0]].body != spheres[pair[1]].body
    ]
    chosen = rng.permutation(len(pairs))[:12]
    return dataclasses.replace(
        character, bodies=bodies, contacts=spheres, pairs=tuple(pairs[k] for k in chosen)
    )


def harden_joint(joint, rng):
    armature, damping, stiffness, rest = rng.uniform(0.0, 1.0, 4)
    lower = rng.uniform(-0.5, 0.2)
    numbers = {"armature": armature, "damping": damping, "stiffness": stiffness, "rest": rest}
    return dataclasses.replace(joint, **numbers, lower=lower, upper=lower + 0.3)


def sink(character, nodes, terrain):
    """Shifts the nodes along z until about half of the spheres are in the ground, and says which
    are."""
    centers = sphere_centers(character, nodes[0, 2])
    point = ca.SX.sym("point", 3)
    distance = ca.Function("distance", [point], [terrain.distance(point, terrain.parameters)])
    heights = np.array([float(distance(c)) for c in centers]) - [
        s.radius for s in character.contacts
    ]
    shift = np.median(heights) + 0.01
    if character.base == "floating":
        nodes[..., 2] -= shift
        heights -= shift
    return heights < 0.0


def inflate(character, nodes):
    """The same character with spheres so large that several pairs touch at the last node, and not
    all."""
    while sum(touching(character, nodes)) < 3:
        grown = tuple(
            dataclasses.replace(s, radius=1.2 * s.radius + 0.01) for s in character.contacts
        )
        character = dataclasses.replace(character, contacts=grown)
    assert sum(touching(character, nodes)) < len(character.pairs)
    return character


def touching(character, nodes):
    """Which pairs are closer than their radii."""
    centers = sphere_centers(character, nodes[0, 2])
    radius = [s.radius for s in character.contacts]
    return [
        np.linalg.norm(centers[a] - centers[b]) < radius[a] + radius[b] for a, b in character.pairs
    ]


def oracle(dynamics, nodes, p, lam):
    """FD, its Jacobian and its curvature by CasADi's derivatives of the summed expression."""
    n = dynamics.nx
    z, parameters, multiplier = ca.SX.sym("z", 3 * n), ca.SX.sym("p", p.size), ca.SX.sym("lam", n)
    fd = dynamics.symbolic(z[:n], z[n : 2 * n], z[2 * n :], parameters)
    slope = ca.gradient(ca.dot(multiplier, fd), z)
    outputs = [fd, ca.jacobian(fd, z), ca.jacobian(slope, z)]
    function = ca.Function(
        "oracle", [z, parameters, multiplier], [ca.densify(out) for out in outputs]
    )
    steps = range(nodes.shape[1] - 2)
    values = [function(np.concatenate(nodes[0, [k + 2, k + 1, k]]), p[0], lam[0, k]) for k in steps]
    return tuple(np.stack([np.asarray(value[k]) for value in values])[None] for k in range(3))


def compare(dynamics, nodes, rng, parameters=None):
    """The C text against CasADi, all orders."""
    p = dynamics.layout.pack(**(parameters or {}))[None]
    lam = rng.standard_normal((1, nodes.shape[1] - 2, dynamics.nx))
    fd, jac, hess = dynamics.evaluate(nodes, p, lam, order=2)
    expected = oracle(dynamics, nodes, p, lam)
    expected = expected[0][..., 0], *expected[1:]
    for name, found, wanted in zip(
        ("FD", "Jacobian", "curvature"), (fd, jac, hess), expected, strict=True
    ):
        assert np.isfinite(wanted).all()
        np.testing.assert_allclose(
            found, wanted, rtol=0.0, atol=TOLERANCE * np.abs(wanted).max(), err_msg=name
        )
    assert np.array_equal(hess, hess.swapaxes(2, 3))
    for order in (0, 1):
        lower = dynamics.evaluate(nodes, p, order=order)
        for found, wanted in zip(lower[: order + 1], (fd, jac), strict=False):
            np.testing.assert_allclose(
                found, wanted, rtol=0.0, atol=TOLERANCE * np.abs(wanted).max()
            )


def trajectory(character, rng, count=4, spread=0.3, step=0.02):
    start = np.zeros(character.nx) if character.default_pose is None else character.default_pose
    pose = start + spread * rng.standard_normal(character.nx)
    return pose + step * rng.standard_normal((1, count, character.nx))


CASES = [
    *(
        ("chain", law, terrain)
        for law, terrain in zip(LAWS, itertools.cycle(TERRAINS), strict=False)
    ),
    ("biped", "viscous", "hills"),
    ("bird", "coulomb", "slope"),
    ("mammal", "compliant", "hills"),
    ("spider", "viscous, soft onset", "slope"),
    ("humanoid", "coulomb, soft onset", "hills"),
]


@pytest.mark.parametrize(("name", "law", "terrain"), CASES)
def test_gallery(name, law, terrain):
    rng = np.random.default_rng(len(name))
    character = harden(CHARACTERS[name](), rng)
    nodes = trajectory(character, rng)
    character = inflate(character, nodes)
    inside = sink(character, nodes, TERRAINS[terrain])
    assert 0 < inside.sum() < len(inside)
    # soft pairs: at the default weights the inertia would be below the tolerance of their curvature
    compare(
        RobotDynamics(character, LAWS[law], TERRAINS[terrain]),
        nodes,
        rng,
        {"w_self": 1e3, "w_joint": 50.0},
    )


def random_tree(rng, base, bodies=9):
    """Branches, welded and massless bodies, slides, several joints a body, anchors and
    references."""
    made = []
    for b in range(bodies):
        parent = int(rng.integers(max(-1, b - 4), b)) if b > 1 else b - 1
        count = int(rng.choice([0, 1, 1, 2, 3]))
        joints = tuple(random_joint(f"joint{b}_{k}", rng) for k in range(count))
        if b == 0:
            joints = floating_base() if base == "floating" else ()
        rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        shape = rng.standard_normal((3, 3)) * 0.1
        heavy = b in (0, bodies - 1) or rng.uniform() < 0.7
        made.append(
            Body(
                f"body{b}",
                parent,
                joints,
                0.3 * rng.standard_normal(3),
                rotation,
                mass=rng.uniform(0.5, 2.0) if heavy else 0.0,
                com=0.1 * rng.standard_normal(3),
                inertia=shape @ shape.T + 0.01 * np.eye(3) if heavy else np.zeros((3, 3)),
            )
        )
    spheres = tuple(
        ContactSphere(
            f"sphere{k}",
            int(rng.integers(0, bodies)),
            0.2 * rng.standard_normal(3),
            rng.uniform(0.1, 0.3),
            bool(k % 5),
        )
        for k in range(10)
    )
    pairs = tuple(pair for k, pair in enumerate(itertools.combinations(range(10), 2)) if k % 3 == 0)
    return Character("tree", tuple(made), spheres, pairs, base=base)


def random_joint(name, rng):
    axis = rng.standard_normal(3)
    kind = "slide" if rng.uniform() < 0.3 else "hinge"
    lower = rng.uniform(-0.5, 0.2)
    return Joint(
        name,
        kind,
        axis / np.linalg.norm(axis),
        0.2 * rng.standard_normal(3),
        lower,
        lower + 0.3,
        reference=rng.uniform(-0.5, 0.5),
        armature=rng.uniform(0.01, 1.0),
        damping=rng.uniform(),
        stiffness=rng.uniform(),
    )


@pytest.mark.parametrize(
    ("seed", "base"), [(0, "floating"), (1, "fixed"), (2, "floating"), (3, "fixed")]
)
def test_random_trees(seed, base):
    rng = np.random.default_rng(seed)
    character = random_tree(rng, base)
    nodes = trajectory(character, rng)
    assert sink(character, nodes, TERRAINS["hills"]).any()
    law = list(LAWS.values())[seed]
    compare(
        RobotDynamics(character, law, TERRAINS["hills"]),
        nodes,
        rng,
        {"w_self": 1e3, "w_joint": 50.0},
    )


def test_no_contacts_no_pairs():
    rng = np.random.default_rng(5)
    character = dataclasses.replace(CHARACTERS["chain"](), contacts=(), pairs=())
    compare(RobotDynamics(character), trajectory(character, rng), rng)


def test_every_thread_count_gives_the_same_numbers():
    rng = np.random.default_rng(6)
    character = CHARACTERS["chain"]()
    dynamics = RobotDynamics(character)
    nodes = np.concatenate([trajectory(character, rng, count=9) for _ in range(3)])
    p, lam = np.tile(dynamics.layout.pack(), (3, 1)), rng.standard_normal((3, 7, character.nx))
    serial = dynamics.evaluate(nodes, p, lam, order=2)
    for threads in (2, 5, 40):
        for one, other in zip(
            serial, dynamics.evaluate(nodes, p, lam, order=2, threads=threads), strict=True
        ):
            np.testing.assert_array_equal(one, other)
    alone = [
        dynamics.evaluate(nodes[k : k + 1], p[k : k + 1], lam[k : k + 1], order=2)[2][0]
        for k in range(3)
    ]
    np.testing.assert_array_equal(serial[2], np.stack(alone))


def test_a_nan_is_seen():
    character = CHARACTERS["chain"]()
    nodes = trajectory(character, np.random.default_rng(7))
    nodes[0, 2, 3] = np.nan
    dynamics = RobotDynamics(character)
    assert np.isnan(dynamics.evaluate(nodes, dynamics.layout.pack()[None])[0]).any()


def test_user_written_cart_pole():
    """FD of a cart (1 kg) with a pole (0.3 kg, 0.5 m): semi-implicit, coupled through cos and sin
    of x_next."""

    def fd(x_next, x, x_prev, p):
        acceleration = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2
        rate = (x_next - x) / p["dt"]
        c, s = ca.cos(x_next[1]), ca.sin(x_next[1])
        cart = (1.0 + p["pole"]) * acceleration[0] + p["pole"] * 0.5 * (
            acceleration[1] * c - rate[1] ** 2 * s
        )
        pole = p["pole"] * (0.25 * acceleration[1] + 0.5 * acceleration[0] * c + 9.81 * 0.5 * s)
        return ca.vertcat(cart, pole)

    rng = np.random.default_rng(8)
    dynamics = CustomDynamics(fd, 2, [0], {"pole": 0.3})
    compare(dynamics, rng.standard_normal((1, 6, 2)), rng)
    assert "#define NX 2" in dynamics.text()
