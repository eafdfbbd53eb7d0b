"""A robot behind an object: where it begins, how the object is tied to it, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pictures.motions import wandering

import octo
from octo.cli.main import main
from octo.cli.push import object_of, target_of
from octo.cli.solve import with_place
from octo.dynamics.static_pose import balanced_pose
from octo.errors import OctoError, ProblemError, UnknownNameError, UsageError
from octo.goals import Goal
from octo.model.feet import lowest_contacts
from octo.model.kinematics import body_poses, sphere_centers
from octo.problem.compiled import CompiledProblem
from octo.push.kick import Kick
from octo.push.plan import STAGES, Plan
from octo.push.task import Task

MAMMAL = octo.gallery.mammal()
PLACE = (0.9, 0.8)


def task_of(thing: octo.Character, place: tuple[float, float] = PLACE) -> Task:
    return Task.of(octo.Scene(MAMMAL, [thing]), thing.name, place, mu=0.6, dt=0.025)


def plan_of(task: Task) -> Plan:
    """Of a walk as long as the way, that nobody solved: along x, its joints swinging."""
    way, walk = float(np.linalg.norm(task.way)), wandering(MAMMAL, steps=40)
    x = walk.x.copy()
    x[:, 0] = way * np.clip(np.arange(-1, 41) / 40, 0.0, 1.0)
    x[[0, -1]] = x[[1, 1]]
    x[-1, 0] = way
    law = {"contact.w_perp": 3e6, "contact.onset": 2e-3}
    return (Kick if task.rolls else Plan)(task, replace(walk, x=x, parameters=law))


TURNED = octo.objects.box((0.3, 0.2, 0.2), 1.5, (0.5, 0.2, 0.1), (np.cos(0.4), 0, 0, np.sin(0.4)))
BALL = octo.objects.ball(0.1, 0.5, (0.5, 0.2, 0.1))


def test_the_walk_is_behind_the_object_and_never_in_it() -> None:
    task = task_of(TURNED)
    plan = plan_of(task)
    nodes, ahead = plan.nodes, task.way / np.linalg.norm(task.way)
    assert nodes[-1, task.first : task.first + 2] == pytest.approx(PLACE)
    between = nodes[:, task.first : task.first + 2] - nodes[:, :2]
    assert between == pytest.approx(np.broadcast_to(between[0], between.shape))
    assert between[0] == pytest.approx((plan.reach + task.depth) * ahead)
    heading = body_poses(MAMMAL, nodes[:, : MAMMAL.nx])[0][:, MAMMAL.base_body, :2, 0]
    assert (heading[0] / np.linalg.norm(heading[0])) @ ahead == pytest.approx(1.0, abs=1e-6)
    whole, solid = task.scene, task.scene.solids[0]
    rotation, origin = (part[:, solid.body] for part in body_poses(whole, nodes))
    centers = sphere_centers(whole, nodes)[:, list(MAMMAL.own_contacts)]
    local = np.einsum("nij,nci->ncj", rotation, centers - origin[:, None])
    gaps = [[solid.distance(point) for point in row] for row in local]
    radii = np.array([MAMMAL.contacts[k].radius for k in MAMMAL.own_contacts])
    assert (np.array(gaps) - radii).min() > 0.0


def test_a_foot_meets_the_ball_and_nothing_is_in_it_before() -> None:
    task = task_of(BALL)
    plan = plan_of(task)
    assert isinstance(plan, Kick)
    nodes, met, ball = plan.nodes, plan.meeting.node, slice(task.first, task.first + 3)
    assert nodes[-1, ball][:2] == pytest.approx(PLACE)
    assert np.ptp(nodes[: met + 1, ball], axis=0).max() == 0.0
    radii = np.array([contact.radius for contact in MAMMAL.contacts])
    centers = sphere_centers(MAMMAL, nodes[:, : MAMMAL.nx])
    gaps = np.linalg.norm(centers - nodes[:, None, ball], axis=-1) - radii - 0.1
    foot = int(gaps[met].argmin())
    assert foot in lowest_contacts(MAMMAL, task.leaning) and abs(gaps[met, foot]) < 1e-9
    assert gaps[:met].min() > 0.0
    forward = (centers[met + 1, foot] - centers[met - 1, foot])[:2] @ task.way
    assert forward > 0.0 and centers[met, foot, 2] - radii[foot] > 0.04 * task.length
    # it rolls longer than the robot walks, which stands then, half as fast as the foot at most
    assert len(nodes) > 41 and np.ptp(nodes[40:, : MAMMAL.nx], axis=0).max() == 0.0
    speed = np.linalg.norm(nodes[-1, ball] - nodes[-2, ball])
    assert speed <= 0.51 * forward / np.linalg.norm(task.way) / 2.0


def test_a_ball_that_no_foot_can_meet_is_refused() -> None:
    pea = octo.objects.ball(0.003, 0.01, (0.5, 0.2, 0.003))
    with pytest.raises(ProblemError, match="no foot of mammal's walk that may touch the ball"):
        _ = plan_of(task_of(pea)).nodes
    trunk = next(one.name for one in MAMMAL.contacts if MAMMAL.bodies[one.body].name == "trunk")
    given = octo.Scene(MAMMAL, [BALL], contacts=[(trunk, "ball")])
    with pytest.raises(ProblemError, match="that may touch the ball"):
        _ = plan_of(Task.of(given, "ball", PLACE, mu=0.6, dt=0.025)).nodes


def test_a_ball_that_is_kicked_a_little_is_clear_of_the_robot_at_the_end() -> None:
    """The walk is longer than the way of the ball: only its last steps may meet it."""
    far = plan_of(task_of(BALL))
    near = Kick(task_of(BALL, (0.53, 0.2)), far.walk)
    assert isinstance(far, Kick) and near.meeting.node >= far.meeting.node
    radii = np.array([contact.radius for contact in MAMMAL.contacts])
    last, first = near.nodes[-1], near.task.first
    centers = sphere_centers(MAMMAL, last[: MAMMAL.nx])
    assert (np.linalg.norm(centers - last[first : first + 3], axis=-1) - radii).min() > 0.1


@pytest.mark.parametrize("place", [(1.2, 0.3), (0.6, 0.9), (-0.4, 0.2), (0.5, -0.6)])
def test_a_ball_rolls_without_slip_and_without_a_singular_angle(place: tuple[float, float]) -> None:
    task = task_of(BALL, place)
    plan = plan_of(task)
    assert isinstance(plan, Kick)
    nodes, first = plan.nodes[plan.meeting.node :], task.first
    moved, middle = nodes[-1, first : first + 3] - nodes[0, first : first + 3], nodes[:, first + 4]
    assert np.abs(middle).max() == 0.0
    b = task.scene.body_index("ball")
    rotation, origin = (part[:, b] for part in body_poses(task.scene, nodes[:2]))
    low = origin[0] + (0.0, 0.0, -0.1)  # what touches the ground moves across the fast axis alone
    after = rotation[1] @ rotation[0].T @ (low - origin[0]) + origin[1]
    fast = int(np.argmax(np.abs(moved)))
    assert abs((after - low)[fast]) < 0.05 * abs(origin[1, fast] - origin[0, fast]) + 1e-12


def test_the_depth_of_the_object_is_to_its_foremost_corner() -> None:
    assert task_of(BALL).depth == pytest.approx(0.1)
    box = octo.objects.box((0.3, 0.4, 0.2), 1.5, (0.5, 0.2, 0.1))
    assert task_of(box, (1.5, 0.2)).depth == pytest.approx(0.15)
    assert task_of(box, (0.5, -1.0)).depth == pytest.approx(0.2)
    corner = 0.14 * np.sqrt(2.0) + 0.01  # of a rounding of 1 cm
    assert task_of(box, (1.5, 1.2)).depth == pytest.approx(corner + 0.05 / np.sqrt(2.0), abs=1e-4)


def test_the_robot_leans_by_what_friction_takes() -> None:
    task = task_of(octo.objects.box((0.3, 0.4, 0.2), MAMMAL.mass / 3.0, (0.5, 0.0, 0.1)))
    pose, own = task.leaning, balanced_pose(MAMMAL)
    feet = lowest_contacts(MAMMAL, own)
    back = (sphere_centers(MAMMAL, own) - sphere_centers(MAMMAL, pose))[feet]
    wanted = 0.6 / 3.0 * task.length
    assert back[:, 0].mean() == pytest.approx(wanted, abs=2e-3)
    assert np.abs(back[:, 1:]).max() < 2e-3


def test_the_stages_end_with_contact_alone() -> None:
    plan = plan_of(task_of(TURNED))
    (tied, first), (free, last) = plan.model(STAGES[0]), plan.model(STAGES[-1])
    assert [type(one).__name__ for one in tied.elements] == ["SpringDamper"]
    first_apart = plan.nodes[0, plan.task.first : plan.task.first + 3] - plan.nodes[0, :3]
    assert first["spring0.rest_length"] == pytest.approx(np.linalg.norm(first_apart))
    assert not free.elements and last["contact.w_perp"] == 3e6
    touching = {free.contacts[k].name for k, _ in free.touches}
    assert touching == {MAMMAL.contacts[k].name for k in MAMMAL.own_contacts}


def fixed_at_the_end(problem: octo.Problem) -> list[set[str]]:
    """The coordinates that are fixed at the last step but one, and at the last."""
    made = CompiledProblem([problem])
    equal = made.row_bounds[0][0] == made.row_bounds[1][0]  # (N, rows)
    assert not equal[:-2].any() and problem.end is None
    names = [one.name for one in problem.character.joints]
    return [{names[row % len(names)] for row in np.flatnonzero(step)} for step in equal[-2:]]


@pytest.mark.parametrize("thing, at", [(TURNED, "x y yaw"), (BALL, "x y")])
def test_of_the_object_only_its_place_is_fixed_at_the_end(thing: octo.Character, at: str) -> None:
    problem = plan_of(task_of(thing)).problem(STAGES[-1])
    robot = {one.name for one in MAMMAL.joints}
    before, last = fixed_at_the_end(problem)
    assert before == robot
    assert last == robot | {f"{thing.name}_{name}" for name in at.split()}
    place = [term.term.target for term in problem.constraints if term.label == "Place"]
    first = problem.character.first_joint[problem.character.body_index(thing.name)]
    assert place[0][first : first + 2] == pytest.approx(PLACE, abs=1e-6)
    assert ("Tilt" in {term.label for term in problem.costs}) == (thing is TURNED)


def test_the_way_to_the_object_is_found_with_the_object_in_it() -> None:
    """What nobody touches stays: fixed all the same, it would be fixed twice."""
    plan = plan_of(task_of(TURNED))
    begin = plan.problem(STAGES[-1]).start
    nodes = np.tile(begin, (9, 1))
    nodes[:, 0] -= np.linspace(0.05, 0.0, 9)
    way = plan.approach(nodes)
    assert way.steps == 8 and way.start == pytest.approx(nodes[0])
    stands = [term for term in way.constraints if term.label == "Stands"]
    fixed = np.flatnonzero(stands[0].term.coordinates)
    np.testing.assert_array_equal(fixed, np.arange(MAMMAL.nx))
    stays = next(term for term in way.costs if term.label == "Stays")
    assert not set(np.flatnonzero(stays.coordinates)) & set(fixed)
    compiled = CompiledProblem([way])
    at = compiled.evaluate(compiled.unknowns(np.vstack([nodes[:1], nodes])[None]))
    assert at.terms[0, :, way.costs.index(stays)].sum() == pytest.approx(0.0, abs=1e-12)


def test_a_tall_object_falls_over_sooner_and_its_tilt_is_dearer() -> None:
    low, tall = (
        task_of(octo.objects.box((0.3, 0.4, z), 1.5, (0.5, 0.2, z / 2)), (1.5, 0.2))
        for z in (0.3, 0.6)
    )
    assert low.tipping == pytest.approx(np.pi / 4)
    assert tall.tipping == pytest.approx(np.arctan(0.5))
    weight = [
        next(
            term.weight for term in plan_of(task).problem(STAGES[-1]).costs if term.label == "Tilt"
        )
        for task in (low, tall)
    ]
    assert weight[1] / weight[0] == pytest.approx(2.5)  # of 1/sin²


REFUSED = {
    "no object of that name": (lambda: task_of_name("ball"), UnknownNameError, "'ball'"),
    "no way": (lambda: task_of(TURNED, (0.5, 0.2)), ProblemError, "place is where 'box' is"),
    "held": (lambda: task_of(octo.objects.door()), ProblemError, "held by the world"),
    "no robot": (
        lambda: Task.of(octo.Scene(None, [BALL]), "ball", PLACE, 0.6, 0.025),
        ProblemError,
        "no robot that can walk",
    ),
    "no touch": (
        lambda: Task.of(octo.Scene(MAMMAL, [BALL], contacts=[]), "ball", PLACE, 0.6, 0.025),
        ProblemError,
        "touched by nothing",
    ),
    "no scene": (lambda: octo.push(MAMMAL, "box", PLACE), OctoError, "octo.Scene"),
    "two words": (lambda: target_of("box 1"), UsageError, "must be BODY X,Y"),
    "another kind": (lambda: object_of("cone"), UnknownNameError, "object 'cone'"),
    "another size": (lambda: object_of("ball:length=1"), UnknownNameError, "size of object 'ball'"),
}


def task_of_name(name: str) -> Task:
    return Task.of(octo.Scene(MAMMAL, [TURNED]), name, PLACE, 0.6, 0.025)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_pushed_is_refused_in_one_line(name: str) -> None:
    call, kind, words = REFUSED[name]
    with pytest.raises(kind, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "words, said",
    [
        ("--goal push box 1,0", "add --object box"),
        ("--goal push box --object box", "must be BODY X,Y"),
        ("--object box", "--object is to be pushed"),
        ("--goal push box 1,0 --object box --world stairs", "--world does not go with"),
        ("--goal push ball 1,0 --object box", "object 'ball' is not known"),
    ],
)
def test_words_that_do_not_go_with_a_push(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["solve", "mammal", *words.split()]) == 2
    assert said in capsys.readouterr().err


def test_the_words_of_a_push_are_one() -> None:
    words = "solve m --goal push box -1,0 --object box"
    assert with_place(words.split()) == ["solve", "m", "--goal=push box -1,0", "--object", "box"]
    made = object_of("box:mass=2,x=1,height=0.2,name=crate")
    assert made.name == "crate" and made.mass == 2.0
    assert made.start_pose[:3] == pytest.approx((1.0, 0.0, 0.1))


def test_the_goal_is_where_the_object_ends() -> None:
    plan = plan_of(task_of(TURNED))
    scene, nodes = plan.task.scene, plan.nodes
    x = np.concatenate([nodes[:1], nodes])
    motion = replace(plan.walk, character=scene, x=x, u=plan.walk.u)
    goal = Goal("push", place=PLACE, body="box")
    assert goal.met(motion) and goal.error(motion) < 1e-6
    missed = Goal("push", place=(0.9, 0.83), body="box")
    assert not missed.met(motion) and missed.asked(motion).off == pytest.approx(0.03)
