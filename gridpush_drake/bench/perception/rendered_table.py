"""Pictures of a table, an object and an arm's tip, as a color and depth camera sees them.

They are rendered by Drake's VTK engine, which needs neither display nor GPU, and have a depth
camera's noise. There are two lamps: one beside the camera, and one aside, which casts shadows.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    DepthRange,
    DepthRenderCamera,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    InMemoryMesh,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    QueryObject,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context
from pydrake.systems.sensors import CameraInfo
from shapely import Polygon

from gridpush_drake.geometry.outline_mesh import make_outline_mesh
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.perception import Camera, Frame
from gridpush_drake.perception.calibration.tags import draw_tag
from gridpush_drake.perception.images.camera import DRAKE_PIXEL_MIDDLE

PICTURE_WIDTH = 640
"""Width of the camera's pictures, pixels."""

HEIGHT_PIXELS = 480
"""Height of the camera's pictures, pixels."""

FOCAL_LENGTH = 615.0
"""Focal length of the camera, pixels."""

OBJECT_HEIGHT = 0.02
"""Height of the objects, m."""

OBJECT_COLORS = (
    (0.60, 0.35, 0.20),
    (0.15, 0.25, 0.55),
    (0.25, 0.25, 0.27),
    (0.75, 0.15, 0.15),
    (0.20, 0.45, 0.25),
)
"""Colors that the objects have in turn, red, green and blue from 0 to 1: wood, blue, dark gray,
red, green."""

RENDERER_NAME = "vtk"
"""Name of the renderer in the scene."""

TABLE_SIDE = 1.6
"""Side of the table, m."""

TABLE_THICKNESS = 0.02
"""Thickness of the table, m."""

TABLE_COLOR = (0.75, 0.74, 0.70)
"""Color of the table: red, green and blue, 0 to 1."""

ARM_COLOR = (0.2, 0.2, 0.22)
"""Color of the arm's tip: red, green and blue, 0 to 1."""

TABLE_LAMPS = (("camera", 0.75, (0.0, 0.0, 1.0)), ("world", 0.25, (0.3, 0.5, -1.0)))
"""Lamps: the frame in which each one's direction is given, its intensity, and its direction."""

SHADOW_MAP = 2048
"""Side of the picture on which shadows are computed, pixels. With Drake's default, objects shade
themselves in blocks."""

TAG_THICKNESS = 2e-4
"""Thickness of a tag's paper, and of the ink on it, m."""

PAPER_COLOR = (0.95, 0.95, 0.95)
"""Color of a tag's paper: red, green and blue, 0 to 1."""

INK_COLOR = (0.03, 0.03, 0.03)
"""Color of a tag's ink: red, green and blue, 0 to 1."""

ROD_LENGTH = 0.12
"""Length of the rod that pushes, m."""

HAND_SIDES = (0.08, 0.05, 0.06)
"""Sides of the hand that holds the rod, m."""

HAND_HEIGHT = 0.15
"""Height of the hand over the table, m."""

NEAR_CLIPPING = 0.05
"""Least distance from the camera at which anything is rendered, m."""

FAR_CLIPPING = 5.0
"""Greatest distance from the camera at which anything is rendered, m."""

COLOR_NOISE = 2.0
"""Standard deviation of the colors, of which 255 is the greatest."""

DEPTH_NOISE = 0.005
"""Standard deviation of a depth of 1 m, m; it grows with the distance squared."""

DEPTH_EDGE = 0.01
"""Step between neighboring pixels at which no depth is measured, m."""

TABLE_LABEL = 1
"""Label of the table's pixels."""

OBJECT_LABEL = 2
"""Label of the object's pixels."""

ARM_LABEL = 3
"""Label of the pixels of the arm's tip."""


class RenderedObject(NamedTuple):
    """An object on the table.

    Attributes:
        outline: its outline, body frame, m.
        height: its height, m.
        color: its color: red, green and blue, 0 to 1.
    """

    outline: Polygon
    height: float
    color: ArrayLike


def make_lights(lamps: Iterable[tuple[str, float, ArrayLike]]) -> list[LightParameter]:
    """Makes lights of lamps: the frame of each direction, the intensity and the direction."""
    return [
        LightParameter(
            type="directional",
            frame=frame,
            intensity=intensity,
            direction=np.asarray(direction, dtype=np.float64).tolist(),
        )
        for frame, intensity, direction in lamps
    ]


class RenderedScene:
    """What a camera sees of shapes, by Drake's VTK engine.

    Attributes:
        camera: a camera without distortion whose pose X_WC is known.
        graph: where shapes are added before the first picture.
        source: source of the shapes.
    """

    def __init__(self, camera: Camera, lights: list[LightParameter]) -> None:
        """Makes a scene without shapes, which these lights shine on with shadows."""
        self.camera = camera
        self.graph = SceneGraph()
        self.source = self.graph.RegisterSource("scene")
        parameters = RenderEngineVtkParams(
            lights=lights, cast_shadows=True, shadow_map_size=SHADOW_MAP
        )
        self.graph.AddRenderer(RENDERER_NAME, MakeRenderEngineVtk(parameters))
        K = camera.K
        center = K[:2, 2] + DRAKE_PIXEL_MIDDLE
        info = CameraInfo(camera.width, camera.height, K[0, 0], K[1, 1], *center)
        core = RenderCameraCore(
            RENDERER_NAME, info, ClippingRange(NEAR_CLIPPING, FAR_CLIPPING), RigidTransform()
        )
        self._color_camera = ColorRenderCamera(core, False)
        self._depth_camera = DepthRenderCamera(core, DepthRange(NEAR_CLIPPING, FAR_CLIPPING))
        self._at = (self.graph.world_frame_id(), RigidTransform(camera.pose))

    @cached_property
    def context(self) -> Context:
        """Where the frames' poses are set; made once all shapes are there."""
        return self.graph.CreateDefaultContext()

    def render_color(self) -> NDArray[np.uint8]:
        """Renders colors, (height, width, 3), 0 to 255."""
        image = self._query.RenderColorImage(self._color_camera, *self._at)
        return np.array(image.data[..., :3])

    def render_labels(self) -> NDArray[np.int16]:
        """Renders the labels of the shapes that are seen, (height, width)."""
        image = self._query.RenderLabelImage(self._color_camera, *self._at)
        return np.array(image.data[..., 0])

    def render_depth(self) -> NDArray[np.float64]:
        """Renders depth, (height, width), m."""
        image = self._query.RenderDepthImage(self._depth_camera, *self._at)
        return np.array(image.data[..., 0], dtype=np.float64)

    @property
    def _query(self) -> QueryObject:
        return self.graph.get_query_output_port().Eval(self.context)


class RenderedTable:
    """The scene; each look is a pure function of the poses and a seed."""

    def __init__(
        self,
        outline: Polygon,
        height: float,
        color: ArrayLike,
        camera: Camera,
        rod_radius: float | None = None,
        tag: tuple[int, float] | None = None,
        others: Sequence[RenderedObject] = (),
    ) -> None:
        """Makes the scene.

        Args:
            outline: outline of the object, body frame, m.
            height: height of the object, m.
            color: color of the object: red, green and blue, 0 to 1.
            camera: a camera without distortion whose pose X_WC is known.
            rod_radius: radius of the rod that an arm's hand holds, m; None without an arm.
            tag: number and side, m, of an AprilTag on the object, level over the middle of its
                outline's bounds; None without one.
            others: other objects on the table.
        """
        self.camera = camera
        self._scene = RenderedScene(camera, make_lights(TABLE_LAMPS))
        self._add(
            None,
            Box(TABLE_SIDE, TABLE_SIDE, TABLE_THICKNESS),
            TABLE_COLOR,
            TABLE_LABEL,
            [0, 0, -TABLE_THICKNESS / 2],
        )
        self._object = self._add_prism("object", RenderedObject(outline, height, color))
        self._others = [
            self._add_prism(f"other_{number}", other) for number, other in enumerate(others)
        ]
        if tag is not None:
            self._add_tag(*tag, [*np.reshape(outline.bounds, (2, 2)).mean(axis=0), height])
        self._arm = None if rod_radius is None else self._add_frame("arm")
        if rod_radius is not None:
            self._add(
                self._arm,
                Cylinder(rod_radius, ROD_LENGTH),
                ARM_COLOR,
                ARM_LABEL,
                [0, 0, ROD_LENGTH / 2],
            )
            self._add(self._arm, Box(*HAND_SIDES), ARM_COLOR, ARM_LABEL, [0, 0, HAND_HEIGHT])

    def look(
        self,
        pose: ArrayLike,
        tip: ArrayLike | None = None,
        *,
        seed: int = 0,
        t: float = 0.0,
        depth: bool = True,
        others: Sequence[ArrayLike] = (),
    ) -> tuple[Frame, NDArray[np.bool_]]:
        """Takes a frame.

        Args:
            pose: (3,) of the object, W.
            tip: (2,) of the rod, W, m; None where the arm is away.
            seed: of the noise.
            t: of the frame, s.
            depth: whether there is a depth camera.
            others: (3,) pose of each other object, W.

        Returns:
            The frame, and (height, width) where the arm is in it.
        """
        poses = FramePoseVector()
        frames = (self._object, *self._others)
        for frame, at_pose in zip(frames, (pose, *others), strict=True):
            x, y, theta = np.asarray(at_pose, dtype=np.float64)
            poses.set_value(frame, RigidTransform(RollPitchYaw(0, 0, theta), [x, y, 0.0]))
        if self._arm is not None:
            at = (
                [FAR_CLIPPING, FAR_CLIPPING, 0.0]
                if tip is None
                else [*np.asarray(tip, dtype=np.float64), 0.0]
            )
            poses.set_value(self._arm, RigidTransform(at))
        scene = self._scene
        scene.graph.get_source_pose_port(scene.source).FixValue(scene.context, poses)
        color = scene.render_color()
        rng = np.random.default_rng(seed)
        noise = COLOR_NOISE * rng.standard_normal(color.shape)
        noisy = np.clip(color + noise, 0, 255).astype(np.uint8)
        measured = None
        if depth:
            measured = add_depth_noise(scene.render_depth(), rng)
        return Frame(noisy, measured, t), scene.render_labels() == ARM_LABEL

    def _add_frame(self, name: str) -> FrameId:
        return self._scene.graph.RegisterFrame(self._scene.source, GeometryFrame(name))

    def _add_prism(self, name: str, prism: RenderedObject) -> FrameId:
        """Adds an object; returns its frame."""
        mesh = make_outline_mesh(prism.outline, prism.height, normals=True)
        file = MemoryFile(mesh, ".obj", f"{name}.obj")
        frame = self._add_frame(name)
        shape = Mesh(InMemoryMesh(mesh_file=file))
        self._add(frame, shape, prism.color, OBJECT_LABEL, [0, 0, 0], name)
        return frame

    def _add_tag(self, number: int, size: float, at: list[float]) -> None:
        """Adds a white plate, with a margin of one bit, and on it the tag's black bits."""
        bits = draw_tag(number)
        bit = size / len(bits)
        x, y, z = at
        self._add(
            self._object,
            Box(size + 2 * bit, size + 2 * bit, TAG_THICKNESS),
            PAPER_COLOR,
            OBJECT_LABEL,
            [x, y, z + TAG_THICKNESS / 2],
        )
        for row, column in np.argwhere(bits == 0):
            right, up = (np.array([column, len(bits) - 1 - row]) - (len(bits) - 1) / 2) * bit
            ink = [x + right, y + up, z + TAG_THICKNESS]
            self._add(
                self._object,
                Box(bit, bit, TAG_THICKNESS),
                INK_COLOR,
                OBJECT_LABEL,
                ink,
                f"bit_{row}_{column}",
            )

    def _add(
        self,
        frame: FrameId | None,
        shape: Shape,
        color: ArrayLike,
        label: int,
        at: ArrayLike,
        name: str = "",
    ) -> None:
        """Adds a shape at a place (3,) of a frame, or of the world where that is None."""
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(*np.asarray(color, dtype=np.float64), 1.0))
        properties.AddProperty("label", "id", RenderLabel(label))
        name = name or f"{type(shape).__name__}_{label}"
        instance = GeometryInstance(RigidTransform(np.asarray(at, dtype=np.float64)), shape, name)
        instance.set_perception_properties(properties)
        graph = self._scene.graph
        graph.RegisterGeometry(self._scene.source, frame or graph.world_frame_id(), instance)


def add_depth_noise(z: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Makes of a depth (height, width), m, what a depth camera would measure.

    Its noise grows with the distance squared, and there are holes, 0 m, at edges.
    """
    noisy = np.where(np.isfinite(z), z, 0.0)
    edge = np.zeros(z.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(noisy, axis=axis)) > DEPTH_EDGE
        edge |= np.insert(step, 0, False, axis=axis) | np.insert(
            step, step.shape[axis], False, axis=axis
        )
    noisy += DEPTH_NOISE * noisy**2 * rng.standard_normal(z.shape)
    noisy[edge] = 0.0
    return noisy.astype(np.float32)


def make_overhead_camera(
    distance: float, tilt: ArrayLike = (0.0, 0.0), at: ArrayLike = (0.0, 0.0)
) -> Camera:
    """Makes a camera that looks down at the table.

    Args:
        distance: its height over the table, m.
        tilt: (2,) its tilt about its own x and y, degrees.
        at: (2,) the place that it is above, m.
    """
    a, b = np.radians(tilt)
    R_x = np.array([[1, 0, 0], [0, -np.cos(a), np.sin(a)], [0, -np.sin(a), -np.cos(a)]])
    R_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    X_WC = np.eye(4)
    X_WC[:3, :3] = R_x @ R_y
    X_WC[:3, 3] = [*np.asarray(at), distance]
    K = [
        [FOCAL_LENGTH, 0, (PICTURE_WIDTH - 1) / 2],
        [0, FOCAL_LENGTH, (HEIGHT_PIXELS - 1) / 2],
        [0, 0, 1],
    ]
    return Camera(PICTURE_WIDTH, HEIGHT_PIXELS, np.array(K), np.zeros(0), X_WC)


def load_object(name: str) -> GridObject:
    """Reads a shipped object by its name."""
    return GridObject.from_yaml(find_shipped_object(name))
