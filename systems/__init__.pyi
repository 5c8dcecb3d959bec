from .arm_guard import ArmGuard as ArmGuard
from .arm_guard import GuardLimits as GuardLimits
from .arm_guard import GuardMode as GuardMode
from .arm_guard import GuardStatus as GuardStatus
from .contact_point_controller import ContactPointController as ContactPointController
from .estimate_visualizer import EstimateVisualizer as EstimateVisualizer
from .grasp_executor import GraspExecutor as GraspExecutor
from .grid_identifier import GridIdentifier as GridIdentifier
from .grid_lcp_system import GridLcpSystem as GridLcpSystem
from .messages import GraspCommand as GraspCommand
from .messages import GraspOutcome as GraspOutcome
from .messages import GraspPhase as GraspPhase
from .messages import GraspStatus as GraspStatus
from .messages import PushCommand as PushCommand
from .messages import PushPhase as PushPhase
from .messages import PushStatus as PushStatus
from .object_controller import AbstractStateSystem as AbstractStateSystem
from .object_controller import ObjectController as ObjectController
from .object_detector import Detection as Detection
from .object_detector import DetectorState as DetectorState
from .object_detector import ObjectDetector as ObjectDetector
from .object_detector import ObjectNaming as ObjectNaming
from .object_pose_estimator import ObjectPoseEstimator as ObjectPoseEstimator
from .planar_manipuland_status import (
    PlanarManipulandStatusReceiver as PlanarManipulandStatusReceiver,
)
from .planar_manipuland_status import PlanarManipulandStatusSender as PlanarManipulandStatusSender
from .planar_pose_sensor import PlanarPoseSensor as PlanarPoseSensor
from .poke_policy import PokePolicy as PokePolicy
from .poke_policy import PokeRegion as PokeRegion
from .pregrasp_controller import PreGraspController as PreGraspController
from .push_executor import PushExecutor as PushExecutor
from .pusher_gate import PusherGate as PusherGate
from .pusher_state_sensor import ArmTipSensor as ArmTipSensor
from .pusher_state_sensor import PusherStateSensor as PusherStateSensor
from .rgbd_noise import RgbdNoise as RgbdNoise
from .true_parameters import TrueParameters as TrueParameters
from .worker import Worker as Worker
