"""Pictures of objects that a tip pushes while an arm hides them."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from gridpush_drake.perception import Frame
from tests.helpers.pictures import make_camera, paint

HEIGHT, PERIOD, ARM = 0.03, 0.1, 7
WIDTH, ROWS = 640, 480
HIDDEN = (0.05, 1.65)
"""When the arm hides everything, s."""


@lru_cache(maxsize=64)
def paint_prisms(prisms: tuple[tuple[bytes, bytes], ...], seed: int) -> Frame:
    """Paints objects (outline, pose), each as the bytes of its numbers; each picture only once.

    Color and depth are of one picture, and several runs show the same pictures.
    """
    painted = [
        (np.frombuffer(outline).reshape(-1, 2), np.frombuffer(pose), HEIGHT, (150, 120, 80))
        for outline, pose in prisms
    ]
    return paint(make_camera(), painted, seed=seed)


class HiddenPictures(LeafSystem):
    """Pictures of the objects, labels of the arm, and the state of the tip."""

    def __init__(
        self,
        outlines: Sequence[np.ndarray],
        calc_poses: Callable[[float], Sequence[np.ndarray]],
        push: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Takes the outlines, where the objects are at a time, and times (K,) and places (K, 2) of the tip."""
        super().__init__()
        self._outlines, self._calc_poses, self._push = outlines, calc_poses, push
        for name, image in (
            ("color", ImageRgba8U(WIDTH, ROWS)),
            ("depth", ImageDepth32F(WIDTH, ROWS)),
            ("label", ImageLabel16I(WIDTH, ROWS)),
        ):
            self.DeclareAbstractOutputPort(
                name, lambda image=image: Value(image), getattr(self, f"_show_{name}")
            )
        self.DeclareVectorOutputPort("tip", 6, self._show_tip)

    def _take(self, context: Context):
        time = context.get_time()
        prisms = tuple(
            (outline.tobytes(), np.asarray(pose).tobytes())
            for outline, pose in zip(self._outlines, self._calc_poses(time), strict=True)
        )
        return paint_prisms(prisms, round(time / PERIOD))

    def _show_color(self, context: Context, output) -> None:
        image = ImageRgba8U(WIDTH, ROWS)
        image.mutable_data[..., :3] = self._take(context).color
        output.set_value(image)

    def _show_depth(self, context: Context, output) -> None:
        image = ImageDepth32F(WIDTH, ROWS)
        image.mutable_data[..., 0] = self._take(context).depth
        output.set_value(image)

    def _show_label(self, context: Context, output) -> None:
        image = ImageLabel16I(WIDTH, ROWS)
        hidden = HIDDEN[0] < context.get_time() < HIDDEN[1]
        image.mutable_data[:] = ARM if hidden else 1
        output.set_value(image)

    def _show_tip(self, context: Context, output) -> None:
        t, xy = self._push
        place = [np.interp(context.get_time(), t, xy[:, i]) for i in range(2)]
        output.SetFromVector([*place, 0.01, 0.0, 0.0, 0.0])
