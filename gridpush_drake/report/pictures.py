"""Pictures as PNG files: of an object, of a model, of a motion."""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.grid.object import GridObject
from gridpush_drake.identification.result import Identification
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.figures import draw_object_parts, draw_path
from gridpush_drake.report.maps import draw_learned_maps


def draw_object(obj: GridObject) -> bytes:
    """The object with its parts, as PNG."""
    return to_png(draw_object_parts(obj))


def draw_model(result: Identification) -> bytes:
    """Relative friction and mass of a learned model beside their standard deviations, as PNG."""
    return to_png(draw_learned_maps(result))


def draw_motion(obj: GridObject, push: Push, poses: NDArray[np.float64]) -> bytes:
    """An object's motion (T+1, 3) under a push, as PNG."""
    return to_png(draw_path(obj, push, poses))
