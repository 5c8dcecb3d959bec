"""The task `identify`: the station pokes an object that it knows nothing about, and learns it.

Then it is tested on further pushes, which are only predicted.
"""

from dataclasses import dataclass, field
from typing import Any

from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.display.overlay import Phase
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import StationError
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.exploration.random_pokes import (
    PokeRegion,
    RandomPokeOptions,
    RandomPokes,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import make_report
from gridpush_drake.report.progress import calc_progress
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.posts import leave_out
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.station.tasks.run_summary import calc_center_errors, compare_errors
from gridpush_drake.station.tasks.task import (
    GO_ON,
    OBSERVATION_PERIOD,
    Judgment,
    StationTask,
    TaskRecord,
    TaskStatus,
    Waiting,
)
from gridpush_drake.station.tasks.task_kind import (
    BEFORE_LOOKING,
    FIRST_TITLE,
    WEIGHINGS_FILE,
    TaskKind,
)
from gridpush_drake.systems.base.messages import PushStatus
from gridpush_drake.systems.control.poke_policy import PokePolicy, make_command

EDGE_MARGIN = 0.03
"""Distance from the table's edge, and from other objects, that pokes are meant to leave, m."""

MIDDLE_MARGIN = 0.09
"""Distance from the object's centroid to the limits of where the finger can be that lets the finger
get around the object, m. Pokes are chosen so that they keep it."""

LOST_AFTER = 0.5
"""If an ideal camera does not see the object for this long, it has left the table; simulated time,
s."""

HIDDEN_AFTER = 5.0
"""If a color and depth camera, from which the arm may hide the object, does not see it for this
long, it has left the table; simulated time, s."""

LEARNING_TIME = 10.0
"""Longest wait for the last push to be learned from, s. With a real arm learning goes on beside the
Diagram, in a thread of its own."""

MAX_REFUSALS = 20
"""If this many pushes in a row are refused, the experiment is stuck."""


@dataclass(repr=False)
class IdentifyTaskRecord(TaskRecord):
    """What came of an experiment. It is filled while the experiment runs.

    Attributes:
        training: number of pushes, from the first, that are to be learned from.
        phases: time, s, and the executor's status, whenever the executor began something new.
    """

    training: int = 0
    phases: list[tuple[float, PushStatus]] = field(default_factory=list)

    @property
    def training_log(self) -> PushLog:
        """The pushes that were learned from."""
        return self.log[: self.training]

    @property
    def held_out_log(self) -> PushLog:
        """The pushes that were only predicted."""
        return self.log[self.training :]


@dataclass
class PokeJudge:
    """Decides when an experiment is over.

    Attributes:
        pushes: number of pushes to be carried out.
        lost_after: if the object is not seen for this long, it has left the table, s.
        executed: number of pushes that had been carried out when it last judged.
        refused: number of pushes that had been refused when the last push was carried out.
    """

    pushes: int
    lost_after: float = LOST_AFTER
    executed: int = 0
    refused: int = 0

    def judge(self, status: PushStatus, waiting: Waiting) -> Judgment:
        """Judges by the executor's status and by how long nothing was seen or happened."""
        if status.executed > self.executed:
            self.executed = status.executed
            self.refused = status.refused
        if waiting.unseen > self.lost_after:
            push = status.executed + (not status.ready)
            return TaskStatus.OBJECT_LOST, f"The object left the table during push {push}."
        if status.executed >= self.pushes:
            return TaskStatus.FINISHED, f"All {self.pushes} pushes were carried out."
        if status.refused - self.refused >= MAX_REFUSALS:
            return TaskStatus.STUCK, (
                f"The last {MAX_REFUSALS} pushes were refused; the last one because "
                f"{status.reason}."
            )
        if waiting.idle > IdentifyTask.timeout:
            return TaskStatus.STUCK, (
                f"No push was found for {IdentifyTask.timeout:g} s: from where the object lies, "
                "the finger reaches no place from which it could push; is the object within the "
                "workspace?"
            )
        return GO_ON


class IdentifyTask(StationTask[IdentifyTaskRecord]):
    """An experiment: the station with a policy that pokes an object to learn it."""

    lost_after = LOST_AFTER
    timeout = 10.0
    takes_gripper = True

    def AddController(self, builder: DiagramBuilder) -> PokePolicy:
        """Adds the policy, which pokes as the scenario's `pokes` say."""
        test_pushes = self.station.scenario.pokes.test_count
        policy: PokePolicy = builder.AddNamedSystem(
            "policy", make_policy(self.station, test_pushes)
        )
        return policy

    def prepare(self, context: Context, seed: int) -> None:
        """Sets the seed from which the policy draws its pokes."""
        self.controller.SetSeed(context, seed)

    def make_record(self) -> IdentifyTaskRecord:
        """Makes the empty record of a run."""
        pokes = self.station.scenario.pokes
        lost_after = self.lost_after if self.station.found is None else HIDDEN_AFTER
        self._judge = PokeJudge(pokes.count + pokes.test_count, lost_after)
        # Number of logged pushes to learn from, and when the last of them was logged, s.
        self._logged = 0
        self._logged_at = -float("inf")
        return IdentifyTaskRecord(self.station.obj, self.station.truth, training=pokes.count)

    def note(self, record: IdentifyTaskRecord, time: float) -> bool:
        """Writes down what the executor began; something is new while a push is under way."""
        status = self.read("executor.status")
        if not record.phases or record.phases[-1][1] != status:
            record.phases.append((time, status))
        if len(record.training_log) > self._logged:
            self._logged = len(record.training_log)
            self._logged_at = time
        return not status.ready

    def judge(self, record: IdentifyTaskRecord, waiting: Waiting) -> Judgment:
        """Decides whether the experiment is over: all pushes are made, and were learned from."""
        judgment = self._judge.judge(self.read("executor.status"), waiting)
        if judgment[0] == TaskStatus.FINISHED and not self._has_learned(record.duration):
            return GO_ON
        return judgment

    def _has_learned(self, time: float) -> bool:
        """Returns whether the last push to learn from was learned from, or never will be."""
        # A message says why learning failed.
        if self.read("estimate.message") or time > self._logged_at + LEARNING_TIME:
            return True
        # The present estimate was asked for, with all pushes logged by then, at `time - age`. The
        # last push was noted up to an `OBSERVATION_PERIOD` after it was logged.
        return bool(time - self.read("estimate.age")[0] >= self._logged_at - OBSERVATION_PERIOD)

    def finish(self, record: IdentifyTaskRecord) -> None:
        """Checks that at least one push was carried out.

        Raises:
            StationError: the experiment is stuck, and not a single push could be carried out.
        """
        if not len(record.log) and record.status == TaskStatus.STUCK:
            raise StationError(record.message)


def make_policy(station: Station, test_pushes: int = 0) -> PokePolicy:
    """Makes the policy that draws pokes as the station's scenario says.

    Args:
        station: the station.
        test_pushes: number of pokes after those to learn from.
    """
    scenario = station.scenario
    pokes = scenario.pokes
    keep_in = leave_out(station.table_top.buffer(-EDGE_MARGIN), station.obstacles, EDGE_MARGIN)
    # In a small workspace the finger gets around the object nowhere; then any place will do.
    middle = MakeFingerRegion(station, MIDDLE_MARGIN)
    strategy = RandomPokes(
        RandomPokeOptions(
            distance=(pokes.distance[0], pokes.distance[1]),
            speed=pokes.speed,
            slant=pokes.slant,
            tip_radius=station.robot.finger.tip_radius,
            shape=station.robot.shape,
            clearance=pokes.clearance,
        ),
        PokeRegion(keep_in, None if middle.is_empty else middle),
        scenario.seed,
    )
    region = MakeFingerRegion(station)

    def can_push(poke: Push) -> bool:
        command = make_command(1, poke, pokes.speed)
        return not region.is_empty and station.FindObstacle(command) is None

    rules = PushConstraints(
        finger_region=None if region.is_empty else region,
        push_rule=can_push,
    )
    return PokePolicy(
        Model(station.obj),
        strategy,
        rules,
        pokes.count,
        test_pushes=test_pushes,
        test_distance=pokes.test_distance,
        answer_delay=scenario.simulation.answer_delay,
    )


class IdentifyKind(TaskKind):
    """A robot pokes an object it knows nothing about, and comes to know it."""

    help = "poke the object, learn where it is heavy, and test what was learned"
    sentence = "Poke the {} to learn where it is heavy."
    station = IdentifyTask
    has_goal = False
    counts_pokes = True
    left_out = (WEIGHINGS_FILE,)

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pushes to learn from and those held out."""
        return scenario.pokes.count + scenario.pokes.test_count

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the push that is being made, and why others were refused."""
        scenario = task.station.scenario
        total = self.count_steps(scenario)
        kind = "push" if status.executed < scenario.pokes.count else "held-out push"
        refused = ""
        if status.reason:
            refused = f" (refused {status.refused}: {status.reason})"
        number = min(status.executed + 1, total)
        return f"{kind} {number} of {total}, {status.phase}{refused}", status.executed

    def list_phases(self, record: IdentifyTaskRecord) -> list[Phase]:
        """Lists the phases of all pushes: first those to learn from, then those held out."""
        return [self._name_push(status, time, record.training) for time, status in record.phases]

    def describe_phase(self, task: Any, status: PushStatus, time: float) -> Phase | None:
        """Describes what the executor of pushes does."""
        return self._name_push(status, time, task.station.scenario.pokes.count)

    def _name_push(self, status: PushStatus, time: float, training: int) -> Phase:
        """Makes a phase of an executor's status; the first `training` pushes are learned from."""
        begun = status.executed + (not status.ready)
        if begun == 0:
            return Phase(0.0, FIRST_TITLE, BEFORE_LOOKING)
        held_out = begun > training
        kind = "Held-out push" if held_out else "Push"
        title = FIRST_TITLE if status.ready else f"{kind} {begun}: {status.phase}"
        detail = "Predicted only, to test what was learned." if held_out else ""
        return Phase(max(0.0, time - OBSERVATION_PERIOD), title, detail)

    def split_log(self, record: IdentifyTaskRecord) -> tuple[PushLog, PushLog]:
        """Splits the log by the scenario's counts."""
        return record.training_log, record.held_out_log

    def make_report(self, record: IdentifyTaskRecord, recording: str | None = None) -> str:
        """Makes the report, which shows how the error of the held-out pushes fell, push by push."""
        training, held_out = self.split_log(record)
        result = record.estimates[-1]
        progress = calc_progress(record.estimates, training, record.truth)
        learning = None
        if held_out:
            learning = [
                calc_mean_cell_error(Model(record.obj, estimate.params, result.physics), held_out)
                for estimate in (describe_prior(record.obj), *record.estimates)
            ]
        return make_report(
            result,
            training,
            held_out or None,
            record.truth,
            learning,
            camera_view=record.camera_view,
            progress=progress,
            recording=recording,
        )

    def summarize(self, record: IdentifyTaskRecord) -> dict[str, Any]:
        """Adds to the summary the errors before and after learning."""
        summary = super().summarize(record)
        summary["pushes"] = len(record.training_log)
        summary["held_out"] = len(record.held_out_log)
        if not record.estimates:
            return summary
        estimate = record.estimates[-1]
        summary["learned"] = estimate.message
        center_errors = calc_center_errors(record)
        compared = {"before": CellParameters.uniform(record.obj), "after": estimate.params}
        for name, params in compared.items():
            held_out_error = calc_mean_cell_error(
                Model(record.obj, params, estimate.physics), record.held_out_log
            )
            summary[name] = {"held_out_cell_error": held_out_error}
            if center_errors:
                summary[name]["center_of_mass_error"] = center_errors[name]
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells what was learned, and the errors before and after learning."""
        name = speak_name(summary["object"])
        lines = [summary["message"]] if summary["status"] != TaskStatus.FINISHED else []
        if "after" not in summary:
            return [*lines, f"Nothing was learned about the {name}."]
        lines.append(f"The {name} after {summary['pushes']} pushes: {summary['learned']}")
        if summary["held_out"]:
            what = f"error of {summary['held_out']} pushes held out"
            lines.append(compare_errors(what, "held_out_cell_error", summary))
        if "center_of_mass_error" in summary["after"]:
            lines.append(
                compare_errors("error of the center of mass", "center_of_mass_error", summary)
            )
        return lines
