"""A transition that is told a command: what it learns of a library, and what it is as a start."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from carts import way, ways

import octo
from octo import learn
from octo.errors import OctoError
from octo.learn.losses import LOSSES
from octo.learn.training import beside, pieces
from octo.problem.compiled import CompiledProblem

NAME = "Place.place"
BASES = ("nodes", "hermite")


def own(place: float, basis: str = "nodes", **fields: object) -> octo.Problem:
    return way(place, basis=basis, **fields)


@lru_cache
def library(basis: str = "nodes") -> octo.Library:
    return octo.library(ways(9, basis=basis), executor=ThreadPoolExecutor(1), batch=9)


def told(**fields: object) -> learn.Transition:
    return learn.Transition(**{"hidden": (16, 16), "command": (NAME,), **fields})


@lru_cache
def trained(basis: str = "nodes") -> learn.Transition:
    how = {"loss": "recurrent", "iterations": 400, "decay": 1e-4}
    return learn.train(told(), library(basis), **how).transition


def random(of: learn.Transition, seed: int = 0) -> learn.Transition:
    """With weights of order one."""
    return of.with_weights(0.4 * np.random.default_rng(seed).standard_normal(of.network.count))


# -- as a network ----------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", LOSSES)
def test_gradient_with_respect_to_the_weights(loss: str) -> None:
    """The remainder of a Taylor series falls with the square of the step."""
    of, made = random(told().started(library())), np.random.default_rng(1)
    controls = 0.2 * np.cumsum(made.standard_normal((3, 6, 4)), axis=1)
    commands = made.standard_normal((3, 1))
    f = LOSSES[loss](of.network, of.frame, controls, commands)
    w, along = of.weights, made.standard_normal(of.network.count)
    value, gradient = f(w)
    steps = 1e-3 * 0.5 ** np.arange(5)
    remainder = [abs(f(w + h * along)[0] - value - h * (gradient @ along)) for h in steps]
    slope = np.diff(np.log(remainder)) / np.diff(np.log(steps))
    assert abs(slope[-1] - 2.0) < 0.05, slope


@pytest.mark.parametrize("loss", LOSSES)
def test_of_one_command_it_is_the_network_of_that_command(loss: str) -> None:
    """A loss with commands is the mean of those of each motion with the biases of its command."""
    of, made = random(told().started(library())), np.random.default_rng(2)
    controls = 0.2 * made.standard_normal((2, 5, 4))
    places = np.array([0.3, 0.9])
    commands = ((places - of.fit.command_center) / of.fit.command_size)[:, None]
    whole, _ = LOSSES[loss](of.network, of.frame, controls, commands)(of.weights)
    alone = []
    for place, c in zip(places.tolist(), controls, strict=True):
        one = of.at(own(place))
        assert one.command == () and one.network.sizes[0] == of.network.sizes[0] - 1
        alone.append(LOSSES[loss](one.network, one.frame, c[None])(one.weights)[0])
    np.testing.assert_allclose(whole, np.mean(alone), rtol=1e-12)


def test_commands_are_seen_by_how_much_they_differ() -> None:
    of = told().started(library())
    np.testing.assert_allclose(of.fit.command_center, [0.6])
    np.testing.assert_allclose(of.fit.command_size, np.linspace(0.2, 1.0, 9).std())
    np.testing.assert_array_equal(of.fit.center, own(0.2).start)
    alone = told().started(own(0.7))
    np.testing.assert_allclose(alone.fit.command_center, [0.7])
    np.testing.assert_allclose(alone.fit.command_size, [1.0])
    for basis in BASES:  # a library says the same of the rest as a problem does
        a, b = (told().started(one).fit for one in (library(basis), own(0.7, basis)))
        assert (a.robot, a.basis, a.heading) == (b.robot, b.basis, b.heading)
        np.testing.assert_allclose(a.seconds, b.seconds)


def test_a_robots_library_says_of_its_state_what_a_problem_says() -> None:
    robot = octo.gallery.biped()
    problems = [
        octo.Problem(robot, steps=20, dt=0.02, costs=octo.costs.paper((v, 0, 0)), basis="hermite")
        for v in (0.1, 0.2)
    ]
    made = octo.library(problems, executor=ThreadPoolExecutor(1), passes=1, max_iterations=1)
    at = made[0].parameters
    own = problems[0].replace(parameters={k: at[k] for k in at if k.startswith("contact.")})
    name = "CenterOfMassVelocity.velocity"
    a, b = (learn.Transition(command=(name,)).started(one).fit for one in (made, own))
    assert a.heading == b.heading and a.basis == b.basis == "hermite"
    np.testing.assert_allclose(a.size, b.size, rtol=1e-9)
    np.testing.assert_allclose(a.center, b.center, atol=1e-9)
    np.testing.assert_allclose(a.command_center, [0.15, 0.0, 0.0])
    np.testing.assert_allclose(a.command_size, [0.05, 1.0, 1.0])


def test_pieces_keep_their_commands() -> None:
    given = np.arange(3 * 7 * 4.0).reshape(3, 7, 4)
    frame = told().started(library()).frame
    made = beside(pieces(given, 2), frame, 0.1)
    assert len(made) % 3 == 0
    place = np.repeat(np.arange(3), len(made) // 3)
    np.testing.assert_array_equal(made[:, 1, 0] // 28, place)


def test_a_file_holds_the_command(tmp_path) -> None:
    of = trained()
    of.save(tmp_path / "ways.npz")
    again = learn.Transition.load(tmp_path / "ways.npz")
    assert again.command == (NAME,) and repr(again) == repr(of) and NAME in repr(again)
    np.testing.assert_array_equal(again.start_of(own(0.5)), of.start_of(own(0.5)))


def test_a_file_of_before_there_were_commands(tmp_path) -> None:
    learn.Transition(hidden=(4,)).started(own(0.5)).save(tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as file:
        arrays = {k: file[k] for k in file.files if not k.startswith("command")}
    arrays["plain"] = np.array(str(arrays["plain"]).replace('"command": [], ', ""))
    assert "command" not in str(arrays["plain"])
    np.savez(tmp_path / "old.npz", **arrays)
    learn.Transition.load(tmp_path / "old.npz").check(own(0.5))


# -- as a start ------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", BASES)
def test_it_is_near_what_it_was_not_shown(basis: str) -> None:
    """Unrolled from the problem's start it is near the motion, which the default start, that stays
    where it is, is not; and the motion that comes of it is the same."""
    for place in (0.35, 0.75):
        problem = own(place, basis)
        motion, guess = octo.solve(problem), trained(basis).start_of(problem)
        assert guess.shape == (31, 2)
        np.testing.assert_allclose(guess[0], problem.start, atol=1e-12)
        off = np.sqrt(np.mean((guess - motion.x[1:]) ** 2))
        assert off < 0.3 * np.sqrt(np.mean(motion.x[1:] ** 2))
        found = octo.solve(problem, start=trained(basis))
        assert found.converged
        np.testing.assert_allclose(found.energy, motion.energy, rtol=1e-4)


@pytest.mark.parametrize("basis", BASES)
def test_what_it_says_is_where_the_solver_begins(basis: str) -> None:
    """Controls, and a start that moves."""
    of = random(told(hidden=(5,)).started(library(basis)))
    problem = own(0.4, basis, v0=np.array([0.3, -0.2]))
    nodes = of.start_of(problem)
    begun = octo.solve(problem, start=nodes, max_iterations=1)
    same = octo.solve(problem, start=of, max_iterations=1)
    np.testing.assert_array_equal(begun.x, same.x)
    one, c = of.at(problem), np.array([0.0, 0.0, 0.3, -0.2])
    c[2:] *= 0.05 * (10 if basis == "hermite" else 1)
    made, n = [c], len(nodes) // (10 if basis == "hermite" else 1)
    for _ in range(n - (basis == "nodes")):
        made.append(one.next(made[-1]))
    every = 10 if basis == "hermite" else 1
    np.testing.assert_allclose(nodes[::every], np.array(made)[:, :2], atol=1e-12)
    if basis == "hermite":
        compiled = CompiledProblem([problem])
        full = np.vstack([problem.start - 0.05 * problem.start_velocity, nodes])
        found = compiled.unknowns(full[None])[0]
        np.testing.assert_allclose(found[:-1], made[1:], atol=1e-9)


def test_of_several_problems_each_has_its_own() -> None:
    problems = [own(0.3), own(0.8)]
    both = octo.solve(problems, start=trained(), max_iterations=1)
    for problem, motion in zip(problems, both, strict=True):
        alone = octo.solve(problem, start=trained(), max_iterations=1)
        np.testing.assert_allclose(motion.x, alone.x, atol=1e-9)
    mixed = octo.solve(problems, start=[None, trained()], max_iterations=1)
    np.testing.assert_allclose(mixed[1].x, both[1].x, atol=1e-9)
    more = octo.library(problems, start=trained(), executor=ThreadPoolExecutor(1), max_iterations=1)
    np.testing.assert_allclose(more[1].x, both[1].x, atol=1e-9)


def test_without_a_command_it_is_a_start_too() -> None:
    motion = octo.solve(own(0.5))
    of = learn.Transition(hidden=(12,)).started(own(0.5))
    of = learn.train(of, motion, loss="recurrent", iterations=200).transition
    assert octo.solve(own(0.5), start=of).converged
    assert learn.train(learn.Transition(hidden=(4,)), library(), iterations=2).iterations == 2


# -- refused ---------------------------------------------------------------------------------------


def explodes() -> learn.Transition:
    of = told(hidden=(4,), activation="softplus").started(library())
    return of.with_weights(np.full(of.network.count, 1e30))


def no_term() -> octo.Problem:
    return own(0.5).replace(costs=[octo.Effort(reference=1.0)])


def nothing_converged() -> octo.Library:
    failed = tuple(replace(motion, status=octo.Status.STALLED) for motion in library())
    return replace(library(), motions=failed)


def over_time() -> octo.Problem:
    term = octo.CustomCost(way(0.5).costs[0].function, {"place": np.ones((30, 1))}, name="Place")
    return own(0.5).replace(costs=[term])


REFUSED = [
    (lambda: octo.solve(no_term(), start=trained()), "command 'Place.place' is not known"),
    (lambda: octo.solve(own(0.5, "hermite"), start=trained()), "basis is 'nodes', the problem's"),
    (lambda: octo.solve(own(0.5, dt=0.04), start=trained()), "is of 0.05 s, from one control"),
    (lambda: octo.solve(own(0.5), start=explodes()), "start is a transition that explodes"),
    (lambda: octo.solve(own(0.5), start=told()), "has no weights yet"),
    (lambda: octo.solve(over_time(), start=trained()), "Place.place has shape (30, 1)"),
    (lambda: octo.solve(octo.phases([own(0.5), own(0.5, x0=None)]), start=trained()), "phases"),
    (lambda: learn.train(told(), library()[0]), "asks for the command Place.place"),
    (lambda: learn.train(told(command=("Speed",)), library()), "command 'Speed' is not known"),
    (lambda: learn.train(told(), nothing_converged()), "no motion of the library converged"),
    (lambda: learn.train(learn.Transition(), library()[0]), "has no weights yet"),
    (lambda: learn.train(3, library()), "transition is 3, must be"),
    (lambda: learn.solve(own(0.5), told()), "command is ('Place.place',), must be left out"),
    (lambda: learn.Markovian(transition=trained()), "take transition.at(problem)"),
    (lambda: trained().unroll(np.zeros(4), 3), "take transition.at(problem)"),
    (lambda: trained().residual(np.zeros(4), np.zeros(4)), "take transition.at(problem)"),
    (lambda: learn.Transition(command="Place.place"), "must be a tuple of names"),
    (lambda: learn.Transition(command=(3,)), "must be a tuple of names"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_refused_in_one_line(call, words: str) -> None:
    with pytest.raises(OctoError) as error:
        call()
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["command_size", "command_center", "plain"])
def test_a_damaged_file_is_one_line(tmp_path, name: str) -> None:
    trained().save(tmp_path / "ways.npz")
    with np.load(tmp_path / "ways.npz") as file:
        arrays = {k: file[k] for k in file.files}
    plain = str(arrays["plain"]).replace('["Place.place"]', "[]")
    arrays[name] = np.array(plain) if name == "plain" else np.array([-1.0, 2.0])
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(OctoError) as error:
        learn.Transition.load(tmp_path / "bad.npz")
    assert "bad.npz is not a transition" in str(error.value) and "\n" not in str(error.value)
