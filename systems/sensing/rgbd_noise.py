"""`RgbdNoise`: makes rendered pictures noisy, and without depth along edges, as real ones are."""

import cv2
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.perception.images.picture_noise import add_color_noise, add_depth_noise

NEIGHBOR_WINDOW = np.ones((3, 3), np.uint8)
"""A pixel and its neighbors: if depth jumps among them, the pixel's depth is not measured."""


class RgbdNoise(LeafSystem):
    """Adds noise to the pictures of an ideal color and depth camera.

    .. pydrake_system::

        name: RgbdNoise
        input_ports:
        - color_image
        - depth_image
        output_ports:
        - color_image
        - depth_image

    * color_image: abstract `ImageRgba8U`, in and out. All values of a picture are off by a common
      factor, its exposure, and each value by noise of its own.
    * depth_image: abstract `ImageDepth32F`, m, in and out. The standard deviation of the noise
      grows with the square of the depth, sigma(z) = s z^2. A pixel at which depth jumps is not
      measured, and becomes 0.

    The noise of a picture depends on its number, time / period, and on the seed alone, which is
    numeric parameter 0: a Context and its clone see the same.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        width: int,
        height: int,
        period: float,
        *,
        depth_noise: float = 0.0,
        depth_edge: float = np.inf,
        color_noise: float = 0.0,
        exposure_noise: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Declares the system.

        Args:
            width: width of the images, pixels.
            height: height of the images, pixels.
            period: time between two pictures, s.
            depth_noise: s in the equation above, 1/m.
            depth_edge: jump of depth between neighbors from which on it is not measured, m.
            color_noise: standard deviation of a color's value, of 255.
            exposure_noise: standard deviation of the exposure's factor, which is 1 in the mean.
            seed: seed of the noise.
        """
        super().__init__()
        self._size = (width, height)
        self._period = period
        self._depth_noise = depth_noise
        self._depth_edge = depth_edge
        self._color_noise = color_noise
        self._exposure_noise = exposure_noise
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        color = ImageRgba8U(width, height)
        depth = ImageDepth32F(width, height)
        self._color = self.DeclareAbstractInputPort("color_image", Value(color))
        self._depth = self.DeclareAbstractInputPort("depth_image", Value(depth))
        self.DeclareAbstractOutputPort(
            "color_image", lambda: Value(color), weakly(self._calc_color)
        )
        self.DeclareAbstractOutputPort(
            "depth_image", lambda: Value(depth), weakly(self._calc_depth)
        )

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the noise in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._seed).SetFromVector([float(seed)])

    def _make_generator(self, context: Context, stream: int) -> np.random.Generator:
        """Makes the generator of the present picture's noise: stream 0 for color, 1 for depth."""
        seed = int(context.get_numeric_parameter(self._seed).value()[0])
        return np.random.default_rng((seed, stream, round(context.get_time() / self._period)))

    def _calc_color(self, context: Context, output: Value) -> None:
        rng = self._make_generator(context, 0)
        exposure = 1.0 + self._exposure_noise * rng.standard_normal()
        add_color_noise(
            rendered=self._color.Eval(context).data,
            exposure=exposure,
            deviation=self._color_noise,
            rng=rng,
            noisy=output.get_mutable_value().mutable_data,
        )

    def _calc_depth(self, context: Context, output: Value) -> None:
        rendered: NDArray[np.float32] = self._depth.Eval(context).data[..., 0]
        measured = np.isfinite(rendered) & (rendered > 0)
        z = np.where(measured, rendered, np.float32(0.0))

        # Where depth jumps among a pixel and its neighbors, it is not measured.
        jump = cv2.dilate(z, NEIGHBOR_WINDOW) - cv2.erode(z, NEIGHBOR_WINDOW)
        add_depth_noise(
            z=z,
            measured=measured & (jump < self._depth_edge),
            deviation=self._depth_noise,
            rng=self._make_generator(context, 1),
            noisy=output.get_mutable_value().mutable_data[..., 0],
        )
