"""`PreGraspKind`: the task to poke, slide, grasp and lift an object, as the commands know it.

`SlideKind` is the same without the grasp.

The task itself is in `station.tasks.pregrasp_task`. What weighings said of the object is summarized
here, too, as only this task weighs.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from gridpush_drake.identification.absolute.estimate import (
    INTERVAL_SIGMAS,
    AbsoluteEstimate,
)
from gridpush_drake.identification.statements import describe_sources
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.planning.belief import Belief
from gridpush_drake.report.page import ReportSummary
from gridpush_drake.report.plan_figures import GraspDrawn, PushDrawn, draw_pre_grasp
from gridpush_drake.report.progress import ExpectedUncertainty
from gridpush_drake.station.tasks.pregrasp_task import PreGraspRecord, PreGraspTask, SlideTask
from gridpush_drake.station.tasks.run_summary import (
    calc_center_errors,
    compare_errors,
    count_pushes,
)
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.station.tasks.task_kind import (
    FIRST_TITLE,
    HELD_OUT,
    TaskKind,
)
from gridpush_drake.systems.base.messages import PreGraspMode, PushStatus
from gridpush_drake.units import MM_PER_M

PREGRASP_TITLES = {
    PreGraspMode.WAITING: FIRST_TITLE,
    PreGraspMode.EXPLORING: "Poke {status.pokes}, to learn where the mass is",
    PreGraspMode.SLIDING: "Slide {status.slides}, toward the table's edge",
    PreGraspMode.STOPPING: "Breaking off the push",
    PreGraspMode.WEIGHING: "Weighing it at the table's edge",
    PreGraspMode.VERIFYING: "Checking that it can be grasped here",
    PreGraspMode.READY: "It can be grasped here",
    PreGraspMode.GRASPING: "Grasping and lifting",
    PreGraspMode.HOLDING: "Lifted and held",
    PreGraspMode.LOST: "The object is out of sight",
    PreGraspMode.FAILED: "Given up",
}
"""Titles beside the recording for the pre-grasp controller's modes, with its `status`."""


STATUS_HEADLINES = {
    TaskStatus.FAILED: "The robot gave the object up.",
    TaskStatus.DROPPED: "The object fell.",
    TaskStatus.STUCK: "Nothing happened any more.",
}
"""One sentence for each end that the controller explains at length. The explanation
stands below."""


class PreGraspKind(TaskKind):
    """A robot pokes an object, learns it, slides it to the table's edge, grasps and lifts it."""

    help = "poke and learn it, slide it to the table's edge, grasp it there and lift it"
    sentence = "Slide the {} to the table's edge, grasp it there and lift it."
    station = PreGraspTask
    done = TaskStatus.HELD
    scenario = "grasp"
    left_out = (HELD_OUT,)
    grasps = True
    weighs = True

    def describe_step(self, task: Any, status: PushStatus) -> tuple[str, int]:
        """Names what the controller is doing."""
        now = task.read("status", task.controller)
        return f"{now.mode}, {count_pushes(now.pokes, now.slides)}", int(now.over)

    def name_phase(self, status: Any) -> str:
        """Returns a title with the number of the poke or slide."""
        return PREGRASP_TITLES[status.mode].format(status=status)

    def summarize(self, record: PreGraspRecord) -> dict[str, Any]:
        """Adds to the summary whether the object was lifted, and how well its center was known."""
        summary = super().summarize(record) | {
            "pokes": record.last.pokes,
            "slides": record.last.slides,
            "grasps": record.last.grasps,
            "presses": record.last.presses,
            "raised": record.raised,
        }
        if record.estimates:
            for name, error in calc_center_errors(record).items():
                summary[name] = {"center_of_mass_error": error}
        if record.estimates and record.estimates[-1].absolute is not None:
            summary["weighed"] = summarize_weighed(record.estimates[-1].absolute, record)
        return summary

    def describe(self, summary: dict[str, Any]) -> list[str]:
        """Tells whether the object was lifted, and how well its center of mass was known."""
        name = speak_name(summary["object"])
        pushes = count_pushes(summary["pokes"], summary["slides"])
        message = summary["message"]
        headline = STATUS_HEADLINES.get(summary["status"], message)
        lines = [f"The {name} after {pushes}: {headline}"]
        if headline != message:
            lines.append(f"  {message}")
        if "after" in summary:
            lines.append(
                compare_errors("error of the center of mass", "center_of_mass_error", summary)
            )
        if "weighed" in summary:
            weighed = summary["weighed"]
            lines.append(f"  weighed by {weighed['sources']}, each with a probability of 95 %:")
            lines += [f"  {what}: {value}, {more}" for what, value, more in list_weighed(weighed)]
        return lines

    def count_made(self, record: PreGraspRecord) -> dict[str, Any]:
        """Counts pokes and slides, too, and adds how far the object was raised."""
        return super().count_made(record) | {
            "pokes": record.last.pokes,
            "slides": record.last.slides,
            "raised": None if np.isnan(record.raised) else record.raised,
        }

    def list_expectations(self, record: PreGraspRecord) -> list[ExpectedUncertainty]:
        """Lists how well each poke was expected to tell the center of mass.

        Some pokes are chosen for the center's distance from the table's edge alone; their forecast
        is of something else, and is left out.
        """
        expectations = []
        for step in record.steps:
            status = step.status
            forecast = status.forecast
            if step.push is None or status.mode != PreGraspMode.EXPLORING or forecast is None:
                continue
            if not forecast.across_edge:
                pushes = status.pokes + status.slides
                expectations.append(ExpectedUncertainty(pushes, forecast.expected_std))
        return expectations

    def make_summary(self, record: PreGraspRecord) -> ReportSummary:
        """Shows the object's way to the edge, and how safely it lies there."""
        last = record.last
        headline = STATUS_HEADLINES.get(record.status, record.message)
        facts: list[tuple[str, str]] = []
        # Of an object that no gripper took, nobody asks how far it was raised.
        if last.grasps:
            raised = f"{max(0.0, record.raised) * MM_PER_M:.0f} mm"
            known = np.isfinite(record.raised)
            facts.append(("raised by", raised if known else "not measured"))
        if record.estimates and record.estimates[-1].absolute is not None:
            weighed = summarize_weighed(record.estimates[-1].absolute, record)
            facts += [(f"{what}, {more}", value) for what, value, more in list_weighed(weighed)]
        return ReportSummary(
            headline=f"{headline} It took {count_pushes(last.pokes, last.slides)}.",
            facts=(
                ("pokes", str(last.pokes)),
                ("slides", str(last.slides)),
                ("simulated", f"{record.duration:.0f} s"),
                *facts,
            ),
            figure=_draw_pre_grasp(record),
            caption="Left: pokes to learn, then slides to the table's edge. Right: as long as its "
            "center of mass is within what holds the object it stays put; it was judged on every "
            "place where the center of mass may still be.",
            heads=("time", "what", "why"),
            steps=[
                (f"{step.time:.1f}\N{NO-BREAK SPACE}s", step.status.mode, step.status.reason)
                for step in record.steps
                if step.status.mode != PreGraspMode.WAITING
            ],
        )


class SlideKind(PreGraspKind):
    """A robot pokes an object, learns it, and slides it to where it can be grasped."""

    help = "poke and learn it, and slide it to the table's edge, until it can be grasped there"
    sentence = "Slide the {} to the table's edge, until it can be grasped there."
    station = SlideTask
    done = TaskStatus.REACHED


def summarize_weighed(absolute: AbsoluteEstimate, record: PreGraspRecord) -> dict[str, Any]:
    """Summarizes what weighings said, in SI units, beside the truth if somebody knows that."""
    summary = absolute.summarize() | {"sources": describe_sources(absolute)}
    for key in ("center_of_mass", "center_of_mass_covariance"):
        summary[key] = summary[key].tolist()
    truth = record.truth
    if truth is not None:
        mass = float(truth.total_mass)
        summary["true"] = {
            "total_mass": mass,
            "center_of_mass": truth.center_of_mass(record.obj).tolist(),
            "friction": float(truth.mass @ truth.friction) / mass,
        }
    return summary


def list_weighed(weighed: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Lists what weighings said, in words: what it is, its value, and interval beside the truth.

    Args:
        weighed: what `summarize_weighed` returned.
    """
    true = weighed.get("true")

    def add_truth(interval: str, key: str, describe: Callable[[Any], str]) -> str:
        """Adds to an interval what is true."""
        return interval if true is None else f"{interval}; truly {describe(true[key])}"

    def describe_mass(mass: float) -> str:
        return f"{mass:.3f} kg"

    def describe_place(place: Sequence[float]) -> str:
        x, y = (MM_PER_M * value for value in place)
        return f"x {x:.1f} mm, y {y:.1f} mm"

    def describe_friction(friction: float) -> str:
        return f"{friction:.3f}"

    low, high = weighed["total_mass_interval"]
    reach = INTERVAL_SIGMAS * MM_PER_M * np.sqrt(np.diag(weighed["center_of_mass_covariance"]))
    listed = [
        (
            "mass",
            describe_mass(weighed["total_mass"]),
            add_truth(f"{low:.3f} to {high:.3f} kg", "total_mass", describe_mass),
        ),
        (
            "center of mass",
            describe_place(weighed["center_of_mass"]),
            add_truth(f"± {reach[0]:.1f} and {reach[1]:.1f} mm", "center_of_mass", describe_place),
        ),
    ]
    if weighed["friction"] is not None:
        low, high = weighed["friction_interval"]
        interval = add_truth(f"{low:.3f} to {high:.3f}", "friction", describe_friction)
        listed.append(("mean friction", describe_friction(weighed["friction"]), interval))
    return listed


def _draw_pre_grasp(record: PreGraspRecord) -> Figure:
    """Draws the report's figure of pokes, slides and grasp."""
    poses = [
        step.pose for step in record.steps if np.isfinite(step.pose).all() and not step.status.over
    ]
    pushes = [
        PushDrawn(step.push.start, step.push.end, step.status.mode == PreGraspMode.EXPLORING)
        for step in record.steps
        if step.push is not None
    ]
    grasps = [step.grasp for step in record.steps if step.grasp is not None]
    last_grasp = None
    if grasps:
        last_grasp = GraspDrawn(np.array([grasps[-1].x, grasps[-1].y]), grasps[-1].approach)
    return draw_pre_grasp(
        record.obj,
        record.surface,
        poses,
        pushes,
        masses=Belief.of_identification(record.estimates[-1], log=record.log).masses,
        truth=record.truth,
        grasp=last_grasp,
    )
