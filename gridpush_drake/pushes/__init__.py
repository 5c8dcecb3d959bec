"""What was observed: the push log and its CSV form, a stream cut into pushes, and importers of public data sets.

The names below are imported on first use.
"""

from typing import TYPE_CHECKING

from gridpush_drake.lazy import make_lazy_names

if TYPE_CHECKING:
    from gridpush_drake.pushes.plausibility import check_plausible
    from gridpush_drake.pushes.push_log import ObservedPush, PushLog
    from gridpush_drake.pushes.segmentation import make_observed_push

__all__ = ["ObservedPush", "PushLog", "check_plausible", "make_observed_push"]

_HOMES = {
    "ObservedPush": "push_log",
    "PushLog": "push_log",
    "check_plausible": "plausibility",
    "make_observed_push": "segmentation",
}

__getattr__ = make_lazy_names(globals(), _HOMES)
