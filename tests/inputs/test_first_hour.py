"""What a new user types first, right and wrong: the next step is in the message, and nothing floods
the screen."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import octo
from octo.errors import OctoError, said

CHAIN = octo.gallery.chain()
MAMMAL = octo.gallery.mammal()


def described(**changes: Any) -> octo.Problem:
    return octo.Problem(CHAIN, **{"steps": 6, "dt": 0.02, "costs": [octo.Effort()], **changes})


@pytest.fixture(scope="module")
def solution() -> octo.Solution:
    return octo.solve(described(), passes=1, max_iterations=3)


def any_call(name: str) -> Callable[..., Any]:
    return getattr(octo, name)  # type: ignore[no-any-return]


WRONG: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "an option of solve": (
        lambda: any_call("solve")(described(), pases=2),
        ("octo.solve", "'pases'", "passes"),
    ),
    "another": (
        lambda: any_call("solve")(described(), max_iteration=2),
        ("'max_iteration'", "max_iterations"),
    ),
    "an option of walk": (
        lambda: any_call("walk")(MAMMAL, devise="cpu"),
        ("octo.walk", "'devise'", "device"),
    ),
    "an option of turn": (
        lambda: any_call("turn")(MAMMAL, rates=1.0),
        ("octo.turn", "'rates'", "rate"),
    ),
    "an option of stride": (
        lambda: any_call("stride")(MAMMAL, sped=1.0),
        ("octo.stride", "'sped'", "speed"),
    ),
    "an option of jump": (
        lambda: any_call("jump")(MAMMAL, hight=0.2),
        ("octo.jump", "'hight'", "height"),
    ),
    "a field of a problem": (
        lambda: any_call("Problem")(CHAIN, step=6, dt=0.02, costs=[octo.Effort()]),
        ("octo.Problem", "'step'", "steps"),
    ),
    "a robot for a problem": (
        lambda: any_call("solve")(CHAIN),
        ("octo.Problem(", "octo.walk(robot)", "is missing"),
    ),
    "a file for a problem": (lambda: any_call("solve")("go2.urdf"), ("'go2.urdf'", "octo.Problem")),
    "nothing": (lambda: any_call("solve")(), ("octo.solve", "'problem'")),
    "no terms": (lambda: any_call("Problem")(CHAIN, steps=6, dt=0.02), ("octo.Problem", "'costs'")),
    "an option twice": (lambda: any_call("walk")(MAMMAL, 0.5, speed=0.4), ("octo.walk", "'speed'")),
    "too many": (lambda: any_call("solve")(described(), 3), ("octo.solve", "too many")),
    "a problem to walk": (
        lambda: any_call("walk")(described()),
        ("robot is a Problem", "octo.load"),
    ),
    "a robot as terrain": (lambda: described(terrain=MAMMAL), ("terrain is a Character",)),
    "a robot as terms": (lambda: described(costs=MAMMAL), ("costs is a Character",)),
    "a robot among terms": (lambda: described(costs=[MAMMAL]), ("costs holds a Character",)),
    "a robot as speed": (lambda: any_call("walk")(MAMMAL, MAMMAL), ("speed is a Character",)),
    "a problem as cycle": (lambda: described(cycle=described()), ("cycle is a Problem",)),
    "a robot as device": (
        lambda: any_call("solve")(described(), device=MAMMAL),
        ("device a Character",),
    ),
    "a long number as device": (
        lambda: any_call("solve")(described(), device=10**5000),
        ("16610 bits",),
    ),
    "a long word as device": (
        lambda: any_call("solve")(described(), device="cpu" * 10**6),
        ("device 'cpu",),
    ),
    "a robot as law": (lambda: described(law=MAMMAL), ("law is a Character",)),
    "robots as a batch": (
        lambda: any_call("solve")([CHAIN, CHAIN]),
        ("octo.solve", "a list of them"),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_one_line_says_what_to_do(name: str) -> None:
    call, fragments = WRONG[name]
    with pytest.raises(OctoError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 400, message
    assert "Body(" not in message and "array(" not in message
    for fragment in fragments:
        assert fragment in message


@pytest.mark.parametrize("name", ["solve", "walk", "stride", "turn", "jump"])
def test_the_options_are_in_the_signature(name: str) -> None:
    parameters = inspect.signature(getattr(octo, name)).parameters
    assert not any(p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL) for p in parameters.values())
    assert {"device", "threads", "max_iterations", "time_limit", "progress", "callback"} <= set(
        parameters
    )
    assert all(p.annotation is not p.empty for p in parameters.values())


@pytest.mark.parametrize(
    "robot", [CHAIN, MAMMAL, octo.gallery.humanoid()], ids=lambda robot: robot.name
)
def test_robots_and_problems_are_a_few_lines(robot: octo.Character) -> None:
    problem = octo.Problem(robot, steps=6, dt=0.02, costs=octo.costs.natural(length=0.3))
    for words in (repr(robot), repr(problem), repr([robot, problem])[:400]):
        assert robot.name in words
    for words in (repr(robot), repr(problem)):
        assert 2 <= len(words.splitlines()) <= 5 and max(map(len, words.splitlines())) <= 120
    assert f"{robot.nx} coordinates" in repr(robot) and "6 steps of 0.02 s" in repr(problem)


def test_a_problem_of_the_users_dynamics_is_a_few_lines() -> None:
    ball = octo.CustomDynamics(
        lambda after, now, before, p: after - now, nx=1, actuated=[0], parameters={}
    )
    problem = octo.Problem(ball, steps=4, dt=0.1, costs=[octo.Effort()], x0=np.zeros(1))
    assert "user's dynamics" in repr(problem) and len(repr(problem).splitlines()) <= 5


def test_a_solution_is_what_print_says(solution: octo.Solution) -> None:
    assert repr(solution) == str(solution)
    assert len(repr(solution).splitlines()) <= 5
    assert "on cpu" in str(solution) and solution.report()["device"] == "cpu"


def test_the_library_says_the_device_in_its_log_only(
    caplog: pytest.LogCaptureFixture,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import sys

    front = sys.modules["octo.devices"]
    monkeypatch.setattr(front.cuda, "reason", lambda: "there is none")
    front.say_cpu.cache_clear()
    with caplog.at_level(logging.INFO, logger="octo"):
        octo.solve(described(), passes=1, max_iterations=1)
    assert caplog.messages == ["using the CPU: there is none"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (CHAIN, "a Character"),
        ([CHAIN], "a list"),
        (1.5, "1.5"),
        ("fast", "'fast'"),
        (None, "None"),
        ((1, 2), "(1, 2)"),
        (np.zeros((3, 4)), "an array of shape (3, 4)"),
        (10**5000, "a number of 16610 bits"),
        ({"a": CHAIN}, "a dict"),
        ({"a": 1}, "{'a': 1}"),
        ([10**5000], "a list with a number of more digits than can be written"),
        (np.array(CHAIN, dtype=object), "an array of shape ()"),
        (np.float64(2.0), "np.float64(2.0)"),
        (octo.Effort(), "an Effort"),
    ],
    ids=range(14),
)
def test_how_a_message_quotes_a_value(value: object, words: str) -> None:
    assert said(value) == words


def test_long_values_are_cut() -> None:
    assert len(said("x" * 10_000)) == 60 and len(said(list(range(10_000)))) == 60


def test_pages_and_figures_are_returned(solution: octo.Solution, tmp_path: Any) -> None:
    pytest.importorskip("viser")
    page = octo.view(solution)
    assert (
        page.path is None
        and page.text.lower().startswith("<!doctype html>")
        and len(repr(page)) < 100
    )
    page.save(tmp_path / "motion.html")
    assert (tmp_path / "motion.html").read_text() == page.text and "motion.html" in repr(page)
    assert octo.plot(solution)._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_a_table_without_pictures(solution: octo.Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra 'view' a notebook has the table alone; a motion of no bodies has no
    picture."""
    import sys

    assert "<img" in CHAIN._repr_html_()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "octo.figure", raising=False)
    for value in (CHAIN, described(), solution):
        assert value._repr_html_().startswith("<table>") and "<img" not in value._repr_html_()
