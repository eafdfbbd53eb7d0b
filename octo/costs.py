"""Every term of E by one import path, and the lists of terms that go together."""

from octo.problem.body_costs import BaseAngularVelocity as BaseAngularVelocity
from octo.problem.body_costs import BaseHeight as BaseHeight
from octo.problem.body_costs import BaseOrientation as BaseOrientation
from octo.problem.body_costs import CenterOfMassDisplacement as CenterOfMassDisplacement
from octo.problem.body_costs import CenterOfMassPosition as CenterOfMassPosition
from octo.problem.body_costs import CenterOfMassVelocity as CenterOfMassVelocity
from octo.problem.body_costs import PointPosition as PointPosition
from octo.problem.body_costs import PointVelocity as PointVelocity
from octo.problem.body_costs import Upright as Upright
from octo.problem.contact_costs import BodyLoad as BodyLoad
from octo.problem.contact_costs import Clearance as Clearance
from octo.problem.contact_costs import ContactCost as ContactCost
from octo.problem.contact_costs import FootLift as FootLift
from octo.problem.contact_costs import ForceRate as ForceRate
from octo.problem.contact_costs import FrictionCone as FrictionCone
from octo.problem.contact_costs import LoadSharing as LoadSharing
from octo.problem.contact_costs import Slip as Slip
from octo.problem.contact_costs import SlipPower as SlipPower
from octo.problem.contact_costs import SwingClearance as SwingClearance
from octo.problem.costs import Cost as Cost
from octo.problem.costs import CustomCost as CustomCost
from octo.problem.costs import NeighbourCost as NeighbourCost
from octo.problem.costs import StepPairCost as StepPairCost
from octo.problem.joint_costs import Effort as Effort
from octo.problem.joint_costs import JointAcceleration as JointAcceleration
from octo.problem.joint_costs import JointLimit as JointLimit
from octo.problem.joint_costs import JointSpeedLimit as JointSpeedLimit
from octo.problem.joint_costs import JointVelocity as JointVelocity
from octo.problem.joint_costs import PoseTarget as PoseTarget
from octo.problem.joint_costs import Posture as Posture
from octo.problem.joint_costs import TorqueLimit as TorqueLimit
from octo.problem.joint_costs import TorqueRate as TorqueRate
from octo.problem.losses import Huber as Huber
from octo.problem.losses import Loss as Loss
from octo.problem.presets import locomotion as locomotion
from octo.problem.presets import natural as natural
from octo.problem.presets import paper as paper
from octo.problem.presets import robot as robot
from octo.problem.symbols import ContactSymbols as ContactSymbols
from octo.problem.symbols import Setting as Setting
from octo.problem.symbols import StepSymbols as StepSymbols

__all__ = [name for name in dir() if not name.startswith("_")]
