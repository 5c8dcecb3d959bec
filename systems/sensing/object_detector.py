"""`ObjectDetector`: finds an object in a camera's pictures; `detect_object` between ports."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydrake.systems.framework import BasicVector, Context, State
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import GridPushError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.perception.detection.detection import (
    DetectedObject,
    DetectorOptions,
    detect_object,
    is_cut_off,
)
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Frame, Mask
from gridpush_drake.perception.images.table_view import cover_pixels, find_off_table
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.base.worker import Request, WorkerResult, answer_now, make_worker
from gridpush_drake.systems.sensing.planar_pose_sensor import DEFAULT_PERIOD
from gridpush_drake.systems.sensing.rgbd_inputs import RgbdInputs


@dataclass(frozen=True)
class ObjectNaming:
    """What a picture does not tell of an object that is found in it.

    Attributes:
        name: name that the object gets.
        prior: prior of its mass and friction; None for the default one. Which parts are seen, and
            that each may be of one material, the picture tells.
        heading: direction of the x axis of its body frame in W, rad.
    """

    name: str = "object"
    prior: PhysicalPrior | None = None
    heading: float = 0.0


@dataclass(frozen=True, eq=False)
class Detection:
    """What was found in the pictures so far.

    Attributes:
        detected: outline, mask and picture of what was found; None if nothing was found yet.
        obj: the object of it, in its body frame B.
        message: why nothing was found in the last picture; empty if something was, and before the
            first picture.
    """

    detected: DetectedObject | None = None
    obj: GridObject | None = None
    message: str = ""


@dataclass(frozen=True, eq=False)
class DetectorState(Unchanging):
    """All that the detector remembers; never changed, only replaced.

    Attributes:
        trigger: number on the port `trigger` when it began to look.
        seen: what was found since.
        request: the search under way in a worker; None if there is none.
    """

    trigger: float = 0.0
    seen: Detection = Detection()
    request: Request | None = None


class ObjectDetector(AbstractStateSystem[DetectorState]):
    """Finds the only object on the table in the pictures of a color and depth camera.

    .. pydrake_system::

        name: ObjectDetector
        input_ports:
        - color_image
        - depth_image
        - label_image
        - trigger
        output_ports:
        - object_pose
        - found
        - detection
        - message

    * color_image: abstract `ImageRgba8U`.
    * depth_image: abstract `ImageDepth32F`, m, of the same pixels; 0 if it was not measured. It
      need not be connected if the camera's pose is known and the object's height is given.
    * label_image: abstract `ImageLabel16I`, rendered as the camera sees the scene; it tells which
      pixels show the robot, or something else that hides the table. It need not be connected.
    * trigger: vector of 1, a number. When it changes, what was found is forgotten, and the detector
      looks anew. It need not be connected, and is 0 then.
    * object_pose: vector of 3, X_WB, (x, y, theta), m and rad, in the picture in which the object
      was found; else NaN.
    * found: vector of 1, 1 if an object was found, else 0.
    * detection: abstract `Detection`, with the object, its outline and the picture.
    * message: abstract `str`, why no object was found in the last picture, such as two objects, no
      table in view, or an image of another size; else empty. Whatever is in the pictures, nothing
      is raised.

    A picture is looked at every `period` until an object is found; without `once` also after that.
    How an object is found is described at `detect_object`. Abstract state: one `DetectorState`.
    Numeric parameter 0: seed of the colors of the table that are painted over the robot.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        camera: Camera,
        options: DetectorOptions | None = None,
        naming: ObjectNaming | None = None,
        *,
        table_top: BaseGeometry | None = None,
        occluded_by: Iterable[int] = (),
        seed: int = 0,
        period: float = DEFAULT_PERIOD,
        once: bool = True,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            camera: the camera that takes the pictures.
            options: what counts as an object.
            naming: name, prior and heading of the object that is found.
            table_top: the part of the table where objects may lie, a polygon in W, m; None for all
                that is in view.
            occluded_by: labels, in `label_image`, of whatever may hide the table.
            seed: seed of the colors that are painted over the robot.
            period: time between two pictures, s.
            once: whether it stops looking once it has found an object, until it is triggered.
            answer_delay: time after which the result of a search is there, s; None for real time,
                see `make_worker`.

        Raises:
            CameraError: there is a table's top, but the camera's pose is not known.
            PlanningError: the delay is negative.
        """
        super().__init__(DetectorState(), period)
        self._worker = make_worker(answer_delay)
        self._camera = camera
        self._options = options
        self._naming = naming or ObjectNaming()
        self._once = once
        self._off_table = None if table_top is None else find_off_table(camera, table_top)
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self._inputs = RgbdInputs(self, camera.width, camera.height, occluded_by)
        self._trigger = self.DeclareVectorInputPort("trigger", 1)
        self._declare_value("detection", lambda now: now.seen)
        self._declare_value("message", lambda now: now.seen.message)
        self._declare_vector(
            "object_pose",
            3,
            lambda now: np.full(3, np.nan) if now.seen.detected is None else now.seen.detected.X_WB,
        )
        self._declare_vector("found", 1, lambda now: [float(now.seen.detected is not None)])
        self.DeclareInitializationUnrestrictedUpdateEvent(self._look_first)

    def _look_first(self, context: Context, state: State) -> None:
        """Looks in advance at what the first picture will show, so that it is known at once."""
        now = self._get_state(context)
        if now.seen.detected is None and now.request is None:
            self._update(context, state)

    def _go_on(self, context: Context, now: DetectorState) -> DetectorState:
        if now.request is not None and self._worker is not None:
            answer = self._worker.take(now.request, context.get_time())
            return now if answer is None else _settle(now, answer)
        trigger = float(self._trigger.Eval(context)[0]) if self._trigger.HasValue(context) else 0.0
        if trigger != now.trigger and np.isfinite(trigger):
            now = DetectorState(trigger)
        if now.seen.detected is not None and self._once:
            return now
        seed = int(context.get_numeric_parameter(int(self._seed)).value()[0])
        work = partial(
            find_in_frame,
            self._inputs.take_frame(context),
            self._camera,
            self._options,
            naming=self._naming,
            off_table=self._off_table,
            hidden=self._inputs.find_occluded(context),
            seed=seed,
        )
        if self._worker is None:
            return _settle(now, answer_now(work))
        return replace(now, request=self._worker.ask(work, context.get_time()))


def find_in_frame(
    frame: Frame,
    camera: Camera,
    options: DetectorOptions | None,
    naming: ObjectNaming,
    off_table: Mask | None,
    hidden: Mask | None,
    seed: int,
) -> tuple[DetectedObject, GridObject] | str:
    """Finds the object in a picture, and divides it into cells.

    Args:
        frame: the picture.
        camera: the camera that took it.
        options: what counts as an object.
        naming: name, prior and heading of the object.
        off_table: (height, width) bool, pixels that do not show the table's top; None if unknown.
        hidden: (height, width) bool, pixels that show the robot; None if unknown. Of an object
            that these cut off nobody knows how it goes on behind the robot.
        seed: seed of the colors that are painted over these pixels.

    Returns:
        What was found, and the object; or a sentence that says why there is none.
    """
    try:
        camera.check_size(frame.color, "the color image")
        covered = np.zeros(frame.color.shape[:2], dtype=bool)
        for mask in (off_table, hidden):
            if mask is not None:
                camera.check_size(mask, "the label image")
                covered |= mask
        if frame.depth is not None:
            camera.check_size(frame.depth, "the depth image")
        detected = detect_object(
            *cover_pixels(frame.color, frame.depth, covered, seed), camera, options
        )
        if hidden is not None and is_cut_off(
            detected.mask, camera.undistort(hidden.astype(np.uint8)) > 0
        ):
            return "the robot hides a part of the object; expected all of it in view"
        x, y, _ = detected.X_WB
        detected = replace(detected, X_WB=np.array([x, y, naming.heading]))
        obj = detected.make_grid_object(name=naming.name)
        if naming.prior is None:
            return detected, obj
        # Labels are those of the parts in the picture, and not those of a file's materials.
        prior = replace(
            naming.prior, uniform_parts=obj.prior.uniform_parts, materials=obj.prior.materials
        )
        return detected, replace(obj, prior=prior)
    except GridPushError as error:
        return str(error)


def _settle(now: DetectorState, answer: WorkerResult) -> DetectorState:
    """The state after a picture was looked at."""
    if answer.error or isinstance(answer.value, str):
        return DetectorState(now.trigger, Detection(message=answer.error or answer.value))
    return DetectorState(now.trigger, Detection(*answer.value))
