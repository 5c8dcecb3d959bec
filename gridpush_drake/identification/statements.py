"""What pushes tell and cannot tell, and what weighings tell, in sentences for people.

They are made of what `identifiability` and `absolute` calculate, when somebody asks for them.
"""

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.estimate import (
    INTERVAL_SIGMAS,
    AbsoluteEstimate,
    TiltingLine,
)
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.statistics.posterior import LEARNED_FRACTION
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.units import MM_PER_M

LIKELY_OUTLIER = 0.5
"""Probability that the pushes are wrong about the center of mass, above which this is said."""


def list_statements(
    obj: GridObject,
    *,
    learned: int,
    learned_share: Array,
    center_std: Array,
    free_box: Array,
    box: Array,
    force: ForceScale | None,
    absolute: AbsoluteEstimate | None,
) -> tuple[str, ...]:
    """Says what is known of an object and what is not; the arguments are as in `Identifiability`.

    Args:
        obj: the object.
        learned: number of combinations of the cells' log friction that the pushes determined.
        learned_share: (n,) fraction of each cell's prior variance that they took away.
        center_std: (2,) standard deviations of the center of friction, m.
        free_box: (2, 2) box of possible centers of mass by poses alone, m.
        box: (2, 2) box of possible centers of mass with forces and weighings, m.
        force: what measured forces say; None where there are none.
        absolute: what weighings say; None of an object that was not weighed.
    """
    weighed = absolute is not None and not absolute.contradictory
    center_box = box if weighed else None
    statements = _describe(obj, learned, learned_share, center_std, free_box, center_box)
    if force is not None:
        # The first statement is that the common scale is not known: with forces it is.
        scale = _describe_force(obj, force, free_box, box, weighed)
        statements = (scale, *statements[1:])
    if absolute is not None:
        statements = (_describe_mass_tests(absolute), *statements)
    return statements


def _describe(
    obj: GridObject,
    learned: int,
    learned_share: Array,
    center_std: Array,
    box: Array,
    center_box: Array | None,
) -> tuple[str, ...]:
    """Says in sentences what slow pushes observed by their poses show, and what they cannot.

    Args:
        obj: the object.
        learned: number of combinations of the cells' log friction that the pushes determined.
        learned_share: (n,) fraction of each cell's prior variance that they took away.
        center_std: (2,) standard deviation of the center of friction, m.
        box: (2, 2) box of possible centers of mass by the pushes and the friction's bounds, m.
        center_box: (2, 2) what weighings leave of it, m; None of an object that was not weighed.
    """
    total = (
        "that they add up to the known total mass"
        if obj.prior.total_mass
        else "a total mass that was not measured"
    )
    supposed = f"suppose that all cells have the same friction coefficient, and {total}"
    rest = "with equal coefficients it is at the center of friction"
    if center_box is not None:
        supposed = (
            "are those nearest to it, as a whole, that have the weighed mass and center of mass"
        )
        rest = f"the weighings leave {_describe_size(center_box)} of it"
    known_cells = int((learned_share >= LEARNED_FRACTION).sum())
    low = obj.prior.friction_min
    high = obj.prior.friction_max
    return (
        "Not identifiable from these data: the common scale of the friction. "
        "Slow pushes observed by their poses look the same when every cell rubs twice as hard.",
        "Not identifiable from these data: mass and friction of a cell apart. Only their product, "
        f"relative to the other cells', acts on a slow push; the masses shown {supposed}.",
        _describe_patterns(obj, learned, known_cells),
        f"The center of friction is known to {MM_PER_M * center_std[0]:.1f} mm in x "
        f"and {MM_PER_M * center_std[1]:.1f} mm in y (one standard deviation).",
        "Were the friction of each cell exactly as estimated, friction coefficients anywhere from "
        f"{low:g} to {high:g} would still leave the center of mass anywhere in a box of "
        f"{_describe_size(box)}; {rest}.",
    )


def _describe_patterns(obj: GridObject, patterns: int, cells: int) -> str:
    """Says how many combinations of the cells the pushes determined, and how many cells profit."""
    if patterns < 1:
        return (
            f"The pushes determined nothing of how the friction is spread over the {obj.n} cells."
        )
    many = "1 pattern" if patterns == 1 else f"{patterns} independent patterns"
    return (
        f"The pushes determined {many} of how the friction is spread over the {obj.n} cells, such "
        "as more at one end and less at the other. Since neighboring cells are supposed to be "
        f"alike, this takes at least half of the variance from {cells} of the cells; what sets a "
        "cell apart from its neighbors stays as it was supposed beforehand."
    )


def _describe_force(
    obj: GridObject, force: ForceScale, wide: Array, box: Array, weighed: bool
) -> str:
    """Says what the measured forces show that poses alone do not.

    Args:
        obj: the object.
        force: the scale that the forces give.
        wide: (2, 2) box of possible centers of mass without forces, m.
        box: (2, 2) box of possible centers of mass with them, m.
        weighed: whether the object was weighed, so that its mass is known better than by forces.
    """
    known = (
        f"The forces of {force.pushes} pushes show the common scale of the friction, "
        f"which poses do not: the table holds the whole object with {force.friction:.2f} N, "
        f"give or take {force.friction * force.relative_std:.2f} N (one standard deviation). "
    )
    if force.against:
        known += (
            f"Left out are the forces of {force.against} pushes "
            "that point against the pusher's motion. "
        )
    if weighed:
        return known.rstrip()
    lightest, heaviest = force.calc_mass_bounds(obj)
    low = obj.prior.friction_min
    high = obj.prior.friction_max
    mass = obj.prior.total_mass
    between = (
        f"with friction coefficients from {low:g} to {high:g} "
        f"the object weighs {lightest:.3g} to {heaviest:.3g} kg"
    )
    if mass is None:
        return f"{known}Hence {between}."
    mean = force.calc_mean_friction_bounds(obj)
    if mean is None:
        return (
            f"{known}That contradicts what was told: {between}, not {mass:g} kg; "
            "the forces are not used."
        )
    return (
        f"{known}As it weighs {mass:g} kg, the mean friction coefficient is between {mean[0]:.3f} "
        f"and {mean[1]:.3f}, and the box of possible centers of mass is {_describe_size(box)}; "
        f"without forces it would be {_describe_size(wide)}."
    )


def _describe_mass_tests(absolute: AbsoluteEstimate) -> str:
    """Says what weighings show."""
    if absolute.contradictory:
        return (
            f"Weighed by {describe_sources(absolute)}, which contradict each other: with a "
            f"probability of {absolute.agreement:.2g} observations agree as badly as these. "
            "Their numbers are not used. Are the edge, the places and the signs of the forces "
            f"right? {_describe_tests(absolute)}"
        ).rstrip()
    low, high = absolute.mass_interval
    least, most = absolute.friction_interval
    x, y = absolute.center_of_mass * MM_PER_M
    std = absolute.center_std * MM_PER_M
    words = (
        f"Weighed by {describe_sources(absolute)}: the object weighs {absolute.total_mass:.3g} kg "
        f"({low:.3g} to {high:.3g} kg with a probability of 95 %), and its center of mass is at "
        f"x {x:.1f} ± {std[0]:.1f} mm, y {y:.1f} ± {std[1]:.1f} mm (one standard deviation). "
    )
    if absolute.pushes:
        words += f"The mean friction coefficient is {absolute.friction:.3f} "
        words += f"({least:.3f} to {most:.3f})."
    else:
        words += "The forces of no push were measured, so that the friction stays as supposed."
    if absolute.center_outlier_probability > LIKELY_OUTLIER:
        words += (
            " What the pushes say of the center of mass is not used, for it disagrees with all "
            "weighings together: the object may stand on feet of very different friction."
        )
    return f"{words} {_describe_tests(absolute)}".rstrip()


def _describe_tests(absolute: AbsoluteEstimate) -> str:
    """Says which presses do not count as tilts about the edge; empty if all do."""
    words = []
    for i, one in enumerate(absolute.tests):
        if one.line == TiltingLine.EDGE:
            continue
        statement = f"press {i + 1} gave way at {one.force:.2f} N, where {one.expected:.2f} N "
        statement += (
            f"({one.residual:+.1f} standard deviations) are expected of a tilt about the edge"
        )
        if one.line == TiltingLine.NONE:
            words.append(f"{statement}, and is left out")
        else:
            assert one.support_distance is not None
            words.append(
                f"{statement}: it rocked on supports {one.support_distance * MM_PER_M:.0f} mm "
                "inside the edge"
            )
    if not words:
        return ""
    text = "; ".join(words)
    return f"{text[0].upper()}{text[1:]}."


def _describe_size(box: Array) -> str:
    """Says how wide and how high a box (2, 2), m, is."""
    x, y = np.diff(box, axis=0)[0] * MM_PER_M
    return f"{x:.0f} mm by {y:.0f} mm"


def describe_sources(estimate: AbsoluteEstimate) -> str:
    """Names what an estimate rests on: "3 presses at the edge and 1 lift"."""
    counted = (
        (estimate.presses, "press at the edge", "presses at the edge"),
        (estimate.lifts, "lift", "lifts"),
        (estimate.pushes, "push with measured forces", "pushes with measured forces"),
    )
    named = [f"{n} {one if n == 1 else many}" for n, one, many in counted if n]
    return " and ".join(filter(None, [", ".join(named[:-1]), named[-1]]))


def describe_weighed(absolute: AbsoluteEstimate) -> str:
    """Says how well mass, center of mass, inertia and friction are known, in a sentence."""
    low, high = absolute.mass_interval
    x, y = absolute.center_of_mass * MM_PER_M
    std = absolute.center_std * MM_PER_M
    words = [
        f"weighed by {describe_sources(absolute)}; with a probability of 95 %, mass "
        f"{absolute.total_mass:.4g} kg ({low:.4g} to {high:.4g} kg)",
        f"center of mass x {x:.1f} ± {INTERVAL_SIGMAS * std[0]:.1f} mm, y {y:.1f} ± "
        f"{INTERVAL_SIGMAS * std[1]:.1f} mm",
    ]
    low, high = absolute.inertia_interval
    words.append(f"inertia about z {absolute.inertia:.3g} kg m² ({low:.3g} to {high:.3g} kg m²)")
    if absolute.pushes:
        low, high = absolute.friction_interval
        words.append(f"mean friction {absolute.friction:.3f} ({low:.3f} to {high:.3f})")
    return ", ".join(words) + "."
