"""`RgbdInputs`: the input ports of a system that looks at the pictures of a camera."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.perception.images.frames import Frame

MAX_LABEL = 2**15
"""All labels in an `ImageLabel16I` are less than this."""


class RgbdInputs:
    """The input ports of a system that looks at the pictures of a color and depth camera."""

    def __init__(
        self, system: LeafSystem, width: int, height: int, occluded_by: Iterable[int]
    ) -> None:
        """Declares the ports `color_image`, `depth_image` and `label_image`.

        Only the first must be connected.

        Args:
            system: the system that gets the ports.
            width: width of the images, pixels.
            height: height of the images, pixels.
            occluded_by: labels, in `label_image`, of whatever may hide the object.
        """
        self._hidden = np.zeros(MAX_LABEL, dtype=bool)
        self._hidden[list(occluded_by)] = True
        self._color = system.DeclareAbstractInputPort(
            "color_image", Value(ImageRgba8U(width, height))
        )
        self._depth = system.DeclareAbstractInputPort(
            "depth_image", Value(ImageDepth32F(width, height))
        )
        self._labels = system.DeclareAbstractInputPort(
            "label_image", Value(ImageLabel16I(width, height))
        )

    def take_frame(self, context: Context) -> Frame:
        """Copies what is on the ports into a frame; without depth if that is not connected."""
        color: NDArray[np.uint8] = self._color.Eval(context).data[..., :3]
        depth: NDArray[np.float32] | None = None
        if self._depth.HasValue(context):
            depth = np.array(self._depth.Eval(context).data[..., 0])
        return Frame(np.array(color, order="C"), depth, context.get_time())

    def find_occluded(self, context: Context) -> NDArray[np.bool_] | None:
        """Finds the pixels (height, width) that show what may hide the object; None if unknown."""
        if not self._hidden.any() or not self._labels.HasValue(context):
            return None
        return self._hidden[self._labels.Eval(context).data[..., 0]]
