from .observed_push import ObservedPush as ObservedPush
from .plausibility import check_plausible as check_plausible
from .push_log import PushLog as PushLog
from .push_log import find_shipped_log as find_shipped_log
from .segmentation import make_observed_push as make_observed_push
from .weighings import LiftTest as LiftTest
from .weighings import MassTestLog as MassTestLog
from .weighings import TiltTest as TiltTest
