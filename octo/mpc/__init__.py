"""Receding-horizon control: a plan from every measurement, and the loop around it."""

from octo.model.convention import Convention
from octo.mpc.animation import animate
from octo.mpc.command import Command, CommandStatus
from octo.mpc.controller import Controller
from octo.mpc.ground import smooth_ground
from octo.mpc.log import Log
from octo.mpc.loop import Push, run
from octo.mpc.plan import Plan
from octo.mpc.stance import stance
from octo.mpc.tracking import StrideReference, tracking_problem
from octo.mpc.walking import VelocityCommand, foot_law, walking_problem

__all__ = [
    "Command",
    "CommandStatus",
    "Controller",
    "Convention",
    "Log",
    "Plan",
    "Push",
    "StrideReference",
    "VelocityCommand",
    "animate",
    "foot_law",
    "run",
    "smooth_ground",
    "stance",
    "tracking_problem",
    "walking_problem",
]
