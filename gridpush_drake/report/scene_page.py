"""The report on objects that were learned together: one self-contained HTML page."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification
from gridpush_drake.notebook import count
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.figures import draw_model, draw_scene_motion
from gridpush_drake.report.page import embed, list_numbers, render
from gridpush_drake.units import MM_PER_M

SCENE_TEMPLATE = "scene_report.html.j2"
"""File with the page, to be filled in."""

MAX_PUSHES = 12
"""Most pushes that are drawn."""

INTERVAL_SIGMAS = 1.96
"""Standard deviations from a value to the ends of its 95 % interval."""

NOT_SHOWN = "; hardly more is known than before the pushes"
"""What is added to a value that the pushes did not show."""


def make_scene_report(
    found: JointIdentification, models: Sequence[Identification], log: PushLog
) -> str:
    """Makes the report.

    Args:
        found: what was learned.
        models: the model of each object.
        log: the pushes it was learned from.

    Returns:
        An HTML page that needs nothing else.
    """
    # every push as it is predicted, over where the objects were seen to end
    drawn = []
    for i, seen in enumerate(log.pushes[:MAX_PUSHES]):
        motion = simulate_together(found, seen.push, seen.pose)
        figure = draw_scene_motion(found.objects, seen.push, motion.poses, seen.final_pose)
        errors = ", ".join(
            f"{name} {error * MM_PER_M:.1f} mm"
            for name, error in zip(log.names, found.errors[i], strict=True)
        )
        drawn.append({"name": seen.name, "figure": embed(figure), "errors": errors})
    names = ", ".join(log.names[:-1]) + f" and {log.names[-1]}" if len(log.names) > 1 else "one"
    before = float(found.errors_before.mean()) * MM_PER_M
    after = float(found.errors.mean()) * MM_PER_M
    return render(
        SCENE_TEMPLATE,
        names=names.replace("_", " "),
        headline=(
            f"With what was learned, the objects end {after:.1f} mm from where they were seen; as "
            f"even objects they would end {before:.1f} mm off."
        ),
        facts=[
            ("objects", str(len(log.names))),
            ("pushes learned from", str(len(log))),
            ("error, even objects", f"{before:.1f} mm"),
            ("error, learned", f"{after:.1f} mm"),
        ],
        pushes=drawn,
        all_pushes=len(log),
        objects=describe_models(log.names, models),
        numbers=list_scene_numbers(found, log.names),
    )


def describe_models(
    names: Sequence[str],
    models: Sequence[Identification],
    truths: Sequence[CellParameters | None] = (),
) -> list[dict[str, Any]]:
    """Describes what was learned of objects, for the template `objects_learned.html.j2`.

    Args:
        names: of the N objects.
        models: the model of each.
        truths: what the cells of each really are; None for one of which that is not known, and
            empty where it is known of none.
    """
    described = []
    for b, (name, model) in enumerate(zip(names, models, strict=True)):
        truth = truths[b] if truths else None
        described.append(
            {
                "name": name.replace("_", " "),
                "message": model.message,
                "figure": embed(draw_model(model, truth)),
                "numbers": list_numbers(model, truth),
                "known_truth": truth is not None,
                "statements": model.identifiability.statements,
            }
        )
    return described


def list_scene_numbers(found: JointIdentification, names: Sequence[str]) -> list[tuple[str, str]]:
    """Lists what was learned of objects beside each other, as names and values with their spread.

    Args:
        found: what was learned.
        names: of the objects.
    """
    rows = []
    for b, name in enumerate(names):
        center, covariance = found.calc_center(b)
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        x, y = (
            f"{value * MM_PER_M:.1f} ± {spread * MM_PER_M:.1f} mm"
            for value, spread in zip(center, std, strict=True)
        )
        rows.append((f"center of friction of {name}, body frame", f"x {x}, y {y}"))
    for b in range(1, len(names)):
        ratio = _describe_factor(*found.calc_load_ratio(b, 0))
        if not found.shows_load_ratio(b, 0):
            ratio += NOT_SHOWN
        rows.append((f"friction on the table, {names[b]} to {names[0]}", ratio))
    spreads = found.calc_pair_friction_std()
    informed = found.shows_pair_friction()
    for p, (i, j) in enumerate(combinations(range(len(names)), 2)):
        friction = _describe_factor(float(np.log(found.pair_friction[i, j])), spreads[p])
        if not informed[p]:
            friction += NOT_SHOWN
        rows.append((f"friction of {names[i]} and {names[j]}", friction))
    return rows


def _describe_factor(log: float, std: float) -> str:
    """Writes a factor whose logarithm is known so well, with its 95 % interval."""
    low, high = np.exp([log - INTERVAL_SIGMAS * std, log + INTERVAL_SIGMAS * std])
    return f"{np.exp(log):.2f} ({low:.2f} to {high:.2f})"


def explain_scene(
    found: JointIdentification, models: Sequence[Identification], names: Sequence[str]
) -> list[str]:
    """Says what was learned in lines of words.

    Args:
        found: what was learned.
        models: the model of each object.
        names: of the objects.
    """
    lines = []
    for name, model in zip(names, models, strict=True):
        lines.append(f"{name}: {count(model.obj.n, 'cell')}. {model.message}")
    before = found.errors_before.mean() * MM_PER_M
    after = found.errors.mean() * MM_PER_M
    lines.append(f"cell error of these pushes: {after:.2f} mm; {before:.2f} mm with even objects")
    lines += [f"{name}: {value}" for name, value in list_scene_numbers(found, names)]
    if found.unexplained:
        lines.append(
            f"Not explained by any loads that were found: {', '.join(found.unexplained)}. What was "
            "learned hangs on the other pushes. Was an object moved by hand, or seen wrongly?"
        )
    lines.append(
        "How heavy all objects are together, slow pushes cannot tell: the models' masses have the "
        "ratios that were learned."
    )
    return lines


def tell_scene(found: JointIdentification, names: Sequence[str]) -> dict[str, Any]:
    """Says the same for machines; lengths in m.

    Args:
        found: what was learned.
        names: of the objects.
    """
    spreads = found.calc_pair_friction_std()
    pairs = list(combinations(range(len(names)), 2))
    return {
        "objects": [
            {
                "name": name,
                "object": found.objects[b].name,
                "cells": found.objects[b].n,
                "moved": bool(found.moved[b]),
                "mean_cell_error_before": float(found.errors_before[:, b].mean()),
                "mean_cell_error": float(found.errors[:, b].mean()),
                "contact_friction": found.parameters[b].contact_friction,
                "center_of_friction": found.calc_center(b)[0].tolist(),
                "center_of_friction_covariance": found.calc_center(b)[1].tolist(),
                "log_load_ratio": None if b == 0 else found.calc_load_ratio(b, 0)[0],
                "log_load_ratio_std": None if b == 0 else found.calc_load_ratio(b, 0)[1],
                "load_ratio_told": None if b == 0 else found.shows_load_ratio(b, 0),
            }
            for b, name in enumerate(names)
        ],
        "pair_friction": [
            {
                "objects": [names[i], names[j]],
                "friction": float(found.pair_friction[i, j]),
                "log_std": float(spread),
                "told": bool(informed),
            }
            for (i, j), spread, informed in zip(
                pairs, spreads, found.shows_pair_friction(), strict=True
            )
        ],
        "training_pushes": list(found.push_names),
        "unexplained_pushes": list(found.unexplained),
        "noise_scale": found.noise_scale,
        "amplitude": found.amplitude,
        "simulations": found.simulations,
    }
