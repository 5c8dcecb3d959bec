"""A whole simulated station as a world: closed loops and benches push in it as in any other world.

A `PushTask` lets a controller in the Diagram decide. Here whoever steps the closed loop stands
outside: it gives one push at a time, and the robot's executor carries it out.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError, PushRefusedError, StationError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.planning.robot_status import PushPhase
from gridpush_drake.planning.world import WorldMotion, WorldTruth
from gridpush_drake.pushes.push_log import ObservedPush
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.systems.base.messages import PushCommand

SAMPLE_PERIOD = 0.02
"""Simulated time between two looks at the executor and at the true pose while a push lasts, s."""

REST_TIME = 0.5
"""Simulated time that an object which was put down is given to come to rest and to be seen, s."""

MAX_PUSH_TIME = 60.0
"""Simulated time after which a push that has not ended is given up, s."""


@dataclass(frozen=True)
class _Pushing:
    """The true poses that were noted while the finger was pushing.

    Attributes:
        times: s, of the simulation.
        poses: (3,) each, m and rad.
    """

    times: tuple[float, ...] = ()
    poses: tuple[Array, ...] = ()

    def note(self, time: float, pose: Array) -> "_Pushing":
        """Returns the same with another pose; a fallen object has none."""
        if not np.isfinite(pose).all():
            return self
        return replace(self, times=(*self.times, time), poses=(*self.poses, pose))


class StationWorld:
    """A `PushWorld` that is a simulated station: a robot with an object on a table.

    The station learns nothing by itself. A push that the robot refuses raises `PushRefusedError`,
    which `run_loop` tells the closed loop as a station would.

    Attributes:
        station: the station.
        simulator: advances it.
        pushes: number of pushes that were carried out.
    """

    def __init__(self, scenario: PushScenario | ResolvedScenario) -> None:
        """Makes the station of a scenario, with the object where the scenario has it.

        Raises:
            ScenarioError: the scenario makes no sense.
            StationError: nothing can be rendered here.
        """
        self.station = MakePushStation(scenario, learning=Learning(max_pushes=0))
        self.simulator = Simulator(self.station)
        self.pushes = 0
        self._motion: WorldMotion | None = None
        self._command_id = 0
        self.station.SetStart(self._context)
        self._command(PushCommand())
        self._advance(REST_TIME)

    def put(self, pose: ArrayLike) -> None:
        """Puts the object down at a pose (3,), m and rad, while the robot stands by.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        there = check_vector(PlanningError, "pose", pose, 3)
        plant = self.station.plant
        plant_context = plant.GetMyMutableContextFromRoot(self._context)
        SetGridObjectPose(plant, plant_context, self.station.object_in_plant, there)
        self._motion = None
        self._advance(REST_TIME)

    def execute(self, push: Push) -> ObservedPush:
        """Lets the robot make a straight push, and waits until it is ready again.

        Args:
            push: the push; the robot makes it with its own finger.

        Returns:
            The push as the station's log has it, or, where the finger was not seen to touch the
            object, the poses seen before and after it.

        Raises:
            PushRefusedError: the robot does not take the push up.
            StationError: the object is not seen, or the push does not end.
        """
        begin = self.observe()
        if begin is None:
            raise StationError("push: the object is not seen; expected it on the table")
        logged = len(self._read("estimate.push_log"))
        self._command_id += 1
        self._command(PushCommand.from_push(self._command_id, push))
        noted = self._wait_until_done()
        status = self._read("executor.status")
        if status.reason:
            raise PushRefusedError(status.reason)
        self.pushes += 1
        self._motion = self._make_motion(noted)

        log = self._read("estimate.push_log")
        if len(log) > logged:
            return replace(log[-1], name=f"push_{self.pushes}")
        end = self.observe()
        return ObservedPush(
            name=f"push_{self.pushes}",
            push=push,
            pose=begin,
            t_observed=np.empty(0) if end is None else np.array([push.duration]),
            poses_observed=np.empty((0, 3)) if end is None else end[None],
        )

    def observe(self) -> Array | None:
        """Returns q_WB (3,) as the station's camera sees it now; None where it does not."""
        pose: Array = self._read("object.pose").copy()
        return pose if np.isfinite(pose).all() else None

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only; the pose is NaN once it has fallen."""
        pose: Array = self._read("object.pose_true").copy()
        fallen = not np.isfinite(pose).all()
        truth = self.station.GetTruth(self._context)
        return WorldTruth(
            pose=pose,
            fallen=fallen,
            stays=not fallen,
            bodies=None if truth is None else Bodies(self.station.obj, truth),
            motion=self._motion,
        )

    @property
    def _context(self) -> Context:
        return self.simulator.get_mutable_context()

    def _read(self, port: str) -> Any:
        return self.station.GetOutputPort(port).Eval(self._context)

    def _command(self, command: PushCommand) -> None:
        port = self.station.GetInputPort("push_command")
        port.FixValue(self._context, command.to_vector())

    def _advance(self, seconds: float) -> None:
        self.simulator.AdvanceTo(self._context.get_time() + seconds)

    def _wait_until_done(self) -> _Pushing:
        """Advances until the executor has taken up or refused the command, and is ready again."""
        noted = _Pushing()
        last = self._context.get_time() + MAX_PUSH_TIME
        while self._context.get_time() < last:
            self._advance(SAMPLE_PERIOD)
            status = self._read("executor.status")
            if status.phase in (PushPhase.PUSHING, PushPhase.SETTLING):
                noted = noted.note(self._context.get_time(), self._read("object.pose_true").copy())
            if status.command_id == self._command_id and status.ready:
                return noted
        raise StationError(f"push: has not ended after {MAX_PUSH_TIME:g} s of simulated time")

    def _make_motion(self, noted: _Pushing) -> WorldMotion | None:
        """Makes the true motion of what was noted; None where the object fell at once."""
        if not noted.times:
            return None
        poses = np.array(noted.poses)
        poses[:, 2] = np.unwrap(poses[:, 2])
        times = np.array(noted.times) - noted.times[0]
        fell = not np.isfinite(self._read("object.pose_true")).all()
        return WorldMotion(times=times, poses=poses, fell=fell)
