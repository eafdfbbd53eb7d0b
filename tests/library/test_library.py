"""Libraries: many solves as batches over executors, gone on from, found again, in one file."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from carts import way, ways

import octo
from octo.errors import OctoError

NAME = "Place.place"


def one() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)


@pytest.fixture(scope="module")
def library() -> octo.Library:
    return octo.library(ways(), executor=one(), batch=2, gains=True)


def test_each_motion_is_that_of_its_problem(library: octo.Library) -> None:
    assert library.share == 1.0 and len(library) == 5 and not library.interrupted
    np.testing.assert_array_equal(library.problems, np.arange(5))
    assert list(library.commands) == [NAME]
    np.testing.assert_allclose(library.commands[NAME][:, 0], np.linspace(0.2, 1.0, 5))
    for problem, motion, gains in zip(ways(), library, library.gains, strict=True):
        alone = octo.solve(problem)
        np.testing.assert_allclose(motion.x, alone.x, atol=1e-6)
        np.testing.assert_allclose(gains, octo.gains(problem, motion), rtol=1e-9)
    assert library.x.shape == (5, 32, 2) and library.v.shape == (5, 31, 2)
    assert "5 motions of custom" in str(library) and "Place.place 0.2…1" in str(library)


def test_a_notebook_shows_a_table(library: octo.Library) -> None:
    assert "library of 5 motions of custom" in library._repr_html_()


def test_whatever_differs_is_a_command() -> None:
    second = way(0.2, x0=np.array([0.1, 0.0]), parameters={"length": 0.6}, dt=0.04)
    made = octo.library([way(0.2), second], executor=one(), max_iterations=2)
    assert set(made.commands) == {"x0", "length", "dt"}
    np.testing.assert_array_equal(made.commands["x0"], [[0.0, 0.0], [0.1, 0.0]])
    assert made.command(1)["length"] == 0.6


def test_nearest(library: octo.Library) -> None:
    assert library.nearest({NAME: [0.63]}) is library[2]
    assert library.nearest(way(0.97)) is library[4]
    assert library.order(way(0.97)).tolist() == [4, 3, 2, 1, 0]
    failed = replace(library[4], status=octo.Status.STALLED)
    fewer = replace(library, motions=(*library.motions[:4], failed))
    assert fewer.nearest(way(0.97)) is library[3] and fewer.share == 0.8
    assert library.nearest({}) is library[0]


def test_a_command_that_varies_little_counts_as_much_as_one_that_varies_a_lot() -> None:
    """Each number is in parts of its own spread."""
    pairs = [(0.2, 0.5), (0.21, 0.5), (0.2, 0.9), (0.21, 0.9)]
    problems = [way(place, parameters={"length": length}) for place, length in pairs]
    made = octo.library(problems, executor=one())
    assert made.nearest({NAME: [0.2098], "length": 0.6}) is made[1]
    assert made.nearest({"length": 0.8, NAME: [0.2003]}) is made[2]


def test_the_file_is_numpys_and_makes_the_same_library(library: octo.Library, tmp_path) -> None:
    # one of the motions has another number of iterations than the others
    mixed = replace(library, motions=(*library.motions[:4], octo.solve(way(1.0), max_iterations=2)))
    mixed.save(tmp_path / "ways.npz")
    with np.load(tmp_path / "ways.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    shapes = {"x": (5, 32, 2), "v": (5, 31, 2), "u": (5, 30, 1), "gains": (5, 30, 1, 4)}
    shapes |= {"contact_force": (5, 30, 0, 3), "terms": (5, 2), "status": (5,)}
    shapes |= {"converged": (5,), "iterations": (5,), f"command_{NAME}": (5, 1)}
    assert {name: arrays[name].shape for name in shapes} == shapes
    assert arrays["term_names"].tolist() == ["Place", "Effort"]
    np.testing.assert_allclose(arrays["terms"].sum(axis=1), [m.energy for m in mixed])
    assert arrays["status"].tolist() == ["converged"] * 4 + ["iteration_limit"]
    again = octo.Library.load(tmp_path / "ways.npz")
    assert str(again) == str(mixed)
    for a, b in zip(again, mixed, strict=True):
        assert a.report() == b.report()
        for name in ("x", "u", "unknowns", "multipliers"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.history.keys() == b.history.keys()
        np.testing.assert_array_equal(a.history["energy"], b.history["energy"])
    np.testing.assert_array_equal(again.gains, mixed.gains)
    assert octo.solve(way(0.8), start=again.nearest(way(0.8))).iterations <= 2


def test_a_robots_file_too(tmp_path) -> None:
    robot = octo.gallery.biped()
    problems = [
        octo.Problem(robot, steps=4, dt=0.02, costs=octo.costs.paper((v, 0.0, 0.0)))
        for v in (0.1, 0.2)
    ]
    made = octo.library(problems, executor=one(), passes=1, max_iterations=1)
    made.save(tmp_path / "steps.npz")
    again = octo.Library.load(tmp_path / "steps.npz")
    assert again[1].character.nx == robot.nx and again[0].character is again[1].character
    np.testing.assert_array_equal(again[1].contact_force, made[1].contact_force)
    assert set(again[0].ground) == {"x", "y", "z"}


def test_a_solve_that_failed_is_kept_as_what_it_is(tmp_path) -> None:
    far = way(0.5, x0=np.array([1e200, 0.0]))
    made = octo.library([way(0.2), far], executor=one(), max_iterations=9)
    made.save(tmp_path / "two.npz")
    again = octo.Library.load(tmp_path / "two.npz")
    assert [motion.status.label for motion in again] == ["converged", "not_finite"]
    assert again.share == 0.5 and again.nearest(way(0.5)) is again[0]


def test_starts_and_seeds(library: octo.Library) -> None:
    again = octo.library(ways(), executor=one(), batch=3, start=list(library))
    assert again.iterations.max() <= 2
    one_for_all = octo.library(ways(), executor=one(), start=library[2])
    assert one_for_all.iterations[2] <= 2
    several = octo.library(ways(2), executor=one(), seeds=2, seed=3)
    assert {motion.seed for motion in several} <= {3, 4}


# -- gone on from, stopped -------------------------------------------------------------------------


class Counting(ThreadPoolExecutor):
    """How many batches were sent."""

    def __init__(self) -> None:
        super().__init__(1)
        self.sent = 0

    def submit(self, function, /, *given, **named) -> Future:
        self.sent += 1
        return super().submit(function, *given, **named)


class Interrupted(ThreadPoolExecutor):
    """Ctrl-C once a number of batches are finished."""

    def __init__(self, after: int) -> None:
        super().__init__(1)
        self.after = after

    def submit(self, function, /, *given, **named) -> Future:
        if self.after == 0:
            raise KeyboardInterrupt
        self.after -= 1
        future: Future = Future()
        future.set_result(function(*given, **named))
        return future


def test_a_folder_is_gone_on_from(tmp_path, capsys) -> None:
    how = {"batch": 2, "folder": tmp_path / "ways"}
    first = octo.library(ways(), executor=Interrupted(1), **how)
    assert first.interrupted and first.problems.tolist() == [0, 1]
    assert len(first.commands[NAME]) == 2 and "interrupted" in str(first)
    second = Counting()
    whole = octo.library(ways(), executor=second, progress="ways", **how)
    assert second.sent == 2 and len(whole) == 5 and not whole.interrupted
    assert "ways: 5 of 5 problems, 5 converged" in capsys.readouterr().err
    third = Counting()
    assert str(octo.library(ways(), executor=third, **how)) == str(whole) and third.sent == 0
    np.testing.assert_array_equal(whole[0].x, first[0].x)


def test_ctrl_c_before_anything_is_finished_is_ctrl_c() -> None:
    with pytest.raises(KeyboardInterrupt):
        octo.library(ways(), executor=Interrupted(0))


OTHERS = [
    (ways(4), {}, "count of problems is 5 there and 4 here"),
    (ways(dt=0.04), {}, "dt is not the same"),
    (ways(steps=20), {}, "steps is 30 there and 20 here"),
    ([way(p) for p in (0.2, 0.4, 0.6, 0.8, 1.1)], {}, "Place.place is not the same"),
    (ways(), {"batch": 3}, "batch is 2 there and 3 here"),
    (ways(), {"seed": 1}, "seed is 0 there and 1 here"),
    (ways(), {"gains": True}, "gains is False there and True here"),
    (ways(), {"start": np.zeros((31, 2))}, "start is not the same"),
    (ways(), {"max_iterations": 7}, "max_iterations is 5 there and 7 here"),
]


@pytest.mark.parametrize(("problems", "given", "words"), OTHERS, ids=[o[2] for o in OTHERS])
def test_a_folder_of_other_problems_is_refused_by_name(tmp_path, problems, given, words) -> None:
    how = {"batch": 2, "folder": tmp_path, "max_iterations": 5}
    octo.library(ways(), executor=Interrupted(1), **how)
    with pytest.raises(OctoError) as error:
        octo.library(problems, executor=one(), **{**how, **given})
    assert words in str(error.value) and str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


# -- in processes ----------------------------------------------------------------------------------

SCRIPT = """
import sys
sys.path.insert(0, {here!r})
import octo
from carts import ways

if __name__ == "__main__":
    made = octo.library(ways(), batch=2, folder={folder!r}, progress=True)
    print(made.interrupted, made.problems.tolist(), made.share)
"""


def script(tmp_path: Path, environment: dict[str, str], text: str = SCRIPT) -> subprocess.Popen:
    here = str(Path(__file__).parents[1])
    file = tmp_path / "script.py"
    file.write_text(text.format(here=here, folder=str(tmp_path / "ways")))
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, str(file)], env=environment, **pipes)


@pytest.mark.slow
def test_in_processes_of_its_own(tmp_path, plain_environment) -> None:
    out, err = script(tmp_path, plain_environment).communicate(timeout=300)
    assert out == "False [0, 1, 2, 3, 4] 1.0\n", err
    assert (tmp_path / "ways" / "batch-0002.npz").exists()


def test_a_script_without_its_guard_is_told_so(tmp_path, plain_environment) -> None:
    text = SCRIPT.replace('if __name__ == "__main__":', "if True:")
    _, err = script(tmp_path, plain_environment, text).communicate(timeout=300)
    assert "call octo.library under if __name__ == '__main__':" in err


def test_ctrl_c_keeps_what_was_finished(tmp_path, plain_environment) -> None:
    """A signal to the process that asks reaches those that work: they stop at once."""
    text = SCRIPT.replace("ways()", "ways(400, steps=600)")
    with script(tmp_path, plain_environment, text) as running:
        folder, end = tmp_path / "ways", time.monotonic() + 300
        while not list(folder.glob("batch-*.npz")) and time.monotonic() < end:
            time.sleep(0.05)
            assert running.poll() is None, running.stderr.read()
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=60)
    interrupted, *_ = out.split()
    assert interrupted == "True" and "Traceback" not in err, err
    kept = len(list(folder.glob("batch-*.npz")))
    assert 1 <= kept < 200 and f"{2 * kept} of 400 problems" in err


# -- refused ---------------------------------------------------------------------------------------


def worker_fails(monkeypatch) -> None:
    """The third problem cannot be solved where it is sent."""
    from octo.library import work

    real = work.solve

    def solve(problem, **how):
        several = problem if isinstance(problem, list) else [problem]
        if any(abs(own.costs[0].values["place"] - 0.6) < 1e-9 for own in several):
            raise RuntimeError("the machine is on fire")
        return real(problem, **how)

    monkeypatch.setattr(work, "solve", solve)


@pytest.mark.parametrize("batch", [1, 4])
def test_a_workers_error_names_its_problem(monkeypatch, tmp_path, batch: int) -> None:
    worker_fails(monkeypatch)
    with pytest.raises(OctoError, match="^problem 2: RuntimeError: the machine is on fire$"):
        octo.library(ways(), executor=one(), batch=batch, folder=tmp_path)
    kept = sorted(file.name for file in tmp_path.glob("batch-*.npz"))
    assert kept == (["batch-0000.npz", "batch-0001.npz"] if batch == 1 else [])


def unsendable() -> octo.Problem:
    return way(0.5).replace(costs=[octo.CustomCost(lambda step, p: step.x_next, {})])


class Client:
    """Of Dask, whose futures are of a kind of their own."""

    def submit(self, function, task):
        return object()


class Broken(ThreadPoolExecutor):
    def submit(self, function, /, *given, **named) -> Future:
        raise BrokenExecutor("gone")


def damaged(folder: Path) -> Path:
    (folder / "library.json").write_text("[")
    return folder


REFUSED = [
    (lambda t: octo.library(3), "not given a list"),
    (lambda t: octo.library(way(0.2)), "not given a list"),
    (lambda t: octo.library([]), "is empty"),
    (lambda t: octo.library([way(0.2), 3]), "problem 1 is an int"),
    (lambda t: octo.library([way(0.2), way(0.2, steps=20)]), "steps differ between problems"),
    (lambda t: octo.library(ways(), batch=0), "batch is 0"),
    (lambda t: octo.library(ways(), gains=1), "gains is 1"),
    (lambda t: octo.library(ways(), executor=3), "executor is 3, must be a concurrent"),
    (lambda t: octo.library(ways(), executor=Client()), "executor.submit returned an object"),
    (lambda t: octo.library(ways(), executor=Broken()), "the processes ended before their work"),
    (lambda t: octo.library(ways(), callback=print), "callback is given"),
    (lambda t: octo.library(ways(), device="tpu"), "tpu"),
    (lambda t: octo.library(ways(), start=[None]), "start has shape (1,)"),
    (lambda t: octo.library(ways(), colour=3), "option of octo.library 'colour'"),
    (lambda t: octo.library([unsendable()]), "problem 0 cannot be sent to another process"),
    (lambda t: octo.library(ways(), folder=damaged(t)), "is not a record of a library"),
    (lambda t: octo.Library.load(t / "nowhere.npz"), "does not exist"),
    (lambda t: octo.library(ways(1), executor=one()).save("a.txt"), "must end in .npz"),
    (
        lambda t: octo.library(
            [way(0.2, cycle=None, duration=(1.0, 2.0))], gains=True, executor=one()
        ),
        "duration",
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_refused_in_one_line(call, words: str, tmp_path) -> None:
    with pytest.raises(OctoError) as error:
        call(tmp_path)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (3, "command is 3, must be an octo.Problem or numbers by name"),
        ({"Place": 1.0}, "command 'Place' is not known; did you mean Place.place?"),
        ({NAME: [1.0, 2.0]}, "Place.place has shape (2,), expected (1,)"),
    ],
)
def test_commands_that_it_has_not(library: octo.Library, command, words: str) -> None:
    with pytest.raises(OctoError) as error:
        library.nearest(command)
    assert words in str(error.value)
    none = replace(library, motions=tuple(replace(m, status=octo.Status.STALLED) for m in library))
    with pytest.raises(OctoError, match="no motion of the library converged"):
        none.nearest({NAME: [0.5]})


@pytest.mark.parametrize("name", ["x", "plain", "shapes_history_energy", "problems", "gains"])
def test_a_damaged_file_is_one_line(library: octo.Library, tmp_path, name: str) -> None:
    mixed = replace(library, motions=(*library.motions[:4], octo.solve(way(1.0), max_iterations=2)))
    mixed.save(tmp_path / "ways.npz")
    with np.load(tmp_path / "ways.npz") as file:
        arrays = {key: file[key] for key in file.files}
    plain = json.loads(str(arrays["plain"]))
    plain["each"] = []
    arrays[name] = np.array(json.dumps(plain)) if name == "plain" else arrays[name][:2]
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(OctoError) as error:
        octo.Library.load(tmp_path / "bad.npz")
    assert "bad.npz is not a library" in str(error.value) and "\n" not in str(error.value)
