"""`FollowKind`: the task to push an object along a path, as the commands know it.

The task itself is in `station.tasks.follow_task`.
"""

from typing import Any

import numpy as np

from gridpush_drake.display.overlay import Mark, to_css
from gridpush_drake.notebook import count as count_noun
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.report.follow_figure import draw_follow_run
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.follow_task import (
    GONE_COLOR,
    PLANNED_COLOR,
    FollowRecord,
    FollowTask,
)
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.station.tasks.task_kind import TaskKind
from gridpush_drake.systems.base.messages import PushStatus
from gridpush_drake.systems.control.follow_controller import FollowControlStatus, FollowMode
from gridpush_drake.units import MM_PER_M

FOLLOW_SCENARIO = "slalom"
"""Name of the shipped scenario of the task to push along a path."""


FOLLOW_TITLES = {
    FollowMode.POKING: "Poking the object, to learn it",
    FollowMode.PLANNING: "Planning a path",
    FollowMode.GOING: "The finger goes to the object",
    FollowMode.FOLLOWING: "Pushing along the path",
    FollowMode.REACHED: "At the end of the path",
    FollowMode.FAILED: "Given up",
}
"""Titles beside the recording for the modes of the controller that follows a path."""


class FollowKind(TaskKind):
    """A robot pokes an object, learns it, and pushes it along a path with feedback."""

    station = FollowTask
    done = TaskStatus.REACHED
    scenario = FOLLOW_SCENARIO
    hides = True
    marks = (
        Mark(to_css(PLANNED_COLOR), "where the object should go, and lie at the end"),
        Mark(to_css(GONE_COLOR), "where it went"),
    )

    def count_steps(self, scenario: PushScenario) -> int:
        """Counts the pokes, and the path."""
        return scenario.pokes.count + 1

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names the poke, or what the controller does afterwards."""
        now: FollowControlStatus = task.read("status", task.controller)
        if now.mode == FollowMode.POKING:
            return f"poke {status.executed + (not status.ready)}, {status.phase}", status.executed
        return FOLLOW_TITLES[now.mode], status.executed

    def name_phase(self, status: Any) -> str:
        """Returns a title for what the controller does."""
        return FOLLOW_TITLES[status.mode]

    def summarize(self, record: FollowRecord) -> dict[str, Any]:
        """Adds to the summary how the object kept to its path, and where it ended."""
        return super().summarize(record) | {
            "cause": record.last.cause,
            "pokes": record.pokes,
            "plans": record.last.plans,
            "goal": record.goal.tolist(),
            "distance": record.distance,
            "turn": record.turn,
            "path_rms": record.calc_rms(),
            "steering_seconds": record.steering_time,
            "clearance": record.calc_clearance() if record.obstacles else None,
        }

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object came to the path's end, and how near it kept to the path."""
        name = speak_name(summary["object"])
        pokes = count_noun(summary["pokes"], "poke")
        lines = [f"The {name} after {pokes}: {summary['message']}"]
        if np.isfinite(summary["path_rms"]):
            lines.append(
                f"  in {summary['steering_seconds']:.1f} s, {summary['path_rms'] * MM_PER_M:.1f} "
                "mm from "
                f"its path (root mean square); {summary['distance'] * MM_PER_M:.1f} mm and "
                f"{np.degrees(summary['turn']):.1f}° from the end"
            )
        force = summary["limit_report"]["force"]
        lines.append(f"  greatest force on the finger: {force:.1f} N")
        if summary["limit_report"]["touched"]:
            pairs = (" and ".join(pair) for pair in summary["limit_report"]["touched"])
            lines.append(f"  these touched, but should not: {'; '.join(pairs)}")
        return lines

    def make_summary(self, record: FollowRecord) -> ReportSummary:
        """Shows the path, the object's way and what stood in it."""
        path = record.paths[-1] if record.paths else None
        away = (
            f"{record.calc_clearance() * MM_PER_M:.0f} mm" if record.obstacles else "nothing there"
        )
        return ReportSummary(
            headline=record.message,
            facts=(
                ("pokes", str(record.pokes)),
                ("on its way", f"{record.steering_time:.1f} s"),
                ("from the path, RMS", f"{record.calc_rms() * MM_PER_M:.1f} mm"),
                ("nearest to an obstacle", away),
                ("greatest force", f"{record.limit_report.force:.1f} N"),
            ),
            figure=draw_follow_run(
                record.obj,
                planned=np.empty((0, 3)) if path is None else path.poses,
                poses=record.poses,
                tips=record.tips,
                times=record.times,
                distances=record.calc_distances(),
                goal=record.goal,
                surface=record.surface,
                obstacles=record.obstacles,
            ),
            caption="Left: the path of the object's middle as it was planned, its way, and the "
            "finger's; the object dotted where it should end. Right: how far the middle was from "
            "its path.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
            ],
        )
