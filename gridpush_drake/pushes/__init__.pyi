from .plausibility import check_plausible as check_plausible
from .push_log import ObservedPush as ObservedPush
from .push_log import PushLog as PushLog
from .scene_log import ObservedScenePush as ObservedScenePush
from .scene_log import SceneLog as SceneLog
from .segmentation import make_observed_push as make_observed_push
