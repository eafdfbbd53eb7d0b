"""Every term of E by one import path, and the lists of terms that go together."""

from octo.problem.at import At
from octo.problem.body_costs import (
    BaseAngularVelocity,
    BaseHeight,
    BaseOrientation,
    CenterOfMassDisplacement,
    CenterOfMassPosition,
    CenterOfMassVelocity,
    PointPosition,
    PointVelocity,
    Upright,
)
from octo.problem.contact_costs import (
    BodyLoad,
    Clearance,
    ContactCost,
    FootLift,
    ForceRate,
    FrictionCone,
    LoadSharing,
    Slip,
    SlipPower,
    SwingClearance,
)
from octo.problem.costs import Cost, CustomCost, NeighbourCost, StepPairCost
from octo.problem.joint_costs import (
    Effort,
    JointAcceleration,
    JointLimit,
    JointSpeedLimit,
    JointVelocity,
    PoseTarget,
    Posture,
    TorqueLimit,
    TorqueRate,
)
from octo.problem.losses import Huber, Loss
from octo.problem.presets import locomotion, natural, paper, robot
from octo.problem.symbols import ContactSymbols, Setting, StepSymbols
from octo.problem.terms import Row

__all__ = [
    "At",
    "BaseAngularVelocity",
    "BaseHeight",
    "BaseOrientation",
    "BodyLoad",
    "CenterOfMassDisplacement",
    "CenterOfMassPosition",
    "CenterOfMassVelocity",
    "Clearance",
    "ContactCost",
    "ContactSymbols",
    "Cost",
    "CustomCost",
    "Effort",
    "FootLift",
    "ForceRate",
    "FrictionCone",
    "Huber",
    "JointAcceleration",
    "JointLimit",
    "JointSpeedLimit",
    "JointVelocity",
    "LoadSharing",
    "Loss",
    "NeighbourCost",
    "PointPosition",
    "PointVelocity",
    "PoseTarget",
    "Posture",
    "Row",
    "Setting",
    "Slip",
    "SlipPower",
    "StepPairCost",
    "StepSymbols",
    "SwingClearance",
    "TorqueLimit",
    "TorqueRate",
    "Upright",
    "locomotion",
    "natural",
    "paper",
    "robot",
]
