"""A graph of motions that stand with their knees bent more and less: small, and all that is asked
of a large one holds of it."""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from standing import DT, GROUND, standing

import octo
from octo import motion_graph
from octo.cli.main import main
from octo.errors import OctoError, OutputError
from octo.motion_graph.crossing import Crossing, Placement
from octo.motion_graph.file import File
from octo.motion_graph.work import LAW, Outcome, Pair

MOTIONS = {"high": (0.0, (0.0, 0.0, 0.0)), "low": (0.15, (3.0, -2.0, 2.0))}
HOW = {"transitions": 0.5, "every": 3, "share": 0.5, "batch": 2, "device": "cpu"}
PAIRS = 2 * 4  # of 2 × 3 × 3: at 0, 0.75 and 1.5 s of either


@pytest.fixture(scope="module")
def motions() -> dict[str, octo.Solution]:
    return {name: standing(*own, steps=90) for name, own in MOTIONS.items()}


def made(motions, path, executor=None, **how) -> octo.motion_graph.MotionGraph:
    executor = executor or ThreadPoolExecutor(1)
    return motion_graph.build(
        octo.load("mammal"), motions, path=path, executor=executor, **{**HOW, **how}
    )


@pytest.fixture(scope="module")
def graph(motions, tmp_path_factory) -> octo.motion_graph.MotionGraph:
    return made(motions, tmp_path_factory.mktemp("graph") / "standing.graph")


def numbers(graph) -> list[dict]:
    """What is the same in two builds: all but times."""
    return [{k: v for k, v in row.items() if k not in ("seconds", "number")} for row in graph.table]


def paths(graph) -> list[bytes]:
    with sqlite3.connect(graph.path) as database:
        return [b"".join(row) for row in database.execute("SELECT x, u, force FROM paths")]


# -- what is built ---------------------------------------------------------------------------------


def test_all_transitions_are_found(graph) -> None:
    report = graph.report()
    assert (report["pairs"], report["transitions"]) == (PAIRS, PAIRS)
    assert report["shares"] == {"high, low": 1.0, "low, high": 1.0}
    assert report["nodes"] == 2 * 4 and report["reasons"] == {}
    assert report["loops"] == 2 and report["strong_nodes"] >= 4
    assert "8 transitions of 8 pairs (100%)" in str(graph)


def test_a_path_of_the_file_obeys_newton_and_joins_both_motions(graph) -> None:
    row = next(r for r in graph.table if (r["one"], r["at"], r["other"]) == ("high", 30, "low"))
    high, low = graph.motions["high"], graph.motions["low"]
    robot = high.character
    with File(graph.path) as file:
        x, u, force = file.arrays(row["number"], robot.nx)
    assert x.shape == (21, robot.nx) and u.shape == (20, robot.nu)
    place = Placement(row["yaw"], np.array([row["shift_x"], row["shift_y"]]))
    assert (x[0] == high.x[21]).all()
    end = place.moved(low.x[row["to"] : row["to"] + 2], robot.base_coordinate)
    assert np.abs(x[-2:] - end).max() < 1e-12
    weight = force.sum(axis=1)[:, 2].mean()
    assert weight == pytest.approx(high.weight, rel=0.02)
    assert np.abs(u).max() <= robot.torque_limit.max()
    assert row["violation"] <= LAW and row["torque"] <= 1.0


def test_the_pairs_are_the_most_alike(graph) -> None:
    high, low = graph.motions["high"], graph.motions["low"]
    crossing = Crossing(high, low, 20, [octo.Effort()])
    moments = (0, 30, 60)
    all_of_them = [crossing.placed(at, to)[0].distance[0, 0] for at in moments for to in moments]
    tried = [
        row["distance"] for row in graph.table if (row["one"], row["other"]) == ("high", "low")
    ]
    assert sorted(tried) == pytest.approx(sorted(all_of_them)[: PAIRS // 2])


def test_window_and_cloud_say_what_is_compared(motions) -> None:
    """By its feet alone, over a tenth of a second: by how far they stand from each other."""
    from octo.model.kinematics import sphere_centers

    high, low = motions.values()
    own = Crossing(high, low, 20, [octo.Effort()], window=4, cloud=sphere_centers)
    found, leaving, reaching = own.similarity(30, held=True)
    assert leaving.tolist() == reaching.tolist() == [0, 30, 60]
    one, other = (sphere_centers(m.character, m.x[1]) for m in (high, low))
    pairs = np.triu_indices(len(one), 1)
    apart, its = (np.linalg.norm(p[:, None] - p[None], axis=-1)[pairs] for p in (one, other))
    assert 0.0 < found.distance.max() <= np.abs(apart - its).max()  # rms of rigid fits
    whole = Crossing(high, low, 20, [octo.Effort()]).similarity(30, held=True)[0]
    assert (whole.distance != found.distance).all()


# -- through it ------------------------------------------------------------------------------------


def test_commands_are_followed_and_make_one_motion(graph) -> None:
    script = [("high", 0.5), ("low", 1.5), ("high", 0.5), ("low", 0.5)]
    route = graph.route(script)
    assert [own.motion for own in route.switches] == ["low", "high", "low"]
    assert all(0.0 <= own.wait <= 0.75 + 1e-9 for own in route.switches)
    assert route.switches[0].reached == route.switches[0].left + 0.5
    motion = route.motion
    assert motion.steps * DT == pytest.approx(route.seconds)
    assert motion.pointwise_residual <= LAW
    steps = np.abs(np.diff(motion.x, axis=0)).max(axis=0)
    robot = motion.character
    assert steps[:6].max() < 0.05  # no leap of place and heading at an edge
    assert steps[robot.actuated].max() <= 12.0 * DT + 1e-6  # rad/s, the limit of joint speeds
    assert motion.contact_force.sum(axis=1)[:, 2].mean() == pytest.approx(motion.weight, rel=0.02)


def test_a_motion_is_kept_up_longer_than_it_lasts_by_its_loops(graph) -> None:
    route = graph.route([("high", 6.0)])  # it has 2.25 s
    assert {node[0] for node in route.nodes} == {"high"} and route.seconds >= 6.0
    assert route.motion.steps == round(route.seconds / DT)


def test_ways_are_shortest_by_time_or_by_effort(graph) -> None:
    import networkx

    quick, easy = (graph.way(("high", 0), "low", by) for by in ("time", "effort"))
    assert quick.seconds == 0.5 and quick.nodes[0] == ("high", 0)
    for way, weight in ((quick, "seconds"), (easy, "effort")):
        own = networkx.path_weight(graph.network, way.nodes, weight)
        others = networkx.single_source_dijkstra_path_length(
            graph.network, ("high", 0), weight=weight
        )
        assert own == min(length for node, length in others.items() if node[0] == "low")
    end = graph.path_between(("high", 0), ("low", 30)).x[-1]
    joints = octo.load("mammal").actuated
    assert np.abs(end - graph.motions["low"].x[31])[joints].max() < 1e-12


def test_pruned_it_keeps_the_better_transitions(graph) -> None:
    best = graph.pruned(best=1)
    assert best.report()["edges"] < graph.report()["edges"]
    crossed = [e for e in best.network.edges(data="number") if e[2] and e[0][0] != e[1][0]]
    assert len(crossed) == 4
    for one, other, _ in crossed:
        effort = best.network.edges[one, other]["effort"]
        all_of_them = [
            d["effort"]
            for _, end, d in graph.network.out_edges(one, data=True)
            if end[0] == other[0] != one[0]
        ]
        assert effort == min(all_of_them)
    torque = sorted(row["torque"] for row in graph.table)[3]
    few = graph.pruned(torque=torque)
    kept = sum(number is not None for *_, number in few.network.edges(data="number"))
    assert kept == sum(row["torque"] <= torque for row in graph.table) < len(graph.table)


# -- nothing is lost -------------------------------------------------------------------------------


class Stops(ThreadPoolExecutor):
    """Whose user presses Ctrl-C when so many batches were sent."""

    def __init__(self, after: int):
        super().__init__(1)
        self.after = after
        self.sent = 0

    def submit(self, function, /, *given, **named):
        if self.sent == self.after:
            raise KeyboardInterrupt
        self.sent += 1
        future = super().submit(function, *given, **named)
        future.exception()  # it is done
        return future


def test_ctrl_c_loses_nothing_and_the_next_build_does_what_is_missing(
    motions, tmp_path, graph
) -> None:
    path = tmp_path / "stopped.graph"
    some = made(motions, path, Stops(2))
    done = len(some.table)
    assert done == 1 + 2  # loops of the first, two pairs
    rest = Stops(100)
    whole = made(motions, path, rest)
    assert numbers(whole) == numbers(graph) and paths(whole) == paths(graph)
    assert rest.sent == 4  # of six batches: two of each pair of motions, one of loops of each
    again = Stops(0)
    assert numbers(made(motions, path, again)) == numbers(graph) and again.sent == 0


def test_ctrl_c_before_the_first_transition_is_ctrl_c(motions, tmp_path) -> None:
    with pytest.raises(KeyboardInterrupt):
        made(motions, tmp_path / "x.graph", Stops(0))


def test_a_full_disk_is_one_line_and_what_was_there_stays(motions, tmp_path, graph) -> None:
    path = tmp_path / "full.graph"
    shutil.copy(graph.path, path)
    robot, before = octo.load("mammal"), path.read_bytes()
    with File(path, writes=True) as file:
        file.database.execute("PRAGMA max_page_count = 1")  # what it has, and no more
        large = np.ones((4000, robot.nx))
        pair = Pair("high", 1, "low", 1)
        own = Outcome(pair, True, "", *(0.0,) * 3, 1, *(0.0,) * 3, np.zeros(2), *(large,) * 3)
        with pytest.raises(OutputError, match="cannot be written: database or disk is full"):
            file.keep([own])
        assert pair not in file.done
    assert path.read_bytes() == before


def test_two_builds_do_not_write_one_file(motions, graph) -> None:
    with (
        File(graph.path, writes=True),
        pytest.raises(OctoError, match="is being written by another build$"),
    ):
        made(motions, graph.path)


@pytest.mark.parametrize("damage", ["text", "cut", "other", "motion", "path", "format"])
def test_a_damaged_file_is_one_line(tmp_path: Path, graph, damage: str) -> None:
    path = tmp_path / "damaged.graph"
    whole = Path(graph.path).read_bytes()
    path.write_bytes(
        {"text": b"no database " * 100, "cut": whole[: len(whole) // 3]}.get(damage, whole)
    )
    changes = {
        "other": "PRAGMA application_id = 3",
        "motion": "UPDATE motions SET file = x'00'",
        "path": "UPDATE paths SET x = x'00'",
        "format": "UPDATE record SET value = '7' WHERE name = 'format'",
    }
    if damage in changes:
        with sqlite3.connect(path) as database:
            database.execute(changes[damage])
    with pytest.raises(OctoError) as refused:
        motion_graph.MotionGraph(path).play([("high", 0.5), ("low", 0.5)])
    said = str(refused.value)
    assert str(path) in said and "\n" not in said


# Each in processes of its own: what this one has compiled for other tests may have other bits.
SCRIPT = """
import os, signal, sys
from concurrent.futures import ThreadPoolExecutor
import octo
from octo import motion_graph
from octo.motion_graph.file import File

def build(path, folder, executor=None):
    motions = {{name: f"{{folder}}/{{name}}.npz" for name in ("high", "low")}}
    robot = octo.load("mammal")
    motion_graph.build(robot, motions, path=path, executor=executor, **{how!r})

def on_a_cluster(path, folder):
    import distributed
    own = dict(n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=folder)
    with distributed.LocalCluster(**own) as cluster, distributed.Client(cluster) as client:
        killed, keep = [], File.keep

        def keep_and_kill(self, outcomes):
            keep(self, outcomes)
            if not killed:
                killed.append(min(client.run(os.getpid).values()))
                os.kill(killed[0], signal.SIGKILL)

        File.keep = keep_and_kill
        build(path, folder, client.get_executor())
        assert killed

if __name__ == "__main__":
    way, path, folder = sys.argv[1:]
    if way == "one":
        build(path, folder, ThreadPoolExecutor(1))
    elif way == "two":
        build(path, folder)
    else:
        on_a_cluster(path, folder)
"""


def elsewhere(way: str, motions, folder: Path) -> motion_graph.MotionGraph:
    """Built by one process, by two, or by a cluster of two workers, one of which is killed."""
    for name, motion in motions.items():
        motion.save(folder / f"{name}.npz")
    script, path = folder / "script.py", folder / f"{way}.graph"
    script.write_text(SCRIPT.format(how=HOW), encoding="utf-8")
    subprocess.run([sys.executable, script, way, path, folder], check=True, timeout=300)
    return motion_graph.MotionGraph(path)


@pytest.fixture(scope="module")
def by_one(motions, tmp_path_factory) -> motion_graph.MotionGraph:
    return elsewhere("one", motions, tmp_path_factory.mktemp("one"))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["two", "cluster"])
def test_processes_and_a_cluster_make_the_same_graph_to_the_bit(
    motions, by_one, tmp_path, way: str
) -> None:
    """Also where a worker is killed on the way: nothing is lost, nothing is there twice."""
    if way == "cluster":
        pytest.importorskip("distributed")
    found = elsewhere(way, motions, tmp_path)
    assert sorted(map(str, numbers(found))) == sorted(map(str, numbers(by_one)))
    assert sorted(paths(found)) == sorted(paths(by_one))


# -- refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"transitions": 0.05}, "transitions is 0.05, must be four steps of 0.025 s or more"),
        ({"share": 0.0}, "share is 0, must be above 0, and at most 1"),
        ({"every": 0}, "every is 0, must be a whole number of at least 1"),
        ({"moments": -1.0}, "moments is -1.0 s, must be positive and finite"),
        ({"motions": ["walk", "fly"]}, "motion 'fly' is not known"),
        ({"motions": "walk"}, "motions is 'walk', must be names such as walk"),
        ({"motions": ["walk", "walk"]}, "motions walk, walk has a name twice"),
        ({"executor": 3}, "executor is 3, must be a concurrent.futures.Executor"),
        ({"passes": 2}, "passes is given, must be left out of a graph"),
        ({"robot": octo.gallery.biped()}, "motion 'high' is of mammal with"),
        ({"constraints": "firm"}, "'firm'"),
    ],
)
def test_what_cannot_be_built_is_refused_in_one_line(motions, tmp_path, change, said) -> None:
    given = {"robot": octo.load("mammal"), "motions": motions, "path": tmp_path / "x.graph", **HOW}
    given = {"executor": ThreadPoolExecutor(1), **given, **change}
    with pytest.raises(OctoError) as refused:
        motion_graph.build(given.pop("robot"), given.pop("motions"), **given)
    assert said in str(refused.value) and "\n" not in str(refused.value)
    assert change.keys() == {"transitions"} or list(tmp_path.iterdir()) == []


def test_a_file_of_another_graph_is_refused(motions, graph) -> None:
    with pytest.raises(OctoError, match="of another graph: transitions is 0.5 there and 1.0"):
        made(motions, graph.path, transitions=1.0)
    other = {**motions, "low": motions["high"]}
    with pytest.raises(OctoError, match="is of another graph: motions is"):
        made(other, graph.path)


@pytest.mark.slow
def test_a_motion_under_another_law_is_found_again_under_the_first_ones(motions, tmp_path) -> None:
    other = standing(0.1, (0.0, 0.0, 0.0), 90, {**GROUND, "contact.onset": 0.0102})
    with pytest.raises(OctoError, match="contact.onset is .* of the one motion"):
        octo.transition(motions["high"], other, seconds=0.5)
    path = tmp_path / "laws.graph"
    made({"high": motions["high"], "still": other}, path, every=4, loops=0)
    with File(path) as file:
        found = file.motion("still")
    assert found.parameters["contact.onset"] == GROUND["contact.onset"]
    assert found.violation <= LAW and 0.0 < np.abs(found.x - other.x).max() < 1e-3


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda g: g.route([]), "commands is empty"),
        (lambda g: g.route([("run", 1.0)]), "motion 'run' is not known"),
        (lambda g: g.route([("low", -1.0)]), "seconds of a command is -1.0 s, must be positive"),
        (lambda g: g.route([("low", 1.0)], ("low", 7)), "step is 7, must be one of 0, 30"),
        (lambda g: g.way(("low", 90), ("high", 0)), "no way leads from ('low', 90)"),
        (lambda g: g.way(("low", 0), "high", "money"), "by 'money' is not known"),
        (lambda g: g.pruned(torque=-1.0), "torque is -1"),
        (lambda g: g.pruned(best=0), "best is 0, must be"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(graph, ask, said) -> None:
    with pytest.raises(OctoError) as refused:
        ask(graph)
    assert said in str(refused.value) and "\n" not in str(refused.value)


# -- in the shell ----------------------------------------------------------------------------------


def test_info_and_play_in_the_shell(graph, tmp_path, capsys) -> None:
    assert main(["graph", "info", str(graph.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == graph.report()
    out = tmp_path / "played"
    words = ["graph", "play", str(graph.path), "--script", "high:0.5,low:0.5", "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "low: due at 0.50 s" in said
    report = json.loads((out / "report.json").read_text())
    assert [own["motion"] for own in report["switches"]] == ["low"]
    assert octo.Solution.load(out).violation <= LAW and (out / "motion.html").exists()


def test_a_graph_is_built_of_files_in_the_shell(motions, tmp_path, capsys) -> None:
    for name, motion in motions.items():
        motion.save(tmp_path / f"{name}.npz")
    files = ",".join(f"{name}={tmp_path / name}.npz" for name in motions)
    how = ["--transitions", "0.5", "--every", "3", "--share", "0.1", "--loops", "0", "--batch", "1"]
    words = ["graph", "build", "mammal", "--motions", files, "--out", str(tmp_path / "x.graph")]
    assert main([*words, *how]) == 0
    said = capsys.readouterr()
    assert "2 transitions of 2 pairs (100%), 0 loops" in said.out
    assert "2 of 2 pairs, 100% of those now found" in said.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("build mammal", "--out is missing"),
        ("build mammal --out x --motions walk,a=b.npz", "--motions has names and files"),
        ("build mammal --out x --limits soft --mu 0.5", "--mu is of limits that hold"),
        ("build mammal --out x --motions fly", "motion 'fly' is not known"),
        ("build mammal --out x --evry 2", "option '--evry' is not known; did you mean --every"),
        ("biuld mammal", "invalid choice: 'biuld'"),
        ("info nowhere", "nowhere is not there: octo.motion_graph.build makes it"),
        ("play nowhere", "--script is missing, such as walk:3,left:2"),
        ("play nowhere --script walk:x", "script has 'walk:x': seconds is 'x'"),
        ("play nowhere --script :3", "script has ':3', must be NAME:SECONDS"),
    ],
)
def test_what_the_shell_refuses(words, said, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["graph", *words.split()]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
