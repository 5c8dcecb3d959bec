"""`gridpush identify`: learns a model of an object from observed pushes."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gridpush_drake.cli.learn.identify_scene import identify_together
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found, search_progress
from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.identification.learning import identify as learn
from gridpush_drake.identification.methods import LEARNING_METHODS, find_method
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_check import calc_training_errors
from gridpush_drake.identification.model_file import write_model
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.identification.sentences import (
    describe_center_conflict,
    describe_poor_fit,
)
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.pushes.misplaced import explain_no_contact
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog
from gridpush_drake.report.page import make_report
from gridpush_drake.units import MM_PER_M

Method = Literal[
    "default",
    "paper",
    "random_search",
    "weighted_sampling",
    "finite_difference",
    "cma_es",
    "nelder_mead",
]
"""A method of learning."""

EXIT_EXPLAINS_LITTLE = 3
"""Exit code if a model was written, but should not be used: it is far off from its own pushes, or
its center of mass is outside the object."""


def identify(
    object_file: Annotated[
        str,
        typer.Argument(
            metavar="OBJECT.yaml",
            help="The object that was pushed: an object file, or a shipped object's name.",
            show_default=False,
        ),
    ],
    pushes: options.PushesFile,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="MODEL.yaml", help="The model file to write.")
    ],
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="REPORT.html",
            callback=options.EXPECT_HTML,
            help="Also write a report with figures, as one page for the browser.",
        ),
    ] = None,
    weighings: Annotated[
        Path | None,
        typer.Option(
            metavar="WEIGHINGS.csv",
            help="Presses at the table's edge and lifts of the same object. With them the model "
            "says mass and center of mass in absolute numbers and, with the forces of pushes, the "
            "mean friction. docs/reference/files.md has the columns.",
        ),
    ] = None,
    others: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="NAME=OBJECT.yaml",
            help="Another object that is in the log, too; may be repeated. All are learned "
            "together from pushes in which one pushes another, and each gets a model file of its "
            "own, MODEL_NAME.yaml. The log has the columns NAME_x, NAME_y and NAME_theta for each; "
            "NAME= may be left out if it is the object's own name. The first object's name may "
            "stand before OBJECT.yaml in the same way.",
        ),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PUSH",
            help="Name of a push that is learned from however little it agrees with the others; "
            "may be repeated. Without it, a push that seems to be of another object is refused, "
            "and the output says by how much.",
        ),
    ] = None,
    fit_frame: Annotated[
        bool,
        typer.Option(
            "--fit-frame",
            help="Learn where the outline is in the frame of the logged poses, too: the frame that "
            "your tracker gives the object may be off the one in which the outline was drawn, by "
            "an unknown shift and turn of about 10 mm and 6 degrees. The model's object is moved "
            "there, and the output says by how much.",
        ),
    ] = False,
    body_at: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,THETA",
            help="Where the outline's frame is in the frame of the logged poses, m, m and rad, "
            "where you know it. The model's object is moved there; with --fit-frame, that is "
            "where the search begins.",
            show_default="both are the same",
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            metavar="METHOD",
            help="The method of learning. default is the best and the fastest; the others are "
            "there to be compared with: paper, the method of Song and Boularias, random_search, "
            "weighted_sampling, finite_difference, nelder_mead and cma_es, which needs "
            "pip install '.\\[baselines]'.",
        ),
    ] = "default",
    seed: options.Seed = 0,
    regime: options.Regime = "auto",
    budget: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="How many pushes a search may simulate; only with a --method other than default, "
            "which ends by itself.",
            show_default="the method's own",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Learn from a log of pushes where an object is heavy and where it rubs.

    The model that is written holds the learned masses and frictions, and how sure they are. The
    exit code is 3 if it should not be used: it explains little of the very pushes that it was
    learned from, or weighings put its center of mass outside the object.

    Example: gridpush identify object.yaml pushes.csv --out model.yaml --report report.html
    """
    if budget is not None and not find_method(method).abilities.takes_budget:
        raise options.OptionError(
            "--budget: goes with a --method other than default, which ends by itself"
        )
    if others:
        alone = {
            "weighings": weighings is not None,
            "method": not any(one.abilities.takes_several for one in LEARNING_METHODS[method]),
            "regime": regime == "inertial",
            "keep": bool(keep),
            "fit_frame": fit_frame,
            "body_at": body_at is not None,
        }
        for name, given in alone.items():
            asked = f"--{name.replace('_', '-')}"
            refuse_several(options.OptionError, name, given, asked)
        identify_together([object_file, *others], pushes, out, report, largest_piece, force, json)
        return
    options.check_outputs(force, out, report, inputs=(object_file, pushes, weighings))
    obj = options.load_object(object_file, largest_piece)
    if body_at is not None:
        obj = obj.place(options.read_numbers("--body-at", body_at, "x,y,theta (m, m and rad)", 3))
    full = options.load_log(pushes, obj)
    log = full.supported
    weighed = MassTestLog() if weighings is None else MassTestLog.read_csv(weighings)
    options.compile_kernels()
    with search_progress(f"identifying {speak_name(obj.name)}", budget) as progress:
        result = learn(
            Model(obj),
            log,
            method,
            seed,
            regime=regime,
            budget=budget,
            progress=progress,
            weighings=weighed,
            keep=keep or (),
            fit_frame=fit_frame,
        )
    if not result.push_names:
        raise PushLogError(explain_no_contact(obj, log))
    with write_together():
        write_model(out, result, force)
        if report is not None:
            write_whole(report, make_report(result, log), force)
    found = {
        **describe_result(result, log),
        "overhanging_pushes": [seen.name for seen in full.overhanging],
        "written": [str(path) for path in (out, report) if path],
    }
    print_found(
        found, [*explain_result(result, found), "", *options.describe_written(out, report)], json
    )
    if result.status == IdentificationStatus.EXPLAINS_LITTLE:
        raise typer.Exit(EXIT_EXPLAINS_LITTLE)


def describe_result(result: Identification, log: PushLog) -> dict[str, Any]:
    """Returns what was learned, for machines; lengths are in m.

    Args:
        result: what was learned.
        log: the pushes that it was learned from.
    """
    before, after = calc_training_errors(result, log)
    return {
        "object": result.obj.name,
        "cells": result.obj.n,
        "method": result.method,
        "regime": result.regime,
        "status": result.status,
        "message": result.message,
        "doubt": describe_poor_fit(result),
        "seed": result.seed,
        "simulations": result.simulations,
        "training_pushes": result.push_names,
        "unused_pushes": result.unused_pushes,
        "outliers": [
            {
                "push": out.push,
                "poses": out.poses,
                "observed": out.observed,
                "share": out.fraction,
                "whole": out.whole,
                "disagreement": out.disagreement and asdict(out.disagreement),
            }
            for out in result.outliers
        ],
        "hypotheses": [asdict(one) for one in result.hypotheses],
        "noise_std": result.noise_std,
        "load_shift_std": result.load_shift_std,
        "mean_cell_error_before": before,
        "mean_cell_error": after,
        "contact_friction": result.params.contact_friction,
        "contact_friction_std": result.std.contact_friction,
        "center_of_friction": result.identifiability.center_of_friction,
        "outline_pose": result.obj.outline_pose and asdict(result.obj.outline_pose),
        "force": None if result.force is None else asdict(result.force),
        "absolute": result.absolute and result.absolute.summarize(),
        "statements": result.identifiability.statements,
    }


def explain_result(result: Identification, found: dict[str, Any]) -> list[str]:
    """Returns what was learned, in lines of words.

    Args:
        result: what was learned.
        found: the same as a document, with "overhanging_pushes" added.
    """
    conflict = describe_center_conflict(result) if result.push_names else None
    center = result.identifiability.center_of_friction
    covariance = result.identifiability.center_of_friction_covariance
    # rounding may leave a variance a little below zero
    std = [max(variance, 0.0) ** 0.5 for variance in covariance.diagonal()]
    x = f"{center[0] * MM_PER_M:.1f} ± {std[0] * MM_PER_M:.1f} mm"
    y = f"{center[1] * MM_PER_M:.1f} ± {std[1] * MM_PER_M:.1f} mm"
    cells = count_noun(result.obj.n, "cell")
    pushes = count_noun(len(result.push_names), "push")
    contact_friction = result.params.contact_friction
    lines = [
        f"{speak_name(result.obj.name)}: {cells}, {pushes}, {result.simulations} simulations",
        result.message,
        *([conflict] if conflict else []),
        f"cell error of these pushes: {found['mean_cell_error'] * MM_PER_M:.2f} mm; "
        f"{found['mean_cell_error_before'] * MM_PER_M:.2f} mm of an even object",
        f"center of friction: x {x}, y {y}, in the body frame",
        f"contact friction: {contact_friction:.2f} ± {result.std.contact_friction:.2f}",
    ]
    if result.obj.outline_pose is not None:
        where = result.obj.outline_pose.describe()
        lines.append(f"the outline's frame is in the body frame of the log at {where}")
    if result.unused_pushes:
        lines.append(
            f"left out, as the pusher never touched the object: {', '.join(result.unused_pushes)}"
        )
    lines += [outlier.describe() for outlier in result.outliers]
    if found["overhanging_pushes"]:
        lines.append(options.describe_overhanging(found["overhanging_pushes"]))
    statements = [f"  - {statement}" for statement in result.identifiability.statements]
    return [*lines, "What these pushes tell, and what they cannot tell:", *statements]
