"""Moves a known outline onto its edges in one picture.

What is seen of a prism on the table is its silhouette: the union of its outline and of all that its
sides and its top hide of the table. Along its boundary, at points p_i with outward normals n_i in
the picture, the edge between object and table is looked for, d_i pixels off, and the pose q moves
until these vanish on the whole:

    min_q  sum_i w_i (d_i - n_i' J_i dq)^2 / sigma^2 + |dq|^2_P,       J_i = d(pixel of p_i)/dq

with Tukey's weights w_i, and a prior P as wide as the object can move between two frames. Points
that something covers have no part. The covariance is the inverse of the information left, A = sum
w_i J_i' n_i n_i' J_i / sigma^2 + P, and what errors that edges share do to the pose besides:

    cov = A^-1 + sum_k (A^-1 sum_i w_i J_i' n_i e_ki / sigma^2) (...)'

What no edge tells, such as the angle of a disc, keeps the prior's width: in sigma^2 is what
neighboring edges share, and J is their mean along that length, as nothing finer is resolved. Shared
errors are of two kinds. Where a side is seen below the top, the edge is off by a fraction of the
side's width in the picture, on all such edges alike. And light from one side draws all edges its
way. Either moves the pose, and hardly turns it.

What all of the outline tells well, a part of it may tell wrongly: a dark side over a dark floor, a
rim that the photograph drew too far out. While something covers a part of an object that hardly
moves, only the change of each edge is trusted since all of them were seen:

    min_dq  sum_i w_i (d_i - d_i^0 - n_i' J_i dq)^2 / sigma^2 + |dq|^2_R

with d_i^0 the distances then, and R a prior at no motion at all.

Which pixels are object, and which pose is begun with, is decided in `tracking`. The theory is in
docs/theory/perception.md, section 3.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.ndimage import map_coordinates, uniform_filter1d
from shapely import Polygon

from gridpush_drake.geometry.se2 import (
    Array,
    IntArray,
    rotate,
    transform,
    transform_back,
    wrap_angle,
)
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Mask
from gridpush_drake.perception.images.pixel_kernels import (
    EDGE_COVERAGE,
    EDGE_COVERED,
    EDGE_MISSING,
    Across,
    Points,
    find_edges,
    linearize,
)
from gridpush_drake.perception.images.silhouette import make_silhouette, sample_boundary
from gridpush_drake.perception.images.table_plane import TO_DEVIATION

MAX_POINTS = 360
"""Most points of the boundary at which an edge is looked for; a longer outline has them further
apart."""

MIN_SPACING = 1.5
"""Least distance between two points of the boundary, pixels: closer ones would see the same
edge."""


class RegistrationStage(NamedTuple):
    """One stage of a registration.

    Attributes:
        reach: how far from the expected boundary an edge is looked for, inward and outward, pixels.
        step: distance between two samples across the boundary, pixels.
        rounds: largest number of least-squares steps.
        converged: the stage ends when a step moves no point of the outline by more than this,
            pixels.
        min_spread: least standard deviation of the edges' distances that Tukey's weights assume,
            pixels.
    """

    reach: float
    step: float
    rounds: int
    converged: float
    min_spread: float


REGISTRATION_STAGES = (
    RegistrationStage(reach=16.0, step=1.0, rounds=10, converged=0.3, min_spread=4.0),
    RegistrationStage(reach=6.0, step=0.5, rounds=10, converged=0.05, min_spread=1.0),
    RegistrationStage(reach=3.0, step=0.25, rounds=12, converged=1e-3, min_spread=0.3),
)
"""Stages of a registration, from coarse to fine: a wide reach finds an object that moved far, and a
narrow one leaves out the edges of other things. At first the spread may not be small either: if an
object moves along its longer sides, their edges stay where they are, and only those of its ends
tell of the motion. At the end, without a least spread, a few edges that agree by chance would throw
all others out."""

SAME_SILHOUETTE = 0.1
"""A silhouette is moved along with the object, and made anew when a point of it has moved by more
than this, pixels: how much of the table a side hides depends on where it is below the camera."""

TUKEY_SIGMAS = 3.0
"""An edge that is this many standard deviations or more from the outline has no weight (the tuning
constant of Tukey's weights)."""

SHARED_LENGTH = 12.0
"""Edges that are less than this far apart along the boundary have nearly the same error, pixels;
such a stretch counts as one measurement."""

SIDE_ERROR = 0.1
"""Standard deviation of the error that all edges below visible sides share, as a part of the sides'
width in the picture: a side has another brightness than the top."""

LIGHT_ERROR = 0.03
"""Standard deviation of the error that all edges share because light from one side moves them its
way, pixels."""

EDGE_DEVIATION = 0.5
"""Standard deviation of an edge's place that is assumed where two poses are compared, pixels."""

MISSING_COST = 4.5
"""Greatest negative logarithm of an edge's likelihood: that of an edge that is missing where it
should be in plain view, or that is three standard deviations off."""

CLUTTER_COST = 1.0
"""Negative logarithm of an edge's likelihood where something else than the object is seen."""


CHANGE_SEARCH = RegistrationStage(reach=4.0, step=0.25, rounds=8, converged=1e-2, min_spread=0.3)
"""How edges are looked for where an object that hardly moved is registered by their change."""

CHANGE_PRIOR = np.diag([0.001**-2, 0.001**-2, 0.01**-2])
"""R, (3, 3): the information of a motion that is measured by the change of edges; standard
deviations of 1 mm and 0.01 rad. It counts only where what is left in view tells nothing."""

MAX_CHANGE = 1.5
"""A motion is measured by the change of edges up to this distance of the outline's farthest-moving
point, pixels: beyond, other errors hold for each edge than in the picture before."""

SAME_CHANGE = 0.75
"""An edge has moved along with the object if it is at most this far from where the motion would
have it, pixels."""

MIN_CHANGED = 0.8
"""Least fraction of the edges in view, of those that were seen before, that must have moved along
with the object for the motion to count."""

MIN_EDGES = 20
"""Least number of edges by whose change a motion is measured."""

GONE_EDGES = 0.5
"""An object has left where it was if this fraction of the edges that were seen there, and that
nothing covers now, is missing."""


class View(NamedTuple):
    """What is object in a part of the picture.

    Attributes:
        coverage: (h, w) fraction of each pixel that is object.
        mask: (h, w) bool, pixels that show the object.
        covered: (h, w) bool, pixels that say nothing.
        corner: (2,) x and y of the part's upper left pixel in the whole picture.
    """

    coverage: NDArray[np.float32]
    mask: Mask
    covered: Mask
    corner: Array


class Boundary(NamedTuple):
    """Points of a silhouette's boundary, which move along with the object a little.

    Attributes:
        pose: (3,) pose of the object at which the silhouette was made, W.
        points: (n, 2) points of the boundary on the table, B, m.
        normals: (n, 2) outward unit normals there, B.
    """

    pose: Array
    points: Array
    normals: Array


class Fit(NamedTuple):
    """A registration: the pose, its covariance, and how well it explains the picture.

    Attributes:
        pose: (3,) (x, y, theta) of the object, W, m and rad.
        covariance: (3, 3) covariance of the pose, m^2, m rad and rad^2.
        dilution: how much less sure the pose is than it would be with nothing covered, a ratio of
            standard deviations in the worst direction.
        fraction: fraction of the visible boundary whose edge was found.
        inside: fraction of the points just inside the visible boundary that show the object.
        rms: root mean square distance of the edges found from the outline, pixels.
        evidence: logarithm of how much likelier the edges are of an object at this pose than of
            anything else; each edge that is found adds to it, and each that is missing takes away.
        boundary: the points at which edges were looked for.
        offsets: (n,) d_i, how far outward of the boundary at `pose` the edges are, pixels; NaN
            where none was found.
    """

    pose: Array
    covariance: Array
    dilution: float
    fraction: float
    inside: float
    rms: float
    evidence: float
    boundary: Boundary
    offsets: Array


class EdgeShift(NamedTuple):
    """How an object moved since another registration, by the change of its edges.

    Attributes:
        pose: (3,) pose after it, W, m and rad.
        covariance: (3, 3) covariance of the motion, m^2, m rad and rad^2.
    """

    pose: Array
    covariance: Array


class _Step(NamedTuple):
    """One step of the least squares.

    Attributes:
        edges: the points at which edges were looked for, in the picture.
        weight: (n,) w_i, their weights; 0 where no edge was found.
        visible: (n,) bool, where an edge was found or should have been.
        found: (n,) bool, where an edge was found that counts.
        noise: sigma^2, variance of an edge's place that counts what neighbors share, pixels^2.
        d: (n,) d_i, how far outward the edges are, pixels; 0 where none was found.
        rms: root mean square distance of the edges, pixels.
        moved: (3,) dq, by how much the pose moves, m and rad.
    """

    edges: Points
    weight: Array
    visible: Mask
    found: Mask
    noise: float
    d: Array
    rms: float
    moved: Array


class Registration:
    """Registers a prism of known outline to what is seen of it; it holds no state."""

    def __init__(
        self, outline: Polygon, height: float, camera: Camera, prior: Array, pixel_noise: float
    ) -> None:
        """Takes the object and the camera.

        Args:
            outline: outline of the object in B, m.
            height: height of the object, m.
            camera: a camera without distortion, with X_WC, that is higher than the object.
            prior: (3, 3) P, the information of what can happen to the pose between two frames.
            pixel_noise: least standard deviation of an edge's place, pixels.
        """
        self._outline = outline
        self._height = height
        self._camera = camera
        self._prior = prior
        self._pixel_noise = pixel_noise

        # Points on the table are projected by a homography: z = 0 takes a column of R_CW away.
        R_CW = camera.pose[:3, :3].T
        p_CW = -R_CW @ camera.center
        self._homography = camera.K @ np.column_stack([R_CW[:, 0], R_CW[:, 1], p_CW])
        self._foot = np.array(camera.center[:2])
        self._side = height / (camera.center[2] - height)

        # Distance between two points of the boundary on the table, m.
        pixels_a_meter = camera.K[0, 0] / camera.center[2]
        self._spacing = max(outline.length / MAX_POINTS, MIN_SPACING / pixels_a_meter)

    def register(self, view: View, pose: Array) -> Fit:
        """Moves the silhouette onto the edges, from coarse to fine.

        Args:
            view: what is object in the picture.
            pose: (3,) the pose that is begun with, W, m and rad.

        Returns:
            The fit.
        """
        boundary = self._trace(pose)
        for search in REGISTRATION_STAGES:
            # Each stage has the prior about where the one before it ended.
            start = pose
            for _ in range(search.rounds):
                edges = self._expect(boundary, pose, view.corner)
                if np.abs(edges.J @ (pose - boundary.pose)).max() > SAME_SILHOUETTE:
                    boundary = self._trace(pose)
                    edges = self._expect(boundary, pose, view.corner)
                step = self._improve(view, edges, start - pose, search, self._prior)
                pose = pose + step.moved
                if np.abs(edges.J @ step.moved).max() < search.converged:
                    break
        return self._judge(view, boundary, step, pose)

    def calc_lost(self, view: View, before: Fit, pose: Array) -> float:
        """Calculates how much of what was seen of an object is covered now.

        Args:
            view: what is object in the picture.
            before: the registration in an earlier picture.
            pose: (3,) pose of the object now, W, m and rad.

        Returns:
            The fraction of the edges found then that are covered now.
        """
        # Edges that were not found then cannot be lost now.
        seen = np.isfinite(before.offsets)
        edges = self._expect(before.boundary, pose, view.corner)
        covered = sample_image(view.covered, edges.pixels[seen]) > EDGE_COVERAGE
        return float(covered.mean()) if seen.any() else 0.0

    def has_left(self, view: View, before: Fit) -> bool:
        """Says whether the picture plainly shows that an object is not where it was registered."""
        edges = self._expect(before.boundary, before.pose, view.corner)
        reach, step = CHANGE_SEARCH.reach, CHANGE_SEARCH.step
        _, state = measure_edges(
            view.coverage, view.covered, edges.pixels, edges.normals, reach, step
        )
        in_view = np.isfinite(before.offsets) & (state != EDGE_COVERED)
        gone = in_view & (state == EDGE_MISSING)
        return bool(in_view.sum() >= MIN_EDGES and gone.sum() > GONE_EDGES * in_view.sum())

    def has_jumped(self, view: View, before: Fit, pose: Array) -> bool:
        """Says whether a pose (3,) is farther from a registration than edges are compared."""
        edges = self._expect(before.boundary, before.pose, view.corner)
        off = pose - before.pose
        off[2] = wrap_angle(off[2])
        return bool(np.abs(edges.J @ off).max() > MAX_CHANGE)

    def measure_motion(self, view: View, before: Fit) -> EdgeShift | None:
        """Measures by the change of its edges how an object moved that hardly moved.

        Args:
            view: what is object in the picture.
            before: the registration in an earlier picture.

        Returns:
            The motion; None where it is too large to be measured so, or too little is in view.
        """
        pose = before.pose
        search = CHANGE_SEARCH
        for _ in range(search.rounds):
            edges = self._expect(before.boundary, pose, view.corner)
            step = self._improve(
                view, edges, before.pose - pose, search, CHANGE_PRIOR, before.offsets
            )
            pose = pose + step.moved
            if np.abs(edges.J @ step.moved).max() < search.converged:
                break
        # An object that moved far takes its edges out of reach, or most of them elsewhere.
        in_view = step.visible & np.isfinite(before.offsets)
        along = step.found & (np.abs(step.d - edges.J @ step.moved) < SAME_CHANGE)
        is_plain = in_view.sum() >= MIN_EDGES and along.sum() >= MIN_CHANGED * in_view.sum()
        if not is_plain or self.has_jumped(view, before, pose):
            return None

        # The inverse of the information left; the prior keeps directions that no edge tells.
        weighted = edges.J * step.weight[:, None]
        information = weighted.T @ edges.J / step.noise + CHANGE_PRIOR
        return EdgeShift(pose=pose, covariance=np.linalg.inv(information))

    def make_silhouette(self, pose: Array) -> Polygon:
        """Makes the object's silhouette on the table at a pose (3,), W, m."""
        return make_silhouette(self._outline, pose, self._height, self._camera)

    def find_bounds(self, pose: Array) -> Array:
        """Finds the part of the picture that shows the object at a pose.

        Args:
            pose: (3,) pose of the object, W.

        Returns:
            (2, 2) least and greatest x and y of the object's bottom and top, pixels.
        """
        corners = transform(pose, np.array(self._outline.exterior.coords))
        bottom = np.column_stack([corners, np.zeros(len(corners))])
        top = bottom + [0.0, 0.0, self._height]
        pixels = self._camera.project(np.concatenate([bottom, top]))
        return np.array([np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)])

    def _trace(self, pose: Array) -> Boundary:
        """Samples the boundary of the silhouette at a pose (3,)."""
        points, normals = sample_boundary(self.make_silhouette(pose), self._spacing)
        return Boundary(
            pose=pose,
            points=transform_back(pose, points),
            normals=rotate(-pose[2], normals),
        )

    def _expect(self, boundary: Boundary, pose: Array, corner: Array) -> Points:
        """Projects a boundary at a pose (3,) into the part of the picture at `corner` (2,)."""
        count = len(boundary.points)
        edges = Points(
            pixels=np.empty((count, 2)),
            J=np.empty((count, 3)),
            normals=np.empty((count, 2)),
            sides=np.empty(count),
            scales=np.empty(count),
        )
        linearize(
            transform(pose, boundary.points),
            rotate(pose[2], boundary.normals),
            self._homography,
            pose,
            self._foot,
            self._side,
            edges,
        )
        edges.pixels[:] -= corner
        return edges

    def _improve(
        self,
        view: View,
        edges: Points,
        back: Array,
        search: RegistrationStage,
        prior: Array,
        expected: Array | None = None,
    ) -> _Step:
        """Takes one step of the least squares.

        Args:
            view: what is object in the picture.
            edges: the edges that the pose before the step predicts.
            back: (3,) q_before - q, from the pose before the step to the middle of the prior.
            search: how edges are looked for.
            prior: (3, 3) information of the prior.
            expected: (n,) how far outward the edges would be found of the right pose, pixels, NaN
                for edges that are not to be looked at; None for zeros.

        Returns:
            The step.
        """
        # d_i: how far the edges are from the boundary that the pose predicts.
        offsets, state = measure_edges(
            view.coverage, view.covered, edges.pixels, edges.normals, search.reach, search.step
        )
        if expected is not None:
            offsets = offsets - expected
        found = np.isfinite(offsets)

        # w_i: Tukey's weights, with the median for the scatter, as outliers do not move it.
        d = np.where(found, offsets, 0.0)
        spread = search.min_spread
        if found.any():
            spread = max(spread, TO_DEVIATION * float(np.median(np.abs(offsets[found]))))
        limit = TUKEY_SIGMAS * spread + self._pixel_noise
        weight = found * np.clip(1 - (d / limit) ** 2, 0, None) ** 2

        # sigma^2: neighboring edges share an error, so that only one in a stretch counts.
        total = max(weight.sum(), np.finfo(float).tiny)
        rms = float(np.sqrt((weight * d**2).sum() / total))
        noise = max(rms, self._pixel_noise) ** 2 * max(
            1.0, SHARED_LENGTH / self._calc_distance(edges)
        )

        # dq: the normal equations, with the prior about the pose before.
        weighted = edges.J * weight[:, None]
        information = weighted.T @ edges.J / noise + prior
        gradient = weighted.T @ d / noise + prior @ back
        return _Step(
            edges=edges,
            weight=weight,
            visible=found | (state != EDGE_COVERED),
            found=found,
            noise=noise,
            d=d,
            rms=rms,
            moved=np.linalg.solve(information, gradient),
        )

    def _judge(self, view: View, boundary: Boundary, step: _Step, pose: Array) -> Fit:
        """Tells how well a pose explains the picture, and how sure it is.

        Args:
            view: what is object in the picture.
            boundary: the points at which edges were looked for.
            step: the last step.
            pose: (3,) the pose after it.

        Returns:
            The fit.
        """
        # How well the pose explains the picture, where it can be judged.
        inside = 0.0
        if step.visible.any():
            reach = REGISTRATION_STAGES[-1].reach
            within = step.edges.pixels - reach * step.edges.normals
            coverage = sample_image(view.coverage, within[step.visible])
            inside = float((coverage > EDGE_COVERAGE).mean())
        fraction = step.found.sum() / max(1, step.visible.sum())

        # How much likelier the edges are of this pose than of something else, by which they would
        # be anywhere. Neighbors with the same error count as one.
        costs = np.minimum(0.5 * (step.d / EDGE_DEVIATION) ** 2, MISSING_COST)
        costs = np.where(step.found, costs, MISSING_COST)
        alike = max(1.0, SHARED_LENGTH / self._calc_distance(step.edges))
        evidence = (CLUTTER_COST - costs)[step.visible].sum() / alike

        # C with the edges found, and C_0 as if all of the boundary had been seen.
        covariance = self._calc_covariance(step.edges, step.weight, step.noise)
        whole = self._calc_covariance(step.edges, np.ones(len(step.weight)), step.noise)
        return Fit(
            pose=pose,
            covariance=covariance,
            dilution=calc_dilution(whole, covariance),
            fraction=float(fraction),
            inside=inside,
            rms=step.rms,
            evidence=float(evidence),
            boundary=boundary,
            offsets=np.where(step.found, step.d, np.nan) - step.edges.J @ step.moved,
        )

    def _calc_covariance(self, edges: Points, weight: Array, noise: float) -> Array:
        """Calculates the covariance (3, 3) of a pose.

        Args:
            edges: n edges.
            weight: (n,) their weights.
            noise: variance of an edge's place that counts what neighbors share, pixels^2.

        Returns:
            (3, 3) cov, m^2, m rad and rad^2.
        """
        # The mean of J over neighbors with the same error: what is finer is not resolved.
        count = max(1, round(SHARED_LENGTH / self._calc_distance(edges)))
        J = uniform_filter1d(edges.J, count, axis=0, mode="wrap")
        weighted = J * weight[:, None]
        random = np.linalg.inv(weighted.T @ J / noise + self._prior)

        # The columns e_k: one of the visible sides, two of light along x and y.
        shared = np.column_stack([SIDE_ERROR * edges.sides, LIGHT_ERROR * edges.normals])
        moved = random @ weighted.T @ shared / noise
        return np.asarray(random + moved @ moved.T, dtype=np.float64)

    def _calc_distance(self, edges: Points) -> float:
        """Calculates the mean distance between neighboring points in the picture, pixels."""
        return float(edges.scales.mean()) * self._spacing


def calc_dilution(whole: Array, left: Array) -> float:
    """Calculates by how much the standard deviation of some combination of unknowns grows at most.

    It is sqrt(lambda_max(whole^-1 left)), over all directions.

    Args:
        whole: (3, 3) covariance with all information, positive definite.
        left: (3, 3) covariance with what is left of it.

    Returns:
        The ratio of the standard deviations.
    """
    return float(np.sqrt(eigh(left, whole, eigvals_only=True)[-1]))


def measure_edges(
    coverage: NDArray[np.float32],
    covered: Mask,
    pixels: Array,
    normals: Array,
    reach: float,
    step: float,
) -> tuple[Array, IntArray]:
    """Looks for the object's edge across its expected boundary.

    Args:
        coverage: (h, w) fraction of each pixel that is object.
        covered: (h, w) pixels that say nothing.
        pixels: (n, 2) points of the expected boundary, pixels.
        normals: (n, 2) outward unit normals there, in the picture.
        reach: how far to look inward and outward, pixels.
        step: distance between two samples, pixels.

    Returns:
        (n,) how far outward the nearest edge is, pixels, NaN where there is none; and (n,)
        EDGE_FOUND, EDGE_MISSING or EDGE_COVERED.
    """
    offsets = np.empty(len(pixels))
    state = np.empty(len(pixels), dtype=np.int64)
    count = int(2 * reach / step + EDGE_COVERAGE) + 1
    across = Across(reach=float(reach), step=float(step), count=count)
    find_edges(coverage, covered.view(np.uint8), pixels, normals, across, offsets, state)
    return offsets, state


def sample_image(image: NDArray[Any], places: Array) -> Array:
    """Finds an image's values between its pixels, linearly.

    Args:
        image: (height, width) image of one channel.
        places: (..., 2) x and y, pixels.

    Returns:
        (...) values; outside of the image it counts as 0.
    """
    rows_and_columns = np.moveaxis(places[..., ::-1], -1, 0)
    values = map_coordinates(image, rows_and_columns, np.float64, order=1, mode="grid-constant")
    return np.asarray(values)
