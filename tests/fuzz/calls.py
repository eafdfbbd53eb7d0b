"""Python calls: good arguments, of which one or two are replaced by anything."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import octo
from octo.model.character import Body, ContactSphere, Joint, floating_base
from octo.mpc import Controller, Push, VelocityCommand, walking_problem
from octo.plant import MujocoPlant, SimulatorPlant
from octo.problem.codegen import References
from octo.result.solution import Solution
from tests.fuzz import saved
from tests.fuzz.judge import call
from tests.fuzz.values import anything, shown

Call = tuple[Callable[..., Any], dict[str, Any]]


@functools.cache
def chain() -> octo.Character:
    return octo.gallery.chain()


@functools.cache
def mammal() -> octo.Character:
    return octo.gallery.mammal()


@functools.cache
def problem() -> octo.Problem:
    return octo.Problem(chain(), steps=3, dt=0.05, costs=[octo.Effort()], x0=_start())


@functools.cache
def _start() -> Any:
    return octo.Problem(chain(), steps=3, dt=0.05, costs=[octo.Effort()]).start


@functools.cache
def standing() -> Solution:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "solution.npz"
        path.write_bytes(saved.originals()["solution.npz"])
        return Solution.load(path)


@functools.cache
def controller() -> Controller:
    return Controller(walking_problem(mammal(), 5))


def packed(make: Callable[..., Any]) -> Callable[..., Any]:
    """A term of E, with its references as a solver reads them."""

    def made(**values: Any) -> Any:
        term = make(**values)
        return References.of([term], problem().setting).pack([term], problem().setting)

    return made


LIMITS: dict[str, Any] = {"max_iterations": 1, "passes": 1, "device": "cpu"}


def calls() -> dict[str, Call]:
    """What is called, with arguments that are good."""
    robot, vector = chain(), (0.1, 0.2, 0.3)
    terms: dict[str, dict[str, Any]] = {
        "BaseAngularVelocity": {"velocity": vector, "axes": vector},
        "BaseHeight": {"height": 0.3},
        "BaseOrientation": {"roll_pitch_yaw": vector},
        "BodyLoad": {},
        "CenterOfMassDisplacement": {"displacement": vector},
        "CenterOfMassPosition": {"target": vector},
        "CenterOfMassVelocity": {"velocity": vector},
        "Clearance": {},
        "Effort": {"reference": 1.0},
        "FootLift": {"height": 0.1},
        "ForceRate": {},
        "FrictionCone": {"mu": 0.5},
        "JointAcceleration": {},
        "JointLimit": {"margin": 0.1},
        "JointSpeedLimit": {"margin": 0.9, "otherwise": 3.0},
        "JointVelocity": {"velocity": 0.0},
        "LoadSharing": {},
        "PointPosition": {"body": None, "point": vector, "target": vector},
        "PointVelocity": {"body": None, "velocity": vector},
        "PoseTarget": {"target": robot.default_pose},
        "Posture": {"joints": 1.0},
        "Slip": {},
        "SlipPower": {},
        "SwingClearance": {},
        "TorqueLimit": {"margin": 1.0},
        "Upright": {"body": None},
        "CustomCost": {"function": lambda s, v: s.x, "values": {}},
        "NeighbourCost": {"function": lambda a, b, v: a - b, "values": {}},
    }
    made: dict[str, Call] = {
        name: (packed(getattr(octo, name)), {**values, "weight": 1.0, "steps": "all", "name": "t"})
        for name, values in terms.items()
    }
    where = {"terrain": octo.Plane(), "law": octo.laws.Smooth(), "pose": None}
    motion = {
        "robot": robot,
        "speed": 0.3,
        "seconds": 1.0,
        "dt": 0.05,
        "period": 0.8,
        "starts": 1,
        "seed": 0,
        **where,
        **LIMITS,
    }
    asked = {
        "time_limit": 1.0,
        "tolerance": 1e-4,
        "threads": 1,
        "progress": False,
        "callback": None,
        "options": None,
    }
    made |= {
        "Problem": (
            octo.Problem,
            {
                "model": robot,
                "steps": 3,
                "dt": 0.05,
                "costs": [octo.Effort()],
                "basis": "nodes",
                "x0": _start(),
                "v0": None,
                "x_end": None,
                "v_end": None,
                "displacement": None,
                "cycle": None,
                "parameters": {},
                "terrain": octo.Plane(),
                "law": octo.laws.Smooth(),
            },
        ),
        "Problem.replace": (
            problem().replace,
            {"steps": 3, "dt": 0.05, "costs": [octo.Effort()], "v0": None, "parameters": {}},
        ),
        "solve": (
            octo.solve,
            {"problem": problem(), "start": None, "seeds": 1, "seed": 0, **LIMITS, **asked},
        ),
        "solve many": (
            lambda **k: octo.solve([problem(), k.pop("one")], **k),
            {"one": problem(), "start": None, "seed": 0, **LIMITS},
        ),
        "walk": (octo.walk, {**motion, **asked}),
        "turn": (octo.turn, {**motion, **asked}),
        "stride": (octo.stride, {**motion, **asked}),
        "jump": (
            octo.jump,
            {
                "robot": robot,
                "height": 0.1,
                "distance": 0.1,
                "seconds": None,
                "dt": 0.05,
                "seeds": 1,
                **where,
                **LIMITS,
                **asked,
            },
        ),
        "Cycle": (
            octo.Cycle,
            {
                "speed": 0.3,
                "period": 0.8,
                "mirror": True,
                "turn": 0.0,
                "sideways": 0.0,
                "shift": None,
            },
        ),
        "Goal": (
            octo.Goal,
            {"kind": "walk", "speed": 0.5, "distance": 0.5, "height": 0.2, "preset": "paper"},
        ),
        "Plane": (octo.Plane, {"slope": 0.1, "direction": 0.1, "height": 0.0}),
        "Terrain": (
            lambda **k: problem().replace(terrain=octo.Terrain(**k), x0=None),
            {"expression": lambda q, p: q[2] - p["a"], "parameters": {"a": 0.0}},
        ),
        "SqpOptions": (
            octo.SqpOptions,
            {
                "max_iterations": 3,
                "tolerance": 1e-6,
                "time_limit": 1.0,
                "plateau": 20,
                "plateau_change": 1e-4,
                "cap": 1.0,
                "first_sigma": 1e-6,
                "c_max": 0.1,
                "dual_tolerance": 1e-5,
                "step_tolerance": 1e-3,
                "linear_solver": "auto",
            },
        ),
        "Joint": (
            Joint,
            {
                "name": "j",
                "kind": "hinge",
                "axis": (0.0, 0.0, 1.0),
                "lower": -1.0,
                "upper": 1.0,
                "torque_limit": 3.0,
                "damping": 0.1,
                "anchor": vector,
                "actuated": True,
                "gear": 1.0,
                "armature": 0.0,
                "stiffness": 0.0,
                "rest": 0.0,
                "reference": 0.0,
                "velocity_limit": 3.0,
            },
        ),
        "Body": (
            Body,
            {
                "name": "b",
                "parent": -1,
                "joints": floating_base(),
                "position": vector,
                "rotation": np.eye(3),
                "mass": 1.0,
                "com": vector,
                "inertia": np.eye(3),
            },
        ),
        "ContactSphere": (
            ContactSphere,
            {"name": "c", "body": 0, "position": vector, "radius": 0.1, "touches_terrain": True},
        ),
        "Character": (
            octo.Character,
            {
                "name": "r",
                "bodies": robot.bodies,
                "contacts": robot.contacts,
                "pairs": robot.pairs,
                "base": "floating",
                "chart": "zyx",
                "default_pose": robot.default_pose,
                "dropped": (),
                "poses": {},
            },
        ),
        "load": (octo.load, {"path": "chain", "base": "auto"}),
        "describe": (octo.describe, {"character": robot}),
        "mirror_of": (octo.mirror_of, {"robot": robot, "pairs": None}),
        "export_mjcf": (
            octo.export_mjcf,
            {"character": robot, "path": "a.xml", "terrain": octo.Plane()},
        ),
        "simulate": (
            octo.simulate,
            {
                "model": robot,
                "x0": _start(),
                "v0": None,
                "controls": None,
                "steps": 2,
                "dt": 0.05,
                "terrain": octo.Plane(),
                "law": None,
                "parameters": None,
            },
        ),
        "replay": (
            octo.replay,
            {
                "solution": standing(),
                "kp": None,
                "kd": None,
                "friction": 0.8,
                "starts": None,
                "seed": 0,
                "feedback": "base",
                "timestep": 0.001,
            },
        ),
        "Controller": (
            Controller,
            {
                "problem": controller().problem,
                "iterations": 1,
                "budget": None,
                "device": "cpu",
                "convention": "mujoco",
                "curvature": "gauss-newton",
                "stiffness": 10.0,
                "damping": 1.0,
                "guide": None,
            },
        ),
        "step": (
            _restarted,
            {"t": 0.1, "q": np.zeros(7 + mammal().nu), "v": np.zeros(6 + mammal().nu)},
        ),
        "walking_problem": (
            walking_problem,
            {"robot": mammal(), "steps": 5, "dt": 0.04, "friction": 0.8, "pose": None},
        ),
        "VelocityCommand": (
            VelocityCommand,
            {"velocity": (0.1, 0.0), "yaw_rate": 0.0, "acceleration": (1.0, 1.0)},
        ),
        "Push": (Push, {"force": 1.0, "seconds": 0.2, "degrees": 0.0, "start": 5.0}),
        "MujocoPlant": (
            MujocoPlant,
            {
                "character": mammal(),
                "terrain": octo.Plane(),
                "friction": 0.8,
                "timestep": 0.002,
                "gravity": (0.0, 0.0, -9.81),
                "payload": 0.0,
                "bumps": 0.0,
                "seed": 0,
            },
        ),
        "SimulatorPlant": (
            SimulatorPlant,
            {
                "character": chain(),
                "terrain": octo.Plane(),
                "parameters": None,
                "timestep": 0.005,
                "payload": 0.0,
            },
        ),
        "mpc.run": (
            octo.mpc.run,
            {
                "controller": controller(),
                "plant": _plant(),
                "seconds": 0.03,
                "rate": 100.0,
                "noise": 0.0,
                "delay": 0,
                "push": None,
                "seed": 0,
                "each": None,
            },
        ),
        "view": (
            octo.view,
            {
                "solution": standing(),
                "path": "a.html",
                "follow": True,
                "apart": None,
                "labels": None,
                "loop": None,
            },
        ),
        "export": (
            octo.export,
            {"solution": standing(), "path": "a.glb", "fps": 10.0, "repeat": 1},
        ),
        "plot": (octo.plot, {"solution": standing(), "path": None}),
        "filmstrip": (
            octo.filmstrip,
            {"solution": standing(), "path": None, "moments": 2, "between": None},
        ),
        "save": (standing().save, {"path": "a.npz"}),
        "to_csv": (standing().to_csv, {"path": "a.csv"}),
        "Solution.load": (Solution.load, {"path": "a.npz"}),
        "Log.load": (octo.mpc.Log.load, {"path": "a.npz"}),
        "Hermite": (
            lambda **k: problem().replace(basis=octo.Hermite(**k), steps=9),
            {"steps_per_segment": 3},
        ),
        "paper": (octo.costs.paper, {"velocity": vector}),
        "natural": (octo.costs.natural, {"speed": 0.3, "yaw_rate": None, "length": 0.3}),
        "robot": (octo.costs.robot, {"speed": 0.3, "yaw_rate": 0.0, "length": 0.3, "times": None}),
        "contact_rich": (octo.costs.contact_rich, {"length": 0.3, "gravity": 9.81}),
        "locomotion": (octo.costs.locomotion, {"velocity": vector, "length": 0.3}),
        "center_of_mass": (
            octo.kinematics.center_of_mass,
            {"character": robot, "x": robot.default_pose},
        ),
        "body_poses": (octo.kinematics.body_poses, {"character": robot, "x": robot.default_pose}),
        "Coulomb": (
            _with_law(lambda **k: octo.laws.Smooth(friction=octo.laws.Coulomb(**k))),
            {"mu": 0.5, "creep": 0.1},
        ),
        "Smooth": (
            _with_law(octo.laws.Smooth),
            {"w_perp": 3e4, "onset": 0.01, "friction": octo.laws.Viscous()},
        ),
    }
    return made


def _with_law(make: Callable[..., Any]) -> Callable[..., Any]:
    return lambda **values: problem().replace(law=make(**values))


def _restarted(**measured: Any) -> Any:
    command = controller().step(**measured)
    if not np.isfinite(command.u).all():
        raise FloatingPointError(f"a torque that is not finite: {command.u}")
    return command


@functools.cache
def _plant() -> MujocoPlant:
    return MujocoPlant(mammal(), timestep=0.005)


@functools.cache
def _all() -> dict[str, Call]:
    return calls()


def chosen(random: Random) -> tuple[str, dict[str, Any]]:
    name = random.choice(sorted(_all()))
    good = _all()[name][1]
    changed = random.sample(sorted(good), min(len(good), random.choice((1, 1, 1, 2, 3))))
    return name, {key: anything(random) for key in changed}


def case(random: Random, folder: Path) -> None:
    name, bad = chosen(random)
    function, good = _all()[name]
    try:
        call(lambda: function(**{**good, **bad}), may_run=True)
    except Exception as fault:
        values = ", ".join(f"{key}={shown(value)}" for key, value in bad.items())
        raise type(fault)(f"{name}({values}): {fault}") from fault
