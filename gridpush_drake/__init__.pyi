from .dynamics.motion import Motion as Motion
from .dynamics.physics import Physics as Physics
from .dynamics.push import ForcePush as ForcePush
from .dynamics.push import Push as Push
from .dynamics.simulation import simulate as simulate
from .dynamics.simulation import simulate_batch as simulate_batch
from .errors import GridPushError as GridPushError
from .identification.learning import identify as identify
from .identification.model import Model as Model
from .identification.model_file import read_model as read_model
from .identification.model_file import write_model as write_model
from .identification.prediction import predict as predict
from .identification.result import Identification as Identification
from .multibody.contact_material import SetPartner as SetPartner
from .multibody.grid_object import AddGridObject as AddGridObject
from .multibody.sdformat import WriteSdf as WriteSdf
from .objects.grid_object import GridObject as GridObject
from .objects.object_file import PhysicalPrior as PhysicalPrior
from .objects.object_file import list_shipped_objects as list_shipped_objects
from .objects.parameters import CellParameters as CellParameters
from .planning.contact.optimization import optimize_contact as optimize_contact
from .planning.goal.push_plan import plan_pushes as plan_pushes
from .planning.pregrasp.pregrasp_plan import plan_pregrasp as plan_pregrasp
from .planning.push_constraints import PushConstraints as PushConstraints
from .planning.support_surface import SupportSurface as SupportSurface
from .pushes.observed_push import ObservedPush as ObservedPush
from .pushes.push_log import PushLog as PushLog
from .station.schema.scenario import PushScenario as PushScenario
from .station.schema.scenario_file import read_scenario as read_scenario
from .station.simulated.push_station import MakePushStation as MakePushStation
from .systems.base.messages import GraspCommand as GraspCommand
from .systems.base.messages import PushCommand as PushCommand
from .systems.control.contact_point_controller import (
    ContactPointController as ContactPointController,
)
from .systems.control.poke_policy import PokePolicy as PokePolicy
from .systems.control.pregrasp_controller import PreGraspController as PreGraspController
from .systems.dynamics.grid_lcp_system import GridLcpSystem as GridLcpSystem
from .systems.execution.push_executor import PushExecutor as PushExecutor
from .systems.learning.grid_identifier import GridIdentifier as GridIdentifier
from .systems.sensing.planar_pose_sensor import PlanarPoseSensor as PlanarPoseSensor

__version__: str
