"""The whole story in the full station when things go wrong: out of sight, slipping, shoved while the robot works."""

from math import cos, sin

import numpy as np
import pytest

from gridpush_drake.multibody.ground_truth import CalcPlanarPose, SetGridObjectPose
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoopOptions
from gridpush_drake.station.campaign.episodes import calc_center_error
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.station.tasks.pregrasp_task import PreGraspTask
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.systems.base.messages import PreGraspMode, PushCommand, PushPhase

TIMEOUT = PreGraspLoopOptions().timeout
"""s."""


class Stranger:
    """Somebody who meddles with a task."""

    def __init__(self, task):
        self.task, self.station = task, task.station

    @property
    def context(self):
        return self.task.simulator.get_mutable_context()

    @property
    def mode(self):
        return self.task.read("status", self.task.controller).mode

    @property
    def pose(self):
        plant = self.station.plant
        return CalcPlanarPose(
            plant, plant.GetMyContextFromRoot(self.context), self.station.object_in_plant
        )

    def push_direction(self):
        command = PushCommand.from_vector(self.task.read("push_command", self.task.controller))
        return np.array([cos(command.direction), sin(command.direction), 0.0])

    def put(self, pose):
        plant = self.station.plant
        SetGridObjectPose(
            plant,
            plant.GetMyMutableContextFromRoot(self.context),
            self.station.object_in_plant,
            pose,
        )

    def cover(self, covered):
        self.station.CoverCamera(self.context, covered)


def make_scenario_of_seed_0():
    """The shipped one, with a heavy handle."""
    scenario = PreGraspKind().make_scenario()
    scenario.seed = 0
    return scenario


def list_modes(record):
    return [step.status.mode for step in record.steps]


@pytest.mark.slow
def test_an_object_out_of_sight_for_good_is_lost_and_the_finger_goes_up():
    task = PreGraspTask(make_scenario_of_seed_0())
    stranger = Stranger(task)

    def meddle(status, logged):
        if status.phase == PushPhase.PUSHING:
            stranger.cover(True)

    record = task.run(progress=meddle)
    assert record.status == TaskStatus.LOST
    assert record.message == f"The object has not been seen for {PreGraspTask.lost_after:g} s."
    assert record.last.mode == PreGraspMode.LOST
    assert f"not been seen for {TIMEOUT:g} s" in record.last.reason
    assert record.last.pokes == 1
    assert task.read("executor.status").ready
    assert task.read("pusher.state")[2] == pytest.approx(task.station.style.travel_height, abs=2e-3)
    assert np.abs(task.read("pusher.state")[3:]).max() < 1e-3


@pytest.mark.slow
def test_an_object_moved_out_of_sight_and_nudged_in_a_slide_is_lifted_all_the_same():
    task = PreGraspTask(make_scenario_of_seed_0())
    stranger, covered, nudged = Stranger(task), [], []
    elsewhere = (0.58, -0.12, 0.6)

    def meddle(status, logged):
        time = stranger.context.get_time()
        if status.ready and status.executed == 2 and not covered:
            stranger.cover(True)
            stranger.put(elsewhere)
            covered.append(time)
        if covered and time > covered[0] + 2 * TIMEOUT:
            stranger.cover(False)
        if (
            status.phase == PushPhase.PUSHING
            and stranger.mode == PreGraspMode.SLIDING
            and not nudged
        ):
            nudged.append(stranger.pose)
            stranger.put(nudged[0] + 0.025 * stranger.push_direction() + (0.0, 0.0, 0.1))

    record = task.run(progress=meddle)
    modes = list_modes(record)
    assert covered and nudged
    lost = modes.index(PreGraspMode.LOST)
    assert "not been seen" in record.steps[lost].status.reason
    assert record.steps[lost + 1].status.reason == "The object is seen again."
    np.testing.assert_allclose(record.steps[lost + 1].pose, elsewhere, atol=0.02)
    assert record.status == TaskStatus.HELD, record.message
    assert record.raised > 0.07
    assert calc_center_error(record, record.estimates[-1].params) < 0.03


# A stranger moves the object away from the finger: that the two do not fit together is rightly said.
@pytest.mark.filterwarnings("ignore:.*in the frame of tip_x:gridpush_drake.errors.PushLogWarning")
@pytest.mark.slow
def test_a_slide_in_which_the_object_is_shoved_over_the_edge_is_broken_off():
    scenario = make_scenario_of_seed_0()
    scenario.truth.contact_friction = [0.05, 0.05]  # and the finger slips
    task = PreGraspTask(scenario)
    stranger, shoved = Stranger(task), []
    outwards = np.array([0.0, 1.0, 0.0])  # the edge is at y = 0.15 m

    def meddle(status, logged):
        if shoved or status.phase != PushPhase.PUSHING or stranger.mode != PreGraspMode.SLIDING:
            return
        context = task.controller.GetMyContextFromRoot(stranger.context)
        monitor = task.controller._get_state(context).monitor
        far = next(
            far
            for far in np.arange(0.0, 0.4, 0.002)
            if monitor.find_fault(stranger.pose + far * outwards)
        )
        shoved.append(far)
        stranger.put(stranger.pose + (far + 0.002) * outwards)

    record = task.run(progress=meddle)
    modes = list_modes(record)
    assert shoved
    stop = record.steps[modes.index(PreGraspMode.STOPPING)]
    assert "might fall" in stop.status.reason
    assert stop.push is None
    assert (
        record.steps[modes.index(PreGraspMode.STOPPING) + 1].status.reason
        == "A push was broken off."
    )
    assert record.status == TaskStatus.HELD, record.message
