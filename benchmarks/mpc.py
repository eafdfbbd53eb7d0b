"""Receding-horizon control, measured: latency, walking in MuJoCo, pushes, other robots, warm
starts, memory.

Run ``python -m benchmarks.mpc [SECTION …]``; what is in ``benchmarks/results/mpc.json`` already is
not run again, so it may be stopped at any time. ``--again`` runs the named sections anew. Seeds 0 …
4 here; the terms were tuned on 100 … 104.
"""

from __future__ import annotations

import argparse
import json
import sysconfig
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import octo
from benchmarks import slip
from benchmarks.held import held
from octo.mpc import Controller, Push, VelocityCommand, animate, run, walking_problem
from octo.mpc.log import memory_in_use
from octo.plant import MujocoPlant
from octo.problem.problem import Problem

RESULTS = Path(__file__).parent / "results" / "mpc.json"
ROBOTS = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
FILES = {
    "go2": "go2_description/urdf/go2.urdf",
    "anymal_c": "anymal_c_simple_description/urdf/anymal.urdf",
}
SEEDS = range(5)
WALKS = {
    "ahead 0.3": (0.3, 0.0, 0.0),
    "ahead 0.5": (0.5, 0.0, 0.0),
    "back 0.3": (-0.3, 0.0, 0.0),
    "sideways 0.2": (0.0, 0.2, 0.0),
    "turn 0.3": (0.0, 0.0, 0.3),
    "walk and turn": (0.3, 0.0, 0.3),
}
Sections = dict[str, Callable[[], Iterator[tuple[str, Callable[[], dict[str, Any]]]]]]


def robot_of(name: str) -> octo.Character:
    return octo.load(str(ROBOTS / FILES[name]) if name in FILES else name)


_problems: dict[str, Problem] = {}


def problem_of(name: str) -> Problem:
    """Compiled once."""
    if name not in _problems:
        _problems[name] = walking_problem(robot_of(name))
    return _problems[name]


def closed_loop(name: str, yaw_rate: float = 0.0) -> tuple[Problem, MujocoPlant, Controller]:
    """A robot at its start in MuJoCo, and a controller that walks it ahead at 0.3 m/s and has seen
    it there."""
    problem = problem_of(name)
    assert problem.character is not None
    plant = MujocoPlant(problem.character)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=VelocityCommand((0.3, 0.0), yaw_rate))
    controller.reset(plant.q, plant.v)
    return problem, plant, controller


def set_out(
    name: str,
    command: tuple[float, float, float],
    seed: int,
    kind: type[MujocoPlant] = MujocoPlant,
    **plant: Any,
) -> tuple[Controller, MujocoPlant]:
    """A controller and its plant at a start that the seed moves a little."""
    problem = problem_of(name)
    robot = problem.character
    assert robot is not None
    rng = np.random.default_rng(seed)
    x = problem.start.copy()
    x[robot.actuated] += 0.02 * rng.standard_normal(robot.nu)
    x[2] += 0.02
    machine = kind(robot, seed=seed, **plant)
    machine.reset_chart(x)
    return Controller(problem, guide=VelocityCommand(command[:2], command[2])), machine


def walk(
    name: str,
    command: tuple[float, float, float],
    seed: int,
    seconds: float,
    *,
    push: Push | None = None,
    noise: float = 0.0,
    delay: int = 0,
    plot: str = "",
    **plant: Any,
) -> dict[str, Any]:
    """One closed loop in MuJoCo from a start that the seed moves a little."""
    controller, machine = set_out(name, command, seed, **plant)
    log = run(controller, machine, seconds, push=push, noise=noise, delay=delay, seed=seed)
    if plot and log.falls:
        from octo.cli.mpc_plot import plot_log

        plot_log(log, RESULTS.parent / f"mpc_{plot.replace(' ', '_').replace(',', '')}.png")
    wanted = np.array(command)
    mean = np.array(log.report()["velocity"])
    follows = [mean[k] / wanted[k] for k in range(3) if wanted[k] != 0.0]
    kept = (
        "falls",
        "fall_times",
        "velocity",
        "command",
        "foot_lift",
        "slip",
        "slip_mean",
        "torque_excess",
        "statuses",
    )
    return {
        **{k: v for k, v in log.report().items() if k in kept},
        "followed": [float(f) for f in follows],
    }


# -- sections: (name, function) pairs, each run once -----------------------------------------------


def latency() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """``step`` over 1,000 closed-loop calls after warm-up, by stage."""
    yield "go2 ahead 0.3", lambda: measure_latency("go2")


def measure_latency(name: str, calls: int = 1000, warm: int = 200) -> dict[str, Any]:
    problem, plant, controller = closed_loop(name)
    whole, ahead, low, processor = [], [], [], []
    for k in range(warm + calls):
        t = 0.01 * k
        q, v = plant.q, plant.v
        began_processor = time.thread_time()
        command = controller.step(t, q, v)
        processor.append(time.thread_time() - began_processor)
        whole.append(command.seconds)
        ahead.append(command.prepare)
        for j in range(5):
            q, v = plant.q, plant.v
            began = time.perf_counter()
            u = controller.command(t + 0.002 * j, q, v)
            low.append(time.perf_counter() - began)
            plant.step(u)
    whole, ahead = whole[warm:], ahead[warm:]
    after = np.array(whole) - np.array(ahead)
    parts = {
        "step": whole,
        "processor": processor[warm:],
        "prepare": ahead,
        "feedback": after,
        "command": low[5 * warm :],
    }
    stages = split(controller)
    return {
        **{
            part: {f"p{p}": 1e3 * float(np.percentile(v, p)) for p in (50, 95, 99, 100)}
            for part, v in parts.items()
        },
        "stages_p50": stages,
        "unit": "ms",
        "horizon": problem.steps,
        "calls": calls,
        "height": float(plant.height),
    }


def split(controller: Controller, repeats: int = 300) -> dict[str, float]:
    """Milliseconds of each stage, on the plan as it is."""
    horizon, plan = controller.horizon, controller.plan
    nodes = plan.x[: plan.steps + 2].copy()

    def median(work: Callable[[], Any], before: Callable[[], Any] = lambda: None) -> float:
        times = []
        for _ in range(repeats):
            horizon.nodes[:] = nodes
            before()
            began = time.perf_counter()
            work()
            times.append(time.perf_counter() - began)
        return 1e3 * float(np.median(times))

    q, v = controller.convention.from_octo(nodes[1], (nodes[1] - nodes[0]) / controller.dt)
    last = horizon.steps + 1
    return {
        "guide": median(
            lambda: controller.guide(controller, plan.time, nodes[1]) if controller.guide else None
        ),
        "linearise steps 2 and on": median(lambda: horizon._linearize(1, False)),
        "eliminate their units": median(lambda: horizon._eliminate(last, 4)),
        "measurement to chart": median(
            lambda: controller.convention.to_octo(q, v, controller.dt, nodes[1])
        ),
        "linearise steps 0 and 1, eliminate, solve": median(
            horizon.feedback, before=horizon.prepare
        ),
        "torques, E and C of the new plan": median(horizon.evaluate),
        "gains": median(horizon.gain),
    }


def walks() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    for name, command in WALKS.items():
        for seed in SEEDS:
            yield (
                f"{name}, seed {seed}",
                lambda c=command, s=seed, n=name: walk("go2", c, s, 30.0, plot=f"{n} {s}"),
            )


def slips() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """When, and under what load, the feet of ``walks`` slip."""
    yield "go2, seed 0", lambda: slip.measure_all(set_out, WALKS, RESULTS.parent / "mpc_slip.png")


def stress() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    for seed in SEEDS:
        yield (
            f"payload 0.2, delay 1, noise 1, seed {seed}",
            lambda s=seed: walk(
                "go2", (0.3, 0.0, 0.0), s, 30.0, payload=0.2, delay=1, noise=1.0, plot=f"stress {s}"
            ),
        )
        yield (
            f"boxes of 2 cm, seed {seed}",
            lambda s=seed: walk("go2", (0.3, 0.0, 0.0), s, 30.0, bumps=0.02, plot=f"boxes2 {s}"),
        )
    for seed in SEEDS:
        yield (
            f"boxes of 5 cm, seed {seed}",
            lambda s=seed: walk("go2", (0.3, 0.0, 0.0), s, 30.0, bumps=0.05, plot=f"boxes5 {s}"),
        )
        yield (
            f"ahead 0.8, seed {seed}",
            lambda s=seed: walk("go2", (0.8, 0.0, 0.0), s, 30.0, plot=f"ahead 0.8 {s}"),
        )


def pushes() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    for force, names in (
        (50.0, ("standing", "walking")),
        (100.0, ("standing", "walking")),
        (150.0, ("standing",)),
    ):
        for name in names:
            command = (0.3 if name == "walking" else 0.0, 0.0, 0.0)
            for k in range(8):
                push = Push(force, 0.2, 45.0 * k, 4.0)
                yield (
                    f"{force:g} N {name}, {45 * k} deg",
                    lambda c=command, p=push, s=k: walk("go2", c, s % 5, 8.0, push=p),
                )


def robots() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    for name in ("anymal_c", "mammal", "spider", "biped"):
        for seed in SEEDS if name in ("anymal_c", "mammal") else (0,):
            for speed in (0.0, 0.3):
                what = "walks" if speed else "stands"
                yield (
                    f"{name} {what}, seed {seed}",
                    lambda n=name, v=speed, s=seed: walk(
                        n, (v, 0.0, 0.0), s, 20.0, plot=f"{n} {s}"
                    ),
                )


def warm() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    yield "go2 ahead 0.3", warm_against_cold


def warm_against_cold(cycles: int = 100, cap: int = 200) -> dict[str, Any]:
    """Iterations until ‖C‖∞ ≤ 1e-3 mg and the step ≤ 1e-2, from the shifted plan and from the
    measured pose held still."""
    problem, plant, controller = closed_loop("go2")
    other = Controller(problem, guide=VelocityCommand((0.3, 0.0)))
    counts: dict[str, list[Any]] = {"warm": [], "cold": [], "warm_energy": [], "cold_energy": []}
    for k in range(200 + cycles):
        t = 0.01 * k
        q, v = plant.q, plant.v
        if k >= 200:
            x, before = controller.convention.to_octo(q, v, controller.dt, controller._near)
            # the plan that the next cycle starts from
            converge(controller, t, x, before, "shifted", cap)
            shifted = controller.plan
            nodes = np.empty((problem.steps + 2, plant.character.nx))
            shifted.shift(t + 0.01, nodes)
            for j in range(5):
                plant.step(controller.command(t + 0.002 * j, plant.q, plant.v))
            q, v = plant.q, plant.v
            x, before = controller.convention.to_octo(q, v, controller.dt, x)
            controller._near = x
            other.compiled.q[:] = controller.compiled.q
            for name, start in (("warm", nodes), ("cold", np.repeat(x[None], len(nodes), axis=0))):
                count, energy = iterate(other, start, x, before, cap)
                counts[name].append(count)
                counts[f"{name}_energy"].append(energy)
            continue
        controller.step(t, q, v)
        for j in range(5):
            plant.step(controller.command(t + 0.002 * j, plant.q, plant.v))
    median = {name: float(np.median(values)) for name, values in counts.items()}
    return {
        **median,
        "ratio": median["warm"] / median["cold"],
        "cap": cap,
        "warm_at_cap": int(np.sum(np.array(counts["warm"]) >= cap)),
        "cold_at_cap": int(np.sum(np.array(counts["cold"]) >= cap)),
        "cold_better_energy": float(
            np.mean(np.array(counts["cold_energy"]) < np.array(counts["warm_energy"]))
        ),
    }


def converge(controller: Controller, t: float, x: Any, before: Any, how: str, cap: int) -> None:
    """Make the converged plan of this measurement the controller's plan."""
    if controller.guide is not None:
        controller.guide(controller, t, x)
    nodes = np.empty_like(controller.horizon.nodes)
    controller.plan.shift(t, nodes)
    iterate(controller, nodes, x, before, cap)
    controller._take(t, solved=False)


def iterate(controller: Controller, start: Any, x: Any, before: Any, cap: int) -> tuple[int, float]:
    horizon = controller.horizon
    horizon.nodes[:] = start
    horizon.nodes[0], horizon.nodes[1] = before, x
    for count in range(1, cap + 1):
        controller._iteration.prepare()
        if not controller._iteration.whole():
            return cap, float("nan")
        if np.abs(horizon.C).max() <= 1e-3 and np.abs(horizon.step).max() <= 1e-2:
            return count, horizon.energy
    return cap, horizon.energy


def memory() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    yield "go2 ten minutes", ten_minutes
    yield "python's own", allocations


def ten_minutes(minutes: int = 10) -> dict[str, Any]:
    """Memory and latency by minute of one closed loop."""
    problem, plant, controller = closed_loop("go2", yaw_rate=0.1)
    used, p50, seconds, fallen = [], [], np.zeros(6000), 0
    for minute in range(minutes):
        for k in range(6000):
            t = 60.0 * minute + 0.01 * k
            seconds[k] = controller.step(t, plant.q, plant.v).seconds
            for j in range(5):
                plant.step(controller.command(t + 0.002 * j, plant.q, plant.v))
            if plant.height < 0.5 * problem.start[2]:
                fallen += 1
                plant.reset_chart(problem.start)
                controller.reset(plant.q, plant.v, t)
        used.append(memory_in_use())
        p50.append(1e3 * float(np.median(seconds)))
    return {
        "memory": used,
        "growth": used[-1] - used[0],
        "p50_ms": p50,
        "p50_ratio": p50[-1] / p50[1],
        "falls": fallen,
    }


def allocations() -> dict[str, Any]:
    """What octo's own Python holds more after 1,000 calls than before."""
    _, plant, controller = closed_loop("go2")
    size, blocks = held(controller, plant, 200, 1000)
    return {"bytes": size, "blocks": blocks}


def chain() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    yield "40 s by horizons of 1 s", animate_chain
    yield "40 s as one problem", solve_chain


def chain_problem(steps: int, basis: str) -> Problem:
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(octo.gallery.chain(), steps=steps, dt=0.025, costs=costs, basis=basis)


def animate_chain() -> dict[str, Any]:
    motion = animate(chain_problem(40, "nodes"), 40.0)
    return {**chain_report(motion), "plans": len(motion.history["energy"])}


def solve_chain() -> dict[str, Any]:
    return chain_report(octo.solve(chain_problem(1600, "hermite"), passes=1, device="cpu"))


def chain_report(motion: octo.Solution) -> dict[str, Any]:
    return {
        "distance": float(motion.com[-1, 0] - motion.com[0, 0]),
        "seconds": motion.seconds,
        "processor_seconds": motion.processor_seconds,
        "energy": motion.energy,
        "iterations": motion.iterations,
        "violation_mg": motion.violation / motion.weight,
        "torque_excess": motion.torque_excess,
        "status": motion.status.label,
    }


def stand_up() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    from examples.mpc_stand_up import rise, stand_up_problem

    problem = stand_up_problem(octo.gallery.mammal())
    for seed in range(10):
        yield f"seed {seed}", lambda s=seed: rise(problem, s)


def faults() -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    yield "go2 walks through faults", faulty_walk


def faulty_walk(seconds: float = 20.0) -> dict[str, Any]:
    """Every 20th measurement NaN, every 23rd the one before again, now and then a budget of 1 ms
    for half a second.

    The one before is stale, unless it was never seen whole.
    """
    problem, plant, controller = closed_loop("go2")
    counts: dict[str, int] = {}
    outside, wrong = 0, 0
    q, v = plant.q.copy(), plant.v.copy()
    for k in range(round(100 * seconds)):
        t = 0.01 * k
        if k % 23 or not k:
            q, v = plant.q.copy(), plant.v.copy()
        broken = q.copy()
        if k % 20 == 19:
            broken[7 + k % plant.character.nu] = np.nan
        controller.budget = 1e-3 if 400 <= k % 1000 < 450 else None
        command = controller.step(t, broken, v)
        name = command.status.label
        counts[name] = counts.get(name, 0) + 1
        wrong += int((k % 20 == 19) != (name == "invalid")) + int(
            k % 20 not in (19, 0) and k % 23 == 0 and name != "stale"
        )
        for j in range(5):
            u = controller.command(t + 0.002 * j, plant.q, plant.v)
            outside += int(
                not (
                    np.isfinite(u).all()
                    and (np.abs(u) <= plant.character.torque_limit + 1e-12).all()
                )
            )
            plant.step(u)
    return {
        "statuses": counts,
        "commands_outside": outside,
        "statuses_wrong": wrong,
        "height": plant.height,
        "upright": float(plant.base_rotation[2, 2]),
    }


SECTIONS: Sections = {
    "latency": latency,
    "walks": walks,
    "slips": slips,
    "pushes": pushes,
    "stress": stress,
    "robots": robots,
    "warm": warm,
    "memory": memory,
    "chain": chain,
    "stand_up": stand_up,
    "faults": faults,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("sections", nargs="*", choices=[*SECTIONS, []], default=[])
    parser.add_argument("--again", action="store_true")
    arguments = parser.parse_args()
    for section in arguments.sections or SECTIONS:
        for name, work in SECTIONS[section]():
            found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
            if name in found.get(section, {}) and not arguments.again:
                continue
            value = work()
            found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
            found.setdefault(section, {})[name] = value
            beside = RESULTS.with_suffix(".tmp")
            beside.write_text(json.dumps(found, indent=1) + "\n")
            beside.replace(RESULTS)
            print(f"{section}: {name}: {json.dumps(value)[:300]}", flush=True)


if __name__ == "__main__":
    main()
