"""The report: one self-contained HTML page about a learned model, and about what a robot did."""

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from matplotlib.figure import Figure

from gridpush_drake import Model, __version__
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.identification.absolute.estimate import (
    MIN_FIT_PROBABILITY,
    AbsoluteEstimate,
    TiltingLine,
)
from gridpush_drake.identification.prediction import (
    ErrorSummary,
    calc_final_errors,
    calc_mean_cell_error,
    summarize_errors,
)
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.identification.sentences import describe_center_conflict
from gridpush_drake.identification.statistics.outliers import remove_outliers
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera_view import CameraView
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.camera_figure import describe_camera_view, draw_camera_view
from gridpush_drake.report.draw import to_svg
from gridpush_drake.report.figures import (
    MAX_DUMBBELLS,
    MAX_OVERLAYS,
    PushOutcome,
    draw_errors,
    draw_learning,
    draw_loss,
    draw_model,
    draw_object,
    draw_overlays,
    draw_pushes,
    draw_tilt_tests,
    draw_unknown_maps,
)
from gridpush_drake.report.progress import ExpectedUncertainty, Progress, draw_progress
from gridpush_drake.units import MM_PER_M

LINE_WORDS = {
    TiltingLine.EDGE: "about the edge",
    TiltingLine.SUPPORTS: "about a line of supports",
    TiltingLine.NONE: "left out",
}
"""How a table says about which line an object tilted."""

Row = tuple[str, str, str]
"""A quantity's name, its learned value and, where it is known, the true one."""


def list_numbers(result: Identification, truth: CellParameters | None = None) -> list[Row]:
    """Lists the quantities that sum a model up.

    Args:
        result: the model.
        truth: what the object's cells really are; None where that is not known.

    Returns:
        A row for each quantity, with its standard deviation.
    """
    obj = result.obj
    known = result.identifiability
    params = result.params

    def describe_true(describe: Callable[[CellParameters], str]) -> str:
        return "" if truth is None else describe(truth)

    spread = np.sqrt(np.maximum(np.diagonal(known.center_of_friction_covariance), 0.0))
    low, high = known.center_of_mass_box
    labels = np.unique(obj.labels).tolist()
    rows = [_describe_part(result, label, truth) for label in labels] if len(labels) > 1 else []
    possible_x = _range(low[0], high[0])
    possible_y = _range(low[1], high[1])
    rows += [
        (
            "center of friction",
            _point(known.center_of_friction, spread),
            describe_true(lambda true: _point(true.relative_friction() @ obj.p_BC)),
        ),
        (
            "center of mass, estimate",
            _point(params.center_of_mass(obj)),
            describe_true(lambda true: _point(true.center_of_mass(obj))),
        ),
        (
            "center of mass, possible",
            f"x {possible_x}, y {possible_y}",
            "",
        ),
        (
            "contact friction",
            f"{params.contact_friction:.2f} ± {result.std.contact_friction:.2f}",
            describe_true(lambda true: f"{true.contact_friction:.2f}"),
        ),
        (
            "total mass",
            f"{params.total_mass:.3g} kg" + _describe_mass_source(result),
            describe_true(lambda true: f"{true.total_mass:.3g} kg"),
        ),
        ("left unexplained", f"{result.noise_std * MM_PER_M:.2f} mm per axis", ""),
    ]
    if obj.outline_pose is not None:
        rows.append(("outline's frame, in the body frame", obj.outline_pose.describe(), ""))
    if result.force is not None:
        friction = result.force.friction
        std = friction * result.force.relative_std
        true_friction = describe_true(
            lambda true: f"{GRAVITY * float(true.mass @ true.friction):.2f} N"
        )
        rows.append(
            (
                "friction with the table, of the measured forces",
                f"{friction:.2f} ± {std:.2f} N",
                true_friction,
            )
        )
    if result.weighed is not None:
        rows += _list_absolute(result.weighed, describe_true, obj)
    return rows


def _list_absolute(
    absolute: AbsoluteEstimate,
    describe_true: Callable[[Callable[[CellParameters], str]], str],
    obj: GridObject,
) -> list[Row]:
    """Lists what weighings say, each with the bounds that hold with a probability of 95 %."""
    rows = [
        (
            "center of mass, weighed",
            _point(absolute.center_of_mass, absolute.center_std),
            describe_true(lambda true: _point(true.center_of_mass(obj))),
        )
    ]
    if absolute.pushes:
        low, high = absolute.friction_interval
        rows.append(
            (
                "mean friction, of forces and weighings",
                f"{absolute.friction:.3f}, {low:.3f} to {high:.3f}",
                describe_true(
                    lambda true: f"{float(true.mass @ true.friction) / true.total_mass:.3f}"
                ),
            )
        )
    low, high = absolute.inertia_interval
    rows.append(
        (
            "inertia about the vertical axis",
            f"{absolute.inertia:.3g} kg m², {low:.3g} to {high:.3g} kg m²",
            describe_true(lambda true: f"{true.inertia(obj):.3g} kg m²"),
        )
    )
    return rows


def _describe_mass_source(result: Identification) -> str:
    """Says where the total mass is from; nothing of one that was told."""
    if result.weighed is not None:
        low, high = result.weighed.mass_interval
        return f", weighed: {low:.3g} to {high:.3g} kg with a probability of 95 %"
    if result.obj.prior.total_mass:
        return ""
    if result.force is None:
        return ", assumed"
    return ", of the measured forces and the friction that was supposed"


def list_tilt_tests(absolute: AbsoluteEstimate | None) -> list[tuple[str, ...]]:
    """Lists the presses at the table's edge: place, force, what was expected, and its judgment."""
    if absolute is None:
        return []
    rows: list[tuple[str, ...]] = []
    for i, one in enumerate(absolute.tests):
        x, y = (MM_PER_M * value for value in one.place)
        judged = LINE_WORDS[one.line]
        if one.support_distance is not None:
            judged += f", {one.support_distance * MM_PER_M:.0f} mm inside the edge"
        if one.line == TiltingLine.EDGE and one.support_distance is not None:
            judged = (
                f"about the edge, after it rocked {one.support_distance * MM_PER_M:.0f} mm inside "
                "it"
            )
        rows.append(
            (
                str(i + 1),
                f"x {x:.0f} mm, y {y:.0f} mm",
                f"{one.arm * MM_PER_M:.0f} mm",
                f"{one.force:.2f} N",
                f"{one.expected:.2f} N",
                f"{one.residual:+.1f}",
                f"{judged} ({100 * one.probability:.0f} %)",
            )
        )
    return rows


def describe_making(result: Identification, log: PushLog, version: str) -> list[tuple[str, str]]:
    """Lists how the model was made."""
    return [
        (
            "object",
            f"{speak_name(result.obj.name)}, {result.obj.n} cells of "
            f"{result.obj.cell_size * MM_PER_M:.1f} mm",
        ),
        ("pushes", log.source or "given in memory"),
        ("method", result.method),
        ("physics", result.regime.replace("_", "-")),
        ("status", result.status.replace("_", " ")),
        *_describe_hypotheses(result),
        ("simulated pushes", str(result.simulations)),
        ("seed", str(result.seed)),
        ("gridpush-drake", version),
    ]


def _describe_hypotheses(result: Identification) -> list[tuple[str, str]]:
    """Names the hypotheses of the loads that the estimate rests on, the weightiest first."""
    counted = [one for one in result.hypotheses if one.weight >= MIN_HYPOTHESIS_WEIGHT]
    counted.sort(key=lambda one: -one.weight)
    words = ", ".join(f"{one.name} ({one.weight * 100:.0f} %)" for one in counted)
    return [("hypotheses of the loads, by weight", words)] if words else []


def _describe_part(result: Identification, label: int, truth: CellParameters | None) -> Row:
    """The fraction of the support's friction that a part carries."""
    part = (result.obj.labels == label).astype(np.float64)
    fraction = result.identifiability.relative_friction @ part
    spread = np.sqrt(max(part @ result.posterior.calc_fraction_covariance() @ part, 0.0))
    true = "" if truth is None else f"{truth.relative_friction() @ part * 100:.0f} %"
    return f"friction carried by part {label}", f"{fraction * 100:.0f} ± {spread * 100:.0f} %", true


def _point(point: np.ndarray, spread: np.ndarray | None = None) -> str:
    """Writes a point (2,), m, in mm, and its standard deviations (2,), m, where they are known."""
    if spread is None:
        return f"({point[0] * MM_PER_M:.1f}, {point[1] * MM_PER_M:.1f}) mm"
    x, y = (
        f"{value * MM_PER_M:.1f} ± {std * MM_PER_M:.1f}"
        for value, std in zip(point, spread, strict=True)
    )
    return f"({x}, {y}) mm"


def _range(low: float, high: float) -> str:
    """Writes a range, m, in mm."""
    if not np.isfinite([low, high]).all():
        return "not bounded"
    return f"{low * MM_PER_M:.0f} to {high * MM_PER_M:.0f} mm"


@dataclass(frozen=True, eq=False)
class ReportSummary:
    """What was done, and what came of it.

    Attributes:
        headline: what came of it, in a sentence or two.
        facts: three or four things that are counted, and their counts.
        figure: a figure of it.
        caption: the figure's caption.
        heads: heads of the columns of `steps`.
        steps: what was done, in order, a row for each step.
    """

    headline: str
    facts: Sequence[tuple[str, str]]
    figure: Figure
    caption: str
    heads: tuple[str, ...]
    steps: Sequence[tuple[str, ...]]


PAGE_TEMPLATE = "report.html.j2"
"""File with the page, to be filled in."""

STYLE_FILE = "style.css"
"""File with the style of all pages."""

MIN_HYPOTHESIS_WEIGHT = 0.01
"""Smallest fraction of the estimate with which a hypothesis of the loads is named in the report."""

SIMILAR_FRACTION = 0.05
"""Two errors are called about the same if they differ by less than this fraction."""


@dataclass(frozen=True, eq=False)
class _Comparison:
    """One log, predicted before and after learning.

    Attributes:
        held_out: whether the model never saw it.
        errors_before: errors of the predictions with uniform parameters.
        errors_after: errors of the predictions as learned.
        outcomes: how each push came out.
    """

    held_out: bool
    errors_before: list[ErrorSummary]
    errors_after: list[ErrorSummary]
    outcomes: list[PushOutcome]

    @property
    def cell(self) -> tuple[float, float]:
        """Mean cell error, m, before and after; NaN where nothing was observed."""
        return _find_cell_error(self.errors_before), _find_cell_error(self.errors_after)


def _find_cell_error(errors: Sequence[ErrorSummary]) -> float:
    """Finds the mean cell error, m, among all errors; NaN where nothing was observed."""
    return next((error.mean for error in errors if error.name == "cell"), float("nan"))


def make_report(
    identification: Identification,
    log: PushLog,
    held_out: PushLog | None = None,
    truth: CellParameters | None = None,
    learning: Sequence[float] | None = None,
    summary: ReportSummary | None = None,
    camera_view: CameraView | None = None,
    progress: Progress | None = None,
    expectations: Sequence[ExpectedUncertainty] = (),
    recording: str | None = None,
) -> str:
    """Makes the report.

    Args:
        identification: the model.
        log: the pushes it was learned from.
        held_out: pushes it never saw, with their final poses.
        truth: what the object's cells really are, where that is known.
        learning: mean cell error of the held-out pushes, m, before the first push and after each;
            None where nobody followed it.
        summary: what a robot did with the object; None where it only looked.
        camera_view: what its camera saw; None where it was told the object and its poses.
        progress: what was known after each push; None where nobody followed it.
        expectations: of pokes, for the figure of the progress.
        recording: the file with the recording of the run, as seen from the report; None without.

    Returns:
        An HTML page that needs nothing else.
    """
    obj = identification.obj

    # Every push is predicted before and after learning; those held out are the ones that count.
    used = remove_outliers(log, identification.outliers)
    used = used.subset(
        [i for i, seen in enumerate(used) if seen.name not in identification.unused_pushes]
    )
    training = _compare(identification, used, held_out=False)
    fresh = _compare(identification, held_out, held_out=True) if held_out else None
    compared = [training, *([fresh] if fresh else [])]
    judged = fresh if fresh and fresh.outcomes else training
    outcomes = [outcome for comparison in reversed(compared) for outcome in comparison.outcomes]
    floor = None
    if truth is not None and held_out is not None and learning:
        floor = calc_mean_cell_error(Model(obj, truth, identification.physics), held_out)

    tests = () if identification.absolute is None else identification.absolute.tests
    figures = _draw_figures(identification, log, held_out, truth, training.cell[0], outcomes)
    figures |= {
        "learning": embed(draw_learning(learning, floor)) if learning else None,
        "summary": None if summary is None else embed(summary.figure),
        "sight": None if camera_view is None else embed(draw_camera_view(camera_view)),
        "progress": None if progress is None else embed(draw_progress(progress, expectations)),
        "tilt_tests": embed(draw_tilt_tests(obj, tests)) if tests else None,
    }
    if summary is None:
        headline = _make_headline(identification, judged)
        facts: Sequence[tuple[str, str]] = _list_facts(identification, judged, log, held_out)
    else:
        headline = summary.headline
        facts = summary.facts
    return render(
        PAGE_TEMPLATE,
        name=speak_name(obj.name),
        headline=headline,
        message=identification.message,
        conflict=describe_center_conflict(identification) if identification.push_names else None,
        facts=facts,
        summary=summary,
        sight=None if camera_view is None else describe_camera_view(camera_view),
        figures=figures,
        predicted="" if progress is None else progress.describe(),
        expected=bool(expectations),
        recording=recording,
        known_truth=truth is not None,
        has_held_out=fresh is not None,
        overlays_shown=min(len(outcomes), MAX_OVERLAYS),
        outcomes=len(outcomes),
        line_by_line=len(outcomes) <= MAX_DUMBBELLS,
        error_tables=[_tabulate_errors(comparison) for comparison in compared],
        unused=identification.unused_pushes,
        refused=[outlier.describe() for outlier in identification.outliers],
        statements=identification.identifiability.statements,
        tilt_tests=list_tilt_tests(identification.absolute),
        agreement=1.0 if identification.absolute is None else identification.absolute.agreement,
        min_fit_probability=MIN_FIT_PROBABILITY,
        numbers=list_numbers(identification, truth),
        making=describe_making(identification, log, __version__),
    )


def _draw_figures(
    result: Identification,
    log: PushLog,
    held_out: PushLog | None,
    truth: CellParameters | None,
    before: float,
    outcomes: list[PushOutcome],
) -> dict[str, str | None]:
    """Draws all figures as data URIs; None where there is nothing to draw."""
    figures = {
        "object": draw_object(result.obj),
        "pushes": draw_pushes(result, log, held_out),
        "maps": draw_model(result, truth),
        "unknown": draw_unknown_maps(result),
        "loss": draw_loss(result.history, before) if result.history else None,
        "overlays": draw_overlays(result.obj, outcomes) if outcomes else None,
        "errors": draw_errors(outcomes) if outcomes else None,
    }
    return {name: None if figure is None else embed(figure) for name, figure in figures.items()}


def _compare(result: Identification, log: PushLog, held_out: bool) -> _Comparison:
    """Predicts a log's pushes with uniform parameters, and as the model predicts them."""
    obj = result.obj
    before = Model(obj, physics=result.physics).predict(log)
    after = result.predict(log)
    errors_before = calc_final_errors(obj, before, log)
    errors_after = calc_final_errors(obj, after, log)
    outcomes = []
    for i, seen in enumerate(log):
        error_before = errors_before[i]
        error_after = errors_after[i]
        if error_before is not None and error_after is not None:
            outcome = PushOutcome(
                seen=seen,
                before=before[i].at_observations[-1],
                after=after[i].at_observations[-1],
                error_before=error_before.cell,
                error_after=error_after.cell,
                held_out=held_out,
            )
            outcomes.append(outcome)
    return _Comparison(
        held_out=held_out,
        errors_before=summarize_errors(obj, before, log),
        errors_after=summarize_errors(obj, after, log),
        outcomes=outcomes,
    )


def _make_headline(result: Identification, judged: _Comparison) -> str:
    """The first sentence: what came of it, in plain words."""
    before, after = judged.cell
    name = speak_name(result.obj.name)
    if result.status == IdentificationStatus.NO_DATA or not np.isfinite(after):
        return f"Nothing was learned about the {name}: the pusher touched it in none of the pushes."
    which = "pushes it had never seen" if judged.held_out else "the pushes it learned from"
    if result.status == IdentificationStatus.EXPLAINS_LITTLE:
        return (
            f"This model of the {name} should not be used. Where {which} end, it is off by "
            f"{after * MM_PER_M:.1f} mm on average, and an even object by {before * MM_PER_M:.1f} "
            "mm."
        )
    if result.status == IdentificationStatus.PRIOR_KEPT:
        return (
            "These pushes gave no reason to leave the assumption of an even object: predictions of "
            f"{which} are off by {after * MM_PER_M:.1f} mm on average."
        )
    count = len(result.push_names)
    spent = (
        "The search ended early, at its budget. "
        if result.status == IdentificationStatus.BUDGET_SPENT
        else ""
    )
    pushes = "push" if count == 1 else "pushes"
    learned = f"{spent}After {count} {pushes}, the model predicts where {which} leave the {name}"
    if after > (1 - SIMILAR_FRACTION) * before:
        return (
            f"{learned} to {after * MM_PER_M:.1f} mm on average, about as well as assuming an even "
            f"object ({before * MM_PER_M:.1f} mm)."
        )
    off = f"it is off by {before * MM_PER_M:.1f} mm."
    return f"{learned} to {after * MM_PER_M:.1f} mm on average; assuming an even object, {off}"


def _list_facts(
    result: Identification, judged: _Comparison, log: PushLog, held_out: PushLog | None
) -> list[tuple[str, str]]:
    """Three large numbers below the headline."""
    before, after = judged.cell
    facts = [("pushes learned from", str(len(result.push_names)))]
    if held_out:
        facts.append(("pushes held out", str(len(held_out))))
    if np.isfinite(after):
        facts += [
            ("error, even object", f"{before * MM_PER_M:.1f} mm"),
            ("error, learned", f"{after * MM_PER_M:.1f} mm"),
        ]
    return facts


def _tabulate_errors(comparison: _Comparison) -> dict[str, Any]:
    rows = []
    for first, second in zip(comparison.errors_before, comparison.errors_after, strict=True):
        values = (first.mean, second.mean, second.median, second.p90)
        rows.append((first.name, *(f"{value * first.scale:.2f} {first.unit}" for value in values)))
    kind = "held out" if comparison.held_out else "learned from"
    return {"title": f"{len(comparison.outcomes)} pushes {kind}", "rows": rows}


def render(template: str, **values: Any) -> str:
    """Fills in a page of the report's templates, with the style that all pages have.

    Args:
        template: the template's file.
        values: what is filled in, by the names that the template has for it.

    Returns:
        An HTML page that needs nothing else.
    """
    environment = Environment(
        loader=FunctionLoader(read_template),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(style=read_template(STYLE_FILE), **values)


def read_template(name: str) -> str:
    """Reads a file of the report's templates."""
    folder = files("gridpush_drake.report").joinpath("templates")
    return folder.joinpath(name).read_text(encoding="utf-8")


def embed(figure: Figure) -> str:
    """Makes a data URI of a figure, for a page that needs nothing else."""
    return "data:image/svg+xml;base64," + base64.b64encode(to_svg(figure)).decode()
