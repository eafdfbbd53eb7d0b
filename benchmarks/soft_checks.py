"""What a soft body's iteration costs as it grows, and a drop beside MuJoCo's flex: docs/soft.md.

    python -m benchmarks.soft_checks [growth] [drop] [flight] [--json FILE] [--plots DIR]

growth  an iteration of N = 120 steps with 5 to 40 modes, and about 100 to 5,000 points of the
        surface, and what it takes to make and compile its dynamics, each in a process and a cache
        of its own
drop    a ball of rubber falls by 10 cm and bounces: octo's with steps that are halved, and MuJoCo's
        flex of the same tetrahedra (four nodes each) and material, both without damping
flight  how far a body that turns and swings in the air is from keeping its angular momentum, with
        steps that are halved

Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import octo
from octo.problem.compiled import CompiledProblem
from octo.soft.moments import Moments
from octo.soft.nodes import Nodes
from octo.soft_motions import soft_course, solve_soft

RESULTS = Path(__file__).parent / "results" / "soft_checks.json"
SECTIONS = ("growth", "drop", "flight")
ITERATIONS = 60
MODES = (5, 10, 20, 40)
BLOCKS = ((6, 1, 1), (16, 2, 2), (40, 3, 3), (80, 4, 4))  # of a beam
YOUNG, POISSON, DENSITY, RADIUS, FALL = 4e5, 0.3, 250.0, 0.2, 0.1
STEPS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)  # s
SECONDS, OTHER_STEP, SPRING = 1.0, 1e-4, 2e5  # s, s, and of MuJoCo's contacts
Array = np.ndarray[Any, np.dtype[np.float64]]

SCENE = """<mujoco>
  <option timestep="{step}" integrator="Euler"/>
  <worldbody>
    <geom type="plane" size="2 2 .1" solref="-{spring} 0" solimp="0.99 0.99 .001 .5 2"/>
    <flexcomp name="ball" type="gmsh" file="{file}" dim="3" mass="{mass}" radius="0.0005"
      pos="0 0 {height}" dof="full">
      <contact solref="-{spring} 0" selfcollide="none"/>
      <edge equality="false" damping="0"/>
      <elasticity young="{young}" poisson="{poisson}" damping="0"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


def processor_seconds() -> float:
    """Of this process and of those that it waited for."""
    child = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + child.ru_utime + child.ru_stime


def grown(modes: int, blocks: tuple[int, int, int]) -> dict[str, Any]:
    """Of a beam that jumps: the jump, for contacts come and go."""
    body = octo.soft.beam(modes=modes, divisions=blocks)
    began = processor_seconds()
    assert octo.soft.SoftDynamics(body)._library is not None
    spent = processor_seconds() - began
    course = soft_course(body, "jump")
    compiled, began = CompiledProblem([course.problem]), processor_seconds()
    assert compiled.library is not None
    spent += processor_seconds() - began
    solve_soft(course, device="cpu", max_iterations=1)
    motion = solve_soft(course, device="cpu", max_iterations=ITERATIONS)
    carrying = np.linalg.norm(motion.contact_force, axis=-1) > 0.0
    return {
        "modes": modes,
        "points": len(body.points),
        "iteration": motion.processor_seconds / motion.iterations,
        "contacts": float(carrying.sum(axis=1).mean()),
        "compile": spent,
    }


def growth() -> dict[str, Any]:
    """Along modes and along points."""
    found: dict[str, list[Any]] = {"modes": [], "points": []}
    cases = [("modes", modes, BLOCKS[1]) for modes in MODES]
    cases += [("points", 10, blocks) for blocks in BLOCKS]
    for along, modes, blocks in cases:
        with tempfile.TemporaryDirectory() as cache:
            words = [sys.executable, "-m", "benchmarks.soft_checks", "--one"]
            words += [json.dumps([modes, blocks])]
            own = {**os.environ, "OCTO_CACHE": cache}
            told = subprocess.run(words, capture_output=True, text=True, check=True, env=own)
        found[along].append(json.loads(told.stdout.splitlines()[-1]))
        print(along, found[along][-1], flush=True)
    return found


def turns(times: Array, height: Array) -> dict[str, list[list[float]]]:
    """Where the centre is lowest and highest: (time s, height m), of the first bounces."""
    k = np.arange(1, len(height) - 1)
    low = k[(height[k] < height[k - 1]) & (height[k] <= height[k + 1])][:3]
    high = k[(height[k] > height[k - 1]) & (height[k] >= height[k + 1])][:2]
    return {
        name: np.column_stack([times[one], height[one]]).tolist()
        for name, one in (("low", low), ("high", high))
    }


def drop() -> dict[str, Any]:
    """Heights of the centre of mass."""
    found: dict[str, Any] = {}
    material = {"young": YOUNG, "poisson": POISSON, "density": DENSITY}
    body = octo.soft.ball(RADIUS, 40, damping=(0.0, 0.0), **material)
    law = octo.laws.Smooth(w_perp=1e5, onset=0.002, friction=octo.laws.Viscous(w_par=1e6))
    dynamics = octo.soft.SoftDynamics(body, law)
    x0 = np.zeros(dynamics.nx)
    x0[2] = RADIUS + FALL
    for step in STEPS:
        motion = octo.simulate(dynamics, x0, seconds=SECONDS, dt=step)
        height = motion.x[1:, 2]
        found[f"octo, {step:g} s"] = turns(motion.time, height) | every(motion.time, height)
        print(
            step, found[f"octo, {step:g} s"]["low"], found[f"octo, {step:g} s"]["high"], flush=True
        )
    times, height = flex()
    found["MuJoCo"] = turns(times, height) | every(times, height)
    print(found["MuJoCo"]["low"], found["MuJoCo"]["high"], flush=True)
    return found


def every(times: Array, height: Array) -> dict[str, list[float]]:
    """A hundred places of a curve."""
    at = np.linspace(0.0, SECONDS, 101)
    return {"height": np.round(np.interp(at, times, height), 5).tolist()}


def flex() -> tuple[Array, Array]:
    """Times and heights (k,) of MuJoCo's ball."""
    import meshio
    import mujoco

    mesh = octo.soft.ball_mesh(RADIUS)
    used, own = np.unique(mesh.cells[:, :4], return_inverse=True)
    points, cells = mesh.nodes[used], own.reshape(-1, 4)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    mass = DENSITY * np.abs(np.linalg.det(edges)).sum() / 6.0
    with tempfile.TemporaryDirectory() as folder:
        meshio.Mesh(points, [("tetra", cells)]).write(
            Path(folder) / "ball.msh", file_format="gmsh22", binary=False
        )
        given = {"step": OTHER_STEP, "spring": SPRING, "mass": mass, "height": RADIUS + FALL}
        text = SCENE.format(file="ball.msh", young=YOUNG, poisson=POISSON, **given)
        scene = Path(folder) / "ball.xml"
        scene.write_text(text)
        model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    found = []
    for _ in range(round(SECONDS / OTHER_STEP)):
        mujoco.mj_step(model, data)
        found.append((data.time, data.subtree_com[0, 2]))
    times, height = np.array(found).T
    return times, height


def flight() -> dict[str, Any]:
    """The largest part of the angular momentum that is lost in a tenth of a second."""
    dynamics = octo.soft.SoftDynamics(octo.soft.beam(young=1e6))
    rng = np.random.default_rng(0)
    x0, v0 = np.zeros(dynamics.nx), np.zeros(dynamics.nx)
    x0[2], x0[6:] = 5.0, 0.01 * rng.normal(size=dynamics.nx - 6)
    v0[3:6] = 2.0 * rng.normal(size=3)
    found = []
    for step in 4e-4 * 0.5 ** np.arange(5):
        motion = octo.simulate(dynamics, x0, v0, seconds=0.1, dt=float(step))
        own = angular_momentum(dynamics, motion.x, float(step))
        off = np.linalg.norm(own - own[0], axis=1).max() / np.linalg.norm(own[0])
        found.append([float(step), float(off)])
    steps, drift = np.log(np.array(found)).T
    print(found, flush=True)
    return {"drift": found, "order": float(np.polyfit(steps, drift, 1)[0])}


def angular_momentum(dynamics: octo.soft.SoftDynamics, x: Array, dt: float) -> Array:
    """(N+1, 3) kg m²/s about the centre of mass: ∫ρ (P − t) × Ṗ of all points."""
    at = Nodes.of(Moments.of(dynamics.body), dynamics._stages[0], x)
    M = dynamics.body.inertia[:-1, :-1]
    T = np.einsum("nk,nij->nikj", at.weights, at.turns.value).reshape(len(x), 3, -1)
    outer = np.diff(T, axis=0) / dt @ M @ T[1:].swapaxes(1, 2)  # ∫ρ Ṗ (P − t)ᵀ
    return np.stack([outer[:, k, i] - outer[:, i, k] for i, k in ((1, 2), (2, 0), (0, 1))], -1)


def draw(found: dict[str, Any], folder: Path) -> None:
    """soft_growth.png and soft_checks.png."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    for axes, along in zip(figure.subplots(1, 2), ("modes", "points"), strict=True):
        rows = found["growth"][along]
        at = [row[along] for row in rows]
        axes.plot(at, [1e3 * row["iteration"] for row in rows], "o-", label="an iteration (ms)")
        axes.plot(at, [row["compile"] for row in rows], "s--", label="to make and compile (s)")
        axes.plot(at, [row["contacts"] for row in rows], "^:", label="contacts that carry, a step")
        axes.set(xlabel=along, xscale="log", yscale="log", ylim=(5.0, 3000.0))
        axes.set_xticks(at, [f"{value:,}" for value in at])
        axes.minorticks_off()
        axes.grid(True, color="#e6e8eb")
        axes.legend(frameon=False, fontsize=8, loc="upper left")
    figure.savefig(folder / "soft_growth.png", dpi=90)

    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = np.linspace(0.0, SECONDS, 101)
    for name, own in found["drop"].items():
        look = {"color": "black", "lw": 1.5, "ls": "--"} if name == "MuJoCo" else {"lw": 1.2}
        left.plot(at, own["height"], label=name, **look)
    left.set(xlabel="time (s)", ylabel="centre of mass (m)", title="a ball of rubber bounces")
    left.set_ylim(0.1, 0.31)
    steps, drift = np.array(found["flight"]["drift"]).T
    right.loglog(1e3 * steps, 1e2 * drift, "o-", label=f"slope {found['flight']['order']:.2f}")
    right.set(xlabel="dt (ms)", title="angular momentum lost in 0.1 s of flight (%)")
    right.set_xticks(1e3 * steps, [f"{1e3 * step:g}" for step in steps])
    right.set_yticks([0.2, 0.5, 1.0, 2.0], ["0.2", "0.5", "1", "2"])
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(True, color="#e6e8eb")
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(folder / "soft_checks.png", dpi=90)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", default=SECTIONS, metavar="SECTION")
    parser.add_argument("--one", type=json.loads, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path, default=RESULTS)
    parser.add_argument("--plots", type=Path, default=Path("docs"))
    asked = parser.parse_args(words)
    if unknown := set(asked.sections) - set(SECTIONS):
        parser.error(f"section {sorted(unknown)[0]!r} is none of {', '.join(SECTIONS)}")
    if asked.one is not None:
        print(json.dumps(grown(asked.one[0], tuple(asked.one[1]))))
        return 0
    found = json.loads(asked.json.read_text()) if asked.json.exists() else {}
    for name in asked.sections:
        found[name] = {"growth": growth, "drop": drop, "flight": flight}[name]()
        asked.json.write_text(json.dumps(found) + "\n", encoding="utf-8")
    if set(found) == set(SECTIONS):
        draw(found, asked.plots)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
