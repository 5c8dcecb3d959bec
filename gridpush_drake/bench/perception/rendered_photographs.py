"""Photographs of generated objects, rendered with materials, light and a stereo camera's depth.

Neither outlines nor materials are those of the shipped objects. They are split in two halves by
outline and material: one to choose settings by, the other to report by. Everything is drawn from
the number of a photograph and its half alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.geometry import GeometryInstance, Mesh, PerceptionProperties, RenderLabel
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr
from shapely import Point, Polygon, affinity

from gridpush_drake.bench.perception.material_mesh import Material, make_plane_mesh, make_prism_mesh
from gridpush_drake.bench.perception.rendered_table import (
    RenderedScene,
    make_lights,
    make_overhead_camera,
)
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception import Camera, Frame
from gridpush_drake.perception.images.frames import Mask
from gridpush_drake.units import MM_PER_M

Image = NDArray[np.float32]
Half = str
"""Which half a photograph is of: "tuning" or "reporting"."""

HALF_NAMES = ("tuning", "reporting")
"""Both halves."""

OUTLINE_KINDS = {
    "tuning": ("wrench", "tube", "spatula"),
    "reporting": ("fork", "clamp", "bottle"),
}
"""Kinds of outlines in each half."""


class Surface(NamedTuple):
    """A material, and what a stereo camera makes of it.

    Attributes:
        name: what it is.
        material: how it looks.
        holes: fraction of its surface on which no depth is measured.
        printed: whether something is printed on it.
        mirrors: whether the room is reflected in it.
    """

    name: str
    material: Material
    holes: float
    printed: bool = False
    mirrors: bool = False


SURFACE_KINDS = {
    "tuning": (
        Surface("brushed steel", Material((0.7, 0.7, 0.7), 0.0, 0.5), 0.35, mirrors=True),
        Surface("black rubber", Material((0.02, 0.02, 0.022), 0.0, 0.8), 0.5),
        Surface("white plastic", Material((0.80, 0.80, 0.78), 0.0, 0.4), 0.02, printed=True),
        Surface("red plastic", Material((0.55, 0.05, 0.04), 0.0, 0.4), 0.02),
        Surface("light wood", Material((0.55, 0.38, 0.20), 0.0, 0.7), 0.0),
    ),
    "reporting": (
        Surface("chrome", Material((0.85, 0.85, 0.87), 0.0, 0.3), 0.6, mirrors=True),
        Surface("gray rubber", Material((0.06, 0.06, 0.065), 0.0, 0.9), 0.35),
        Surface("white tube", Material((0.85, 0.85, 0.85), 0.0, 0.25), 0.05, printed=True),
        Surface("blue plastic", Material((0.05, 0.12, 0.45), 0.0, 0.35), 0.02),
        Surface("dark wood", Material((0.22, 0.12, 0.06), 0.0, 0.6), 0.0),
    ),
}
"""Materials of the objects in each half."""

TABLE_KINDS = ("gray", "white", "wooden", "patterned")
"""Kinds of tables, in both halves."""

TABLE_SIDE = 2.0
"""Side of the table, m."""

TEXTURE_SIZE = 512
"""Side of the pictures of textures, pixels."""

TILE_SIZE = 0.5
"""Side of the table that one picture of a texture covers, m."""

OBJECT_HEIGHTS = (0.004, 0.035)
"""Range of the heights of the objects, m."""

CAMERA_HEIGHTS = (0.45, 0.65)
"""Range of the heights of the camera above the table, m."""

MAX_CAMERA_TILT = 5.0
"""Greatest tilt of the camera about each axis, degrees."""

LAMP_COUNT = 5
"""Number of lamps that soft light comes from."""

FILL_LIGHT_RANGE = (0.8, 2.0)
"""Range of the strength of the room's light, over that of the lamps."""

STEREO_BASELINE = 0.05
"""Distance of the two eyes of the stereo camera, m."""

DISPARITY_STEP = 0.125
"""Step in which the stereo camera measures disparities, pixels."""

DEPTH_WAVE_AMPLITUDE = 0.0015
"""Amplitude of the slow waves in depth, m."""

WAVE_LENGTH = 60.0
"""Standard deviation of the blur that makes these waves, pixels."""

WAVE_PIXEL_SIZE = 8
"""Side of the pixels on which they are made, in pixels of the picture."""

FATTENING_WIDTH = 5
"""Width of the window whose nearest depth a stereo camera tells, pixels."""

TABLE_LABEL = 1
"""Label of the table."""

OBJECT_LABEL = 2
"""Label of the object's first part; others have the numbers after it."""


@dataclass(frozen=True, eq=False)
class RenderedPhotograph:
    """A rendered photograph.

    Attributes:
        name: what is in it.
        frame: color and depth.
        mask: (height, width) bool, the pixels that show the object.
        camera: camera that took it, without its pose, as `gridpush object` knows it.
    """

    name: str
    frame: Frame
    mask: Mask
    camera: Camera


def take_photograph(half: Half, number: int) -> RenderedPhotograph:
    """Renders a photograph.

    Args:
        half: "tuning" or "reporting".
        number: number of the photograph, from which everything in it is drawn.

    Returns:
        The photograph.
    """
    rng = np.random.default_rng((HALF_NAMES.index(half), number))
    kind = OUTLINE_KINDS[half][number % len(OUTLINE_KINDS[half])]
    table = TABLE_KINDS[rng.integers(len(TABLE_KINDS))]
    outline = make_outline(kind, rng)
    surfaces = [SURFACE_KINDS[half][k] for k in rng.permutation(len(SURFACE_KINDS[half]))[:2]]
    parts = _split(outline, rng)
    height = float(rng.uniform(*OBJECT_HEIGHTS))
    tilt = rng.uniform(-MAX_CAMERA_TILT, MAX_CAMERA_TILT, 2)
    camera = make_overhead_camera(float(rng.uniform(*CAMERA_HEIGHTS)), tilt)

    # The scene: the table and one or two parts of the object, each of a material of its own.
    meshes = [make_plane_mesh(TABLE_SIDE, _make_table(table, rng), TILE_SIZE)]
    for part, surface in zip(parts, surfaces, strict=False):
        material = surface.material
        if surface.printed:
            material = material._replace(texture=_make_print(rng))
        if surface.mirrors:
            material = material._replace(texture=_make_reflection(rng))
        meshes.append(make_prism_mesh(part, height, material, TILE_SIZE / 4))
    color, labels, z = _render(meshes, camera, rng)
    mask = labels >= OBJECT_LABEL
    holes = np.zeros(labels.shape, dtype=np.float32)
    for k, surface in enumerate(surfaces[: len(parts)]):
        holes[labels == OBJECT_LABEL + k] = surface.holes
    names = " and ".join(surface.name for surface in surfaces[: len(parts)])
    return RenderedPhotograph(
        name=f"{half} {number}: {kind} of {names} on a {table} table",
        frame=Frame(_take_color(color, rng), _take_depth(z, holes, camera, rng), 0.0),
        mask=mask,
        camera=Camera(camera.width, camera.height, camera.K, np.zeros(0)),
    )


def make_outline(kind: str, rng: np.random.Generator) -> Polygon:
    """Makes the outline of a generated object, somewhere near the middle of the table.

    Args:
        kind: one of those in OUTLINE_KINDS.
        rng: generator of its sizes and of where it lies.

    Returns:
        The outline, W, m.
    """
    length = rng.uniform(0.12, 0.20)
    width = rng.uniform(0.012, 0.03)
    handle = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    head = rng.uniform(0.9, 1.4) * width
    if kind == "wrench":
        ring = Point(length / 2, 0).buffer(head) - Point(length / 2, 0).buffer(0.5 * head)
        jaw = Point(-length / 2, 0).buffer(head)
        jaw -= shapely.box(-length / 2 - 2 * head, -0.4 * head, -length / 2, 0.4 * head)
        outline = shapely.union_all([handle.buffer(-0.1 * width), ring, jaw])
    elif kind == "tube":
        low = rng.uniform(0.5, 0.8) * width
        body = [(-length / 2, -width), (length / 2, -low), (length / 2, low), (-length / 2, width)]
        cap = shapely.box(length / 2, -0.5 * low, length / 2 + width, 0.5 * low)
        outline = shapely.union_all([Polygon(body), cap])
    elif kind == "spatula":
        blade = shapely.box(length / 2, -1.5 * width, length / 2 + 3 * width, 1.5 * width)
        slots = [
            shapely.box(
                length / 2 + 0.6 * width,
                y - 0.15 * width,
                length / 2 + 2.4 * width,
                y + 0.15 * width,
            )
            for y in (-0.8 * width, 0.0, 0.8 * width)
        ]
        outline = shapely.union_all([handle, blade.buffer(0.3 * width)])
        outline -= shapely.union_all(slots)
    elif kind == "fork":
        tines = [
            shapely.box(length / 2, y - 0.25 * width, length / 2 + 3 * width, y + 0.25 * width)
            for y in (-0.9 * width, 0.0, 0.9 * width)
        ]
        root = shapely.box(
            length / 2 - 0.5 * width, -1.15 * width, length / 2 + width, 1.15 * width
        )
        outline = shapely.union_all([handle, root, *tines])
    elif kind == "clamp":
        opening = rng.uniform(8.0, 20.0)
        arms = [affinity.rotate(handle, side * opening, origin=(0, 0)) for side in (-1, 1)]
        outline = shapely.union_all([*arms, Point(0, 0).buffer(1.2 * width)])
    else:
        body = shapely.box(-length / 2, -1.5 * width, 0.2 * length, 1.5 * width).buffer(0.3 * width)
        neck = shapely.box(0.2 * length, -0.5 * width, length / 2, 0.5 * width)
        outline = shapely.union_all([body, neck])
    rounded = outline.buffer(0.001).buffer(-0.001)
    biggest = max(shapely.get_parts(rounded), key=lambda piece: piece.area)
    turned = affinity.rotate(biggest, rng.uniform(0, 360), origin="centroid")
    center = np.array(turned.centroid.coords[0])
    shift = rng.uniform(-0.03, 0.03, 2) - center
    return Polygon(affinity.translate(turned, *shift).simplify(1e-4))


def _split(outline: Polygon, rng: np.random.Generator) -> list[Polygon]:
    """Cuts an outline in two across its longer side, in two cases of three."""
    if rng.uniform() < 1 / 3:
        return [outline]
    box = np.array(outline.minimum_rotated_rectangle.exterior.coords)
    sides = np.linalg.norm(np.diff(box, axis=0), axis=1)
    k = int(np.argmax(sides[:2]))
    along = (box[k + 1] - box[k]) / sides[k]
    at = box[k] + along * sides[k] * rng.uniform(0.35, 0.65)
    across = np.array([-along[1], along[0]])
    half = [at - across, at + across, at + across + along, at - across + along]
    parts = [outline.intersection(Polygon(half)), outline.difference(Polygon(half))]
    pieces = [max(shapely.get_parts(part), key=lambda piece: piece.area) for part in parts]
    # A cut that leaves loose pieces would change the outline.
    if sum(piece.area for piece in pieces) < (1 - 1e-6) * outline.area:
        return [outline]
    return pieces


def _make_noise(rng: np.random.Generator, deviation: tuple[float, float]) -> Array:
    """Makes smooth noise (TEXTURE_SIZE, TEXTURE_SIZE) of standard deviation 1 that repeats."""
    noise = gaussian_filter(
        rng.standard_normal((TEXTURE_SIZE, TEXTURE_SIZE)), deviation, mode="wrap"
    )
    return np.asarray(noise / noise.std())


def _make_table(kind: str, rng: np.random.Generator) -> Material:
    """Makes the material of a table."""
    if kind == "white":
        return Material((0.75, 0.75, 0.74), 0.0, 0.6)
    level = rng.uniform(0.35, 0.55)
    if kind == "gray":
        return Material((level, level, 0.98 * level), 0.0, 0.7)
    if kind == "wooden":
        grain = _make_noise(rng, (60.0, 1.5)) + _make_noise(rng, (20.0, 6.0))
        shade = 1 + 0.05 * grain[..., None]
        color = np.array([0.76, 0.62, 0.47])
    else:
        dots = _make_noise(rng, (5.0, 5.0)) > 1.0
        shade = np.where(dots, 0.85, 1.0)[..., None]
        color = np.array([0.70, 0.70, 0.68])
    picture = np.clip(255 * shade * color, 0, 255).astype(np.uint8)
    return Material((0.9, 0.9, 0.9), 0.0, 0.8, picture)


def _make_print(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Makes a picture of print on something white: blocks of color and lines of text."""
    picture = np.full((TEXTURE_SIZE, TEXTURE_SIZE, 3), 255, np.uint8)
    for _ in range(6):
        x, y = rng.integers(0, TEXTURE_SIZE, 2)
        w, h = rng.integers(20, 160, 2)
        tint = [int(value) for value in rng.integers(20, 220, 3)]
        cv2.rectangle(picture, (int(x), int(y)), (int(x + w), int(y + h // 4)), tint, -1)
    return picture


def _make_reflection(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Makes a picture of a room as a flat piece of metal mirrors it: blurred, from black to white.

    Drake's renderer can reflect a room itself, but takes a minute for it without a GPU.
    """
    room = _make_noise(rng, (40.0, 40.0)) + 0.3 * _make_noise(rng, (10.0, 10.0))
    level = np.clip(rng.uniform(90, 190) + 45 * room, 20, 255)
    return np.repeat(level[..., None], 3, axis=2).astype(np.uint8)


def _render(
    meshes: list[Mesh], camera: Camera, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.int16], Array]:
    """Renders a scene by light from a lamp, hard or soft.

    Args:
        meshes: the table and the object's parts.
        camera: the camera.
        rng: generator of the light.

    Returns:
        (height, width, 3) colors, 0 to 255; (height, width) labels; (height, width) depth, m.
    """
    direction = np.array([*rng.uniform(-0.6, 0.6, 2), -1.0])
    softness = rng.uniform(0.0, 0.3)
    strength = rng.uniform(0.8, 1.8)
    lamps = [
        direction + softness * np.array([*rng.standard_normal(2), 0.0]) for _ in range(LAMP_COUNT)
    ]
    # The room's own light, from all sides, takes the edge off the shadows.
    fill = rng.uniform(*FILL_LIGHT_RANGE) * strength
    lights = [("world", strength / LAMP_COUNT, lamp) for lamp in lamps]
    lights.append(("camera", fill, np.array([0.0, 0.0, 1.0])))
    scene = RenderedScene(camera, make_lights(lights))
    for number, mesh in enumerate(meshes):
        properties = PerceptionProperties()
        properties.AddProperty("label", "id", RenderLabel(TABLE_LABEL + number))
        instance = GeometryInstance(RigidTransform(), mesh, f"mesh_{number}")
        instance.set_perception_properties(properties)
        scene.graph.RegisterAnchoredGeometry(scene.source, instance)
    return scene.render_color(), scene.render_labels(), scene.render_depth()


def _take_color(color: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Makes of colors (height, width, 3) what a camera takes: exposure, blur, noise and JPEG."""
    rows, columns = color.shape[:2]
    # Every photographer exposes so that the table is bright and not white.
    exposed = color * (rng.uniform(150, 200) / np.median(color))
    y = np.linspace(-1, 1, rows)[:, None]
    x = np.linspace(-1, 1, columns)
    fall = 1 - rng.uniform(0.0, 0.15) * (x**2 + y**2)
    blurred = cv2.GaussianBlur(exposed * fall[..., None], (0, 0), rng.uniform(0.4, 1.0))
    noisy = blurred + rng.uniform(1.0, 3.0) * rng.standard_normal(color.shape)
    picture = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    quality = int(rng.integers(80, 98))
    _, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
    return decoded[..., ::-1].copy()


def _take_depth(
    z: Array, holes: Image, camera: Camera, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Makes of depth (height, width), m, what a stereo camera measures.

    Args:
        z: (height, width) depth, m.
        holes: (height, width) fraction of the surface there on which nothing is measured.
        camera: the camera.
        rng: generator of noise, waves and holes.

    Returns:
        (height, width), m, whole millimeters; 0 where nothing was measured.
    """
    # What is near is seen wider than it is, for a window of pixels is matched.
    fat = cv2.erode(z, np.ones((FATTENING_WIDTH, FATTENING_WIDTH), np.uint8))
    rows, columns = z.shape

    # One eye does not see what is beside something near: a strip as wide as disparity jumps.
    scale = camera.K[0, 0] * STEREO_BASELINE
    disparity = scale / fat
    jump = np.diff(disparity, axis=1, append=disparity[:, -1:])
    widest = max(1, int(np.ceil(jump.max())))
    shadow = np.zeros(z.shape, dtype=bool)
    for width in range(1, widest + 1):
        wide = jump >= width
        shadow[:, : columns - width + 1] |= wide[:, width - 1 :]

    # Waves that change over a quarter of the picture, grain over a few pixels, and whole steps.
    coarse = gaussian_filter(
        rng.standard_normal((rows // WAVE_PIXEL_SIZE, columns // WAVE_PIXEL_SIZE)),
        WAVE_LENGTH / WAVE_PIXEL_SIZE,
    )
    waves = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
    grain = gaussian_filter(rng.standard_normal(z.shape), 1.5)
    off = DEPTH_WAVE_AMPLITUDE * waves / waves.std() + 0.001 * grain / grain.std()
    measured = np.round(scale / (fat + off) / DISPARITY_STEP) * DISPARITY_STEP
    depth = np.round(MM_PER_M * scale / measured) / MM_PER_M

    # Holes come in blotches, not pixel by pixel.
    blotches = gaussian_filter(rng.standard_normal(z.shape), 4.0)
    rank = ndtr(blotches / blotches.std())
    unseen = (rank < cv2.blur(holes, (5, 5))) | shadow
    return np.where(unseen, 0.0, depth).astype(np.float32)
