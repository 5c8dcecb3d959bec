"""What a model and its log are worth, in sentences for people.

The fits return numbers, and `model_check` judges them. What is said of them in messages and
warnings, by `identify`, by reports and by the command line alike, is said here.
"""

from collections.abc import Iterator, Sequence

from gridpush_drake.identification.fit.flipped_poses import FlippedPoses
from gridpush_drake.identification.fit.learning_task import Found
from gridpush_drake.identification.model_check import FitCheck, FitJudgment, find_center_conflict
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.notebook import count
from gridpush_drake.units import MM_PER_M

MAX_NAMED = 8
"""Greatest number of pushes that a message names."""

FIT_ENDS = {
    IdentificationStatus.LEARNED: "Learned from the pushes.",
    IdentificationStatus.PRIOR_KEPT: "The pushes do not show that the object is other than even: "
    "an almost even object explains them best, or predicts pushes left out about as well.",
    IdentificationStatus.NO_DATA: "The pusher never touched the object: nothing was learned, this "
    "is the prior.",
}
"""What is said of a fit, by how it ended."""


def describe_learning(found: Found, judgment: FitJudgment) -> str:
    """Says how learning of one object ended, and what speaks against the model."""
    model = found.alone
    against = judgment.against
    poor = None if against is None else describe_fit_check(against, model.obj.name)
    if found.search_end is None:
        return poor or FIT_ENDS.get(model.status, "")
    # A fit says of itself only that it learned from the pushes, but a search how it ended.
    end = found.search_end.replace("_", " ")
    ended = f"The search ended after {model.simulations} simulations: {end}."
    return ended if poor is None else f"{ended} {poor}"


def describe_fit_check(check: FitCheck, name: str) -> str:
    """Says how far off a model is from its own pushes, of an object of that name."""
    off = (
        f"it is off by {check.error * MM_PER_M:.1f} mm on average, an even object by "
        f"{check.even_error * MM_PER_M:.1f} mm, "
        f"while the object moves by {check.motion * MM_PER_M:.1f} mm."
    )
    if check.status == IdentificationStatus.EXPLAINS_LITTLE:
        return (
            f"This model explains these pushes poorly: {off} "
            "Is object_theta in rad and counterclockwise, are all poses in one frame, "
            f"and are all pushes of {name} and its outline right?"
        )
    return f"This model predicts these pushes no better than an even object would: {off}"


def list_warnings(found: Found, judgment: FitJudgment) -> Iterator[str]:
    """Says what in the pushes may spoil the model, or is not learned from, and why."""
    if judgment.unused_forces is not None:
        yield judgment.unused_forces
    if found.flipped is not None:
        yield describe_flipped(found.flipped, found.alone.obj.name)


def describe_flipped(flipped: FlippedPoses, name: str) -> str:
    """Says which poses a tracker seems to have flipped, of an object of that name."""
    names = flipped.names
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    shown = ", ".join(names[:MAX_NAMED]) + more
    angle = "half a turn" if flipped.half else f"turns of {360 / flipped.order:.0f}°"
    return (
        f"column object_theta: the poses of at least {len(names)} of {flipped.pushes} pushes "
        f"({shown}) seem to be {angle} off those of the others, by which the outline of "
        f"{name} looks the same; does the tracker take one end for the other? The center of "
        "friction is not to be believed"
    )


def describe_poor_fit(model: Identification) -> str | None:
    """Says why a model should not be trusted; None where nothing speaks against it.

    That is a model that explains too little of the pushes it was learned from (its status is then
    "explains_little"), and a center of friction too far from the center of mass told.
    """
    if not model.push_names:
        return None
    poor = model.status == IdentificationStatus.EXPLAINS_LITTLE
    conflicts = (model.message if poor else None, describe_center_conflict(model))
    return " ".join(filter(None, conflicts)) or None


def describe_center_conflict(model: Identification) -> str | None:
    """Says that the center of friction is too far from the center of mass that was told.

    Returns:
        The sentences; None where both agree, or no center of mass was told.
    """
    distance = find_center_conflict(model)
    if distance is None or model.obj.prior.center_of_mass is None:
        return None
    x, y = model.obj.prior.center_of_mass
    return (
        f"The pushes put the center of friction {distance * MM_PER_M:.1f} mm "
        f"from the center of mass that was told, [{x:g}, {y:g}] m. Is center_of_mass.at right?"
    )


def describe_center_outside(model: Identification, distance: float, source: str) -> str:
    """Says that weighings put the center of mass where it cannot be.

    Args:
        model: the model, with what the weighings say.
        distance: how far outside the outline that is, m.
        source: what names the weighings.
    """
    assert model.absolute is not None
    x, y = model.absolute.center_of_mass
    message = (
        f"{source}: they put the center of mass at [{x:.4g}, {y:.4g}] m, "
        f"{distance * MM_PER_M:.1f} mm "
        f"outside the outline of {model.obj.name}, where it cannot be. Are pose, place, edge and "
        "force of each weighing right?"
    )
    poor = model.status == IdentificationStatus.EXPLAINS_LITTLE
    return f"{model.message} {message}" if poor else message


def describe_part(
    status: IdentificationStatus,
    *,
    moved: bool,
    others: int,
    pushes: int,
    errors: tuple[float, float],
    unexplained: Sequence[str],
) -> str:
    """Says what was learned of one of several objects.

    Args:
        status: of its model.
        moved: whether a push moved it.
        others: number of the other objects.
        pushes: number of the pushes.
        errors: its mean cell error as learned, and that of an even object, m.
        unexplained: names of the pushes that the model does not explain.
    """
    if not moved:
        return "No push moved it: nothing was learned of it."
    after, before = (error * MM_PER_M for error in errors)
    message = (
        f"Learned together with {count(others, 'other object')} from {count(pushes, 'push')}: "
        f"cell error {after:.2f} mm, {before:.2f} mm as an even object."
    )
    if unexplained:
        message += f" It does not explain {', '.join(unexplained)}."
    if status == IdentificationStatus.EXPLAINS_LITTLE:
        return f"The model explains little of the pushes. {message}"
    if status == IdentificationStatus.PRIOR_KEPT:
        return f"The pushes are predicted no better than for an even object. {message}"
    return message
