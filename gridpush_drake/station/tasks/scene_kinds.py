"""Kinds of tasks with several objects, as the commands know them: separate, rearrange, fetch."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from gridpush_drake.display.overlay import Mark, to_css
from gridpush_drake.files import write_whole
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.identification.model_file import MODEL_FILE
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification
from gridpush_drake.notebook import count
from gridpush_drake.planning.scene.fetching import POKE_KIND, SLIDE_KIND, FetchOptions
from gridpush_drake.planning.scene.joint_loop import SceneMode
from gridpush_drake.planning.scene.separation import WANTED_CLEARANCE, calc_clearances_along
from gridpush_drake.pushes.push_csv import PUSHES_FILE
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.report.scene_page import describe_models, list_scene_numbers
from gridpush_drake.report.scene_run import draw_scene_run, make_scene_report
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.tasks.push_task import GOAL_COLOR
from gridpush_drake.station.tasks.scene_task import (
    FetchTask,
    RearrangeTask,
    SceneTaskRecord,
    SeparateTask,
    name_objects,
)
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.station.tasks.task_kind import REPORT_FILE, GoalKind
from gridpush_drake.units import MM_PER_M

LOOKING_PHASE = (
    "Looking at the objects",
    "The robot looks where the objects lie. Colors and ellipses show what it supposes beforehand: "
    "even objects, of which little is known.",
)
"""Title and text beside the scene until the first push."""

MODE_TITLES = {
    SceneMode.WAITING: LOOKING_PHASE[0],
    SceneMode.PUSHING: "Push {}",
    SceneMode.GRASPING: "Grasping and lifting",
    SceneMode.HOLDING: "Lifted and held",
    SceneMode.DONE: "Done",
    SceneMode.LOST: "An object is out of sight",
    SceneMode.FAILED: "Given up",
}
"""Titles beside the recording for the controller's modes; {} is the push's number."""


class SceneKind(GoalKind):
    """A task with several objects.

    Of the files that a run leaves, pushes.csv has the poses of all objects, object.yaml and
    truth.yaml are the first one's, and each object has a model of its own.

    Attributes:
        verb: what is done with them, in a word, for a title.
    """

    done = TaskStatus.REACHED
    several = True
    looking = LOOKING_PHASE
    verb: ClassVar[str]

    def list_model_files(self, resolved: ResolvedScenario) -> tuple[str, ...]:
        """Lists the names of the files of the objects' models, in the order of the objects."""
        return tuple(map(name_model_file, name_objects((resolved.obj, *resolved.others))))

    def list_models(self, record: SceneTaskRecord) -> dict[str, Identification]:
        """Lists what was learned of each object by the names of the models' files."""
        return {
            name_model_file(name): found
            for name, found in zip(record.names, record.learned, strict=False)
            if found.push_names
        }

    def name_phase(self, status: Any) -> str:
        """Returns a title with the push's number."""
        return MODE_TITLES[status.mode].format(status.pushes + 1)

    def measure(self, record: SceneTaskRecord, poses: Array) -> Array:
        """Measures the objects in states (P, N, 3): (P, N) m, by which the task goes on."""
        return calc_clearances_along(record.objects, poses)

    def describe_measure(self, record: SceneTaskRecord) -> tuple[str, float | None]:
        """Says what `measure` measures, and where it should come to, m."""
        return "room around each", WANTED_CLEARANCE

    def summarize(self, record: SceneTaskRecord) -> dict[str, Any]:
        """Adds to the summary the objects, the pushes, and what was measured at the end."""
        words, _ = self.describe_measure(record)
        last = self.measure(record, record.poses[None])[0]
        return super().summarize(record) | {
            "objects": list(record.names),
            "pushes": record.pushes,
            "measured": words,
            "at_end": [float(value) for value in last],
            "camera": summarize_camera_view(record),
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells what came of it, and what was measured of each object at the end."""
        lines = [f"After {count(summary['pushes'], 'push')}: {summary['message']}"]
        for name, value in zip(summary["objects"], summary["at_end"], strict=True):
            lines.append(f"  {name}, {summary['measured']}: {value * MM_PER_M:.1f} mm")
        return [*lines, *describe_camera_view(summary)]

    def count_made(self, record: SceneTaskRecord) -> dict[str, Any]:
        """Counts the pushes that were asked for, and adds how far object 0 was raised.

        Pokes and slides are told apart only where pushes are for something.
        """
        kinds = record.list_kinds()
        return {
            "pushes": record.pushes,
            "pokes": kinds.count(POKE_KIND) if any(kinds) else None,
            "slides": kinds.count(SLIDE_KIND) if any(kinds) else None,
            "raised": None if np.isnan(record.raised) else record.raised,
        }

    def make_summary(self, record: SceneTaskRecord) -> ReportSummary:
        """Shows where the objects lay after every push."""
        # where they were seen at rest, and what that is worth
        poses = list_rest_poses(record)
        values = self.measure(record, poses)
        words, wanted = self.describe_measure(record)
        # a row of the table for each push
        made = [step for step in record.steps if step.push is not None]
        steps = [
            (
                f"{step.time:.1f}\N{NO-BREAK SPACE}s",
                record.names[step.status.body] if step.status.body >= 0 else "",
                step.status.reason,
            )
            for step in made
        ]
        return ReportSummary(
            headline=record.message,
            facts=(
                ("objects", str(len(record.objects))),
                ("pushes", str(record.pushes)),
                ("simulated", f"{record.duration:.0f} s"),
                *list_view_facts(summarize_camera_view(record)),
            ),
            figure=draw_scene_run(
                record.objects,
                record.names,
                poses,
                [seen.push for seen in record.scene_log],
                values,
                (words, wanted),
                goals=record.goals,
                surface=record.surface,
            ),
            caption="Left: the objects before, after each push and at the end, the pushes as "
            f"arrows with their numbers, goals dotted. Right: {words}, as it was seen; lines "
            "that would lie on each other are drawn side by side.",
            heads=("time", "pushed", "why"),
            steps=steps,
        )

    def make_report(self, record: SceneTaskRecord, recording: str | None = None) -> str:
        """Makes the report, as HTML."""
        name = f"{self.verb}: {', '.join(record.names)}"
        models = record.learned
        known = None if record.belief is None else record.belief.identification
        numbers: list[tuple[str, str]] = []
        if isinstance(known, JointIdentification):
            numbers = list_scene_numbers(known, record.names)
        return make_scene_report(
            name,
            self.make_summary(record),
            recording,
            objects=describe_models(record.names, models, record.truths) if models else (),
            numbers=numbers,
        )

    def write_own(
        self, folder: Path, record: SceneTaskRecord, recording: str | None, force: bool
    ) -> list[str]:
        """Writes the report, and what was seen of all objects in each push."""
        if not record.scene_log:
            return []
        names = tuple(map(make_plain, record.names))
        PushLog(record.scene_log, names=names).write_csv(folder / PUSHES_FILE, force)
        write_whole(folder / REPORT_FILE, self.make_report(record, recording), force)
        return [PUSHES_FILE, REPORT_FILE]


class SeparateKind(SceneKind):
    """A robot pushes objects that touch apart, until each has room around it."""

    help = "push them apart"
    sentence = "Push the {} and the other objects apart."
    station = SeparateTask
    scenario = "separate"
    verb = "Separate"


class RearrangeKind(SceneKind):
    """A robot pushes objects to goals, and learns them on the way."""

    help = "push each to a goal"
    sentence = "Push the {} and the other objects to their goals."
    station = RearrangeTask
    scenario = "rearrange"
    verb = "Rearrange"
    marks = (Mark(to_css(GOAL_COLOR), "where the objects should lie"),)

    def measure(self, record: SceneTaskRecord, poses: Array) -> Array:
        """Measures how far the objects' middles are from where they should be, (P, N) m."""
        distances = []
        for b, obj in enumerate(record.objects):
            middle = obj.p_BC.mean(axis=0)[None]
            off = transform(poses[:, b], middle)[:, 0] - transform(record.goals[b], middle)[0]
            distances.append(np.nan_to_num(np.linalg.norm(off, axis=1)))
        return np.stack(distances, axis=1)

    def describe_measure(self, record: SceneTaskRecord) -> tuple[str, float | None]:
        """Says what `measure` measures."""
        return "distance from the goal", None


class FetchKind(SceneKind):
    """A robot clears the way for one object, slides it to the table's edge and lifts it."""

    help = "clear the way for one, and grasp it at the table's edge"
    sentence = "Clear the way for the {}, and grasp it at the table's edge."
    station = FetchTask
    scenario = "fetch"
    verb = "Fetch"
    done = TaskStatus.HELD
    grasps = True

    def describe_measure(self, record: SceneTaskRecord) -> tuple[str, float | None]:
        """Says what `measure` measures, and how much room the object needs to be pushed, m."""
        return "room around each", FetchOptions().room

    def summarize(self, record: SceneTaskRecord) -> dict[str, Any]:
        """Adds to the summary how far the object was raised, and what the pushes were for."""
        # every push is for something
        kinds = record.list_kinds()
        return super().summarize(record) | {
            "raised": record.raised,
            "kinds": {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)},
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object was lifted, and what the pushes were for."""
        kinds = ", ".join(f"{number} to {kind}" for kind, number in summary["kinds"].items())
        lines = [f"The {summary['objects'][0]}: {summary['message']}"]
        if kinds:
            lines.append(f"  {count(summary['pushes'], 'push')}: {kinds}")
        return [*lines, *describe_camera_view(summary)]


def name_model_file(name: str) -> str:
    """Names the file of an object's model, as `gridpush identify --with` does."""
    file = Path(MODEL_FILE)
    return file.with_stem(f"{file.stem}_{make_plain(name)}").name


def make_plain(name: str) -> str:
    """Returns an object's name without spaces, for files and columns."""
    return name.replace(" ", "_")


def summarize_camera_view(record: SceneTaskRecord) -> dict[str, Any] | None:
    """Summarizes what a color and depth camera saw, in SI units; None with ideal cameras."""
    view = record.scene_view
    if view is None or not len(view.t):
        return None
    position, angle = view.calc_rms()
    return {
        "pictures": len(view.t),
        "seen": [float(fraction) for fraction in view.seen.mean(axis=0)],
        "position_rms": position,
        "angle_rms": angle,
    }


def list_view_facts(camera: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Lists for a report how well the objects were followed; nothing with ideal cameras."""
    if camera is None:
        return []
    return [
        ("seen", f"{min(camera['seen']):.0%} or more"),
        ("poses off by (RMS)", describe_errors(camera, ", ")),
    ]


def describe_camera_view(summary: dict[str, Any]) -> list[str]:
    """Tells in a line how well the objects were followed; nothing with ideal cameras."""
    camera = summary["camera"]
    if camera is None:
        return []
    return [
        f"  camera: each object seen in {min(camera['seen']):.0%} or more of "
        f"{count(camera['pictures'], 'picture')}, its pose off by "
        f"{describe_errors(camera, ' and ')} (RMS)"
    ]


def describe_errors(camera: dict[str, Any], joint: str) -> str:
    """Gives the errors of poses that a camera followed, with a word between the two."""
    turn = np.degrees(camera["angle_rms"])
    return f"{camera['position_rms'] * MM_PER_M:.2f} mm{joint}{turn:.2f}\N{DEGREE SIGN}"


def list_rest_poses(record: SceneTaskRecord) -> Array:
    """Lists where the objects were seen at rest, (P+1, N, 3): before each push, and at last."""
    if not record.scene_log:
        return record.begin[None]
    poses = [seen.pose for seen in record.scene_log]
    return np.array([*poses, record.scene_log[-1].poses_observed[-1]])
