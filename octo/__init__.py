"""octo: from a robot file to a motion, by contact-aware trajectory optimisation without velocities.

A trajectory is a list of configurations and nothing else; contact and friction are smooth functions
of two of them. Everything a user needs is a name of this module; each is imported when it is first
asked for.
"""

from __future__ import annotations

import difflib
import importlib
import logging
import sys
import types
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Silent, as a library is, until its user says where to: logging.basicConfig(), or the command line.
logging.getLogger("octo").addHandler(logging.NullHandler())

_NAMES = {  # by the module that defines them
    "octo.costs": (
        "ArrayCost At BaseAngularVelocity BaseHeight BaseOrientation BodyLoad "
        "CenterOfMassDisplacement CenterOfMassPosition CenterOfMassVelocity Clearance ContactCost "
        "Cost CustomCost Duration "
        "Effort FootLift ForceRate FrictionCone Huber JointAcceleration JointLimit JointPower "
        "JointSpeedLimit JointVelocity LoadSharing Loss NeighbourCost PointPosition PointVelocity "
        "PoseTarget Posture Slip SlipPower StepPairCost SwingClearance TorqueLimit TorqueRate "
        "Upright"
    ),
    "octo.devices": "devices",
    "octo.dynamics.evaluate": "CustomDynamics",
    "octo.dynamics.simulate": "simulate",
    "octo.explain": "explain",
    "octo.export": "export",
    "octo.gains": "gains",
    "octo.get_up": "get_up",
    "octo.goals": "Goal",
    "octo.motion_graph": "transition",
    "octo.jump": "jump",
    "octo.library": "Library library",
    "octo.model.character": "Character",
    "octo.model.describe": "describe",
    "octo.model.element": "DryFriction Element SpringDamper",
    "octo.model.export_mjcf": "export_mjcf",
    "octo.model.load": "load",
    "octo.model.mirror": "mirror_of",
    "octo.model.scene": "Scene",
    "octo.model.solid": "Solid",
    "octo.model.terrain": "Plane Terrain",
    "octo.model.scene_file": "load_scene",
    "octo.model.world_file": "load_world",
    "octo.motions": "go_to stride turn walk",
    "octo.picture": "filmstrip",
    "octo.plot": "plot",
    "octo.problem.basis": "Hermite Nodes",
    "octo.problem.code_stage": "CodeStage",
    "octo.problem.constraints": "Constraint CustomConstraint",
    "octo.problem.cycle": "Cycle",
    "octo.problem.hard": "limits",
    "octo.problem.limits": (
        "BaseHeightRange FrictionCones JointLimits JointSpeedLimits StepLimit TiltLimit "
        "TorqueLimits"
    ),
    "octo.problem.phases": "phases",
    "octo.problem.problem": "Problem",
    "octo.push": "push",
    "octo.replay": "replay",
    "octo.result.solution": "Solution",
    "octo.soft_motions": "soft_motion soft_replay",
    "octo.solve": "solve",
    "octo.solver.acceptance": "Acceptance",
    "octo.solver.options": "SqpOptions",
    "octo.solver.status": "Status",
    "octo.viewer": "view",
    "octo.world.world": "World",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}
_MODULES = {
    "costs": "octo.costs",
    "errors": "octo.errors",
    "gallery": "octo.model.gallery",
    "motion_graph": "octo.motion_graph",
    "kinematics": "octo.model.kinematics",
    "laws": "octo.dynamics.laws",
    "learn": "octo.learn",
    "mpc": "octo.mpc",
    "objects": "octo.model.objects",
    "plant": "octo.plant",
    "reference": "octo.reference",
    "shapes": "octo.world.shapes",
    "soft": "octo.soft",
    "worlds": "octo.worlds",
}

__all__ = sorted([*_HOME, *_MODULES])

if TYPE_CHECKING:
    from octo import costs as costs
    from octo import errors as errors
    from octo import learn as learn
    from octo import motion_graph as motion_graph
    from octo import mpc as mpc
    from octo import plant as plant
    from octo import reference as reference
    from octo import soft as soft
    from octo import worlds as worlds
    from octo.costs import ArrayCost as ArrayCost
    from octo.costs import At as At
    from octo.costs import BaseAngularVelocity as BaseAngularVelocity
    from octo.costs import BaseHeight as BaseHeight
    from octo.costs import BaseOrientation as BaseOrientation
    from octo.costs import BodyLoad as BodyLoad
    from octo.costs import CenterOfMassDisplacement as CenterOfMassDisplacement
    from octo.costs import CenterOfMassPosition as CenterOfMassPosition
    from octo.costs import CenterOfMassVelocity as CenterOfMassVelocity
    from octo.costs import Clearance as Clearance
    from octo.costs import ContactCost as ContactCost
    from octo.costs import Cost as Cost
    from octo.costs import CustomCost as CustomCost
    from octo.costs import Duration as Duration
    from octo.costs import Effort as Effort
    from octo.costs import FootLift as FootLift
    from octo.costs import ForceRate as ForceRate
    from octo.costs import FrictionCone as FrictionCone
    from octo.costs import Huber as Huber
    from octo.costs import JointAcceleration as JointAcceleration
    from octo.costs import JointLimit as JointLimit
    from octo.costs import JointPower as JointPower
    from octo.costs import JointSpeedLimit as JointSpeedLimit
    from octo.costs import JointVelocity as JointVelocity
    from octo.costs import LoadSharing as LoadSharing
    from octo.costs import Loss as Loss
    from octo.costs import NeighbourCost as NeighbourCost
    from octo.costs import PointPosition as PointPosition
    from octo.costs import PointVelocity as PointVelocity
    from octo.costs import PoseTarget as PoseTarget
    from octo.costs import Posture as Posture
    from octo.costs import Slip as Slip
    from octo.costs import SlipPower as SlipPower
    from octo.costs import StepPairCost as StepPairCost
    from octo.costs import SwingClearance as SwingClearance
    from octo.costs import TorqueLimit as TorqueLimit
    from octo.costs import TorqueRate as TorqueRate
    from octo.costs import Upright as Upright
    from octo.devices import devices as devices
    from octo.dynamics import laws as laws
    from octo.dynamics.evaluate import CustomDynamics as CustomDynamics
    from octo.dynamics.simulate import simulate as simulate
    from octo.explain import explain as explain
    from octo.export import export as export
    from octo.gains import gains as gains
    from octo.get_up import get_up as get_up
    from octo.goals import Goal as Goal
    from octo.jump import jump as jump
    from octo.library import Library as Library
    from octo.library import library as library
    from octo.model import gallery as gallery
    from octo.model import kinematics as kinematics
    from octo.model import objects as objects
    from octo.model.character import Character as Character
    from octo.model.describe import describe as describe
    from octo.model.element import DryFriction as DryFriction
    from octo.model.element import Element as Element
    from octo.model.element import SpringDamper as SpringDamper
    from octo.model.export_mjcf import export_mjcf as export_mjcf
    from octo.model.load import load as load
    from octo.model.mirror import mirror_of as mirror_of
    from octo.model.scene import Scene as Scene
    from octo.model.scene_file import load_scene as load_scene
    from octo.model.solid import Solid as Solid
    from octo.model.terrain import Plane as Plane
    from octo.model.terrain import Terrain as Terrain
    from octo.model.world_file import load_world as load_world
    from octo.motion_graph import transition as transition
    from octo.motions import go_to as go_to
    from octo.motions import stride as stride
    from octo.motions import turn as turn
    from octo.motions import walk as walk
    from octo.picture import filmstrip as filmstrip
    from octo.plot import plot as plot
    from octo.problem.basis import Hermite as Hermite
    from octo.problem.basis import Nodes as Nodes
    from octo.problem.code_stage import CodeStage as CodeStage
    from octo.problem.constraints import Constraint as Constraint
    from octo.problem.constraints import CustomConstraint as CustomConstraint
    from octo.problem.cycle import Cycle as Cycle
    from octo.problem.hard import limits as limits
    from octo.problem.limits import BaseHeightRange as BaseHeightRange
    from octo.problem.limits import FrictionCones as FrictionCones
    from octo.problem.limits import JointLimits as JointLimits
    from octo.problem.limits import JointSpeedLimits as JointSpeedLimits
    from octo.problem.limits import StepLimit as StepLimit
    from octo.problem.limits import TiltLimit as TiltLimit
    from octo.problem.limits import TorqueLimits as TorqueLimits
    from octo.problem.phases import phases as phases
    from octo.problem.problem import Problem as Problem
    from octo.push import push as push
    from octo.replay import replay as replay
    from octo.result.solution import Solution as Solution
    from octo.soft_motions import soft_motion as soft_motion
    from octo.soft_motions import soft_replay as soft_replay
    from octo.solve import solve as solve
    from octo.solver.acceptance import Acceptance as Acceptance
    from octo.solver.options import SqpOptions as SqpOptions
    from octo.solver.status import Status as Status
    from octo.viewer import view as view
    from octo.world import shapes as shapes
    from octo.world.world import World as World


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = importlib.import_module(_MODULES[name])
    elif name in _HOME:
        value = getattr(importlib.import_module(_HOME[name]), name)
    else:
        near = " or ".join(difflib.get_close_matches(name, __all__, n=2))
        raise AttributeError(
            f"module 'octo' has no attribute {name!r}" + (f"; did you mean {near}?" if near else "")
        )
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


class _Package(types.ModuleType):
    """``octo.solve`` and ``octo.plot`` stay functions when the modules of those names are
    imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, types.ModuleType) and _HOME.get(name) == value.__name__:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
