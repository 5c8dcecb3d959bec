"""What holds for one object alone, and why: the one table of it, and the one place that refuses it.

Everything else holds for any number of objects. `docs/howto/several_objects.md` has the same table.
"""

from gridpush_drake.errors import GridPushError

ONE_OBJECT_ALONE = {
    "regime": "several are pushed slowly, in the regime 'quasi_static', without momentum",
    "push by a force": "a force accelerates what it pushes, and several have no momentum",
    "velocity": "several are at rest before a push, and have no momentum",
    "table": "what leans on another object at the table's edge is not known, so loads do not shift",
    "push_height": "how high objects press on each other is not known, so loads do not shift",
    "gradients": "several have the whole exact Jacobian, gradients=True, and no part by itself",
    "method": "several are learned by the default method",
    "budget": "the default method, by which several are learned, ends by itself",
    "friction": "several lie on the table, where pushes show the same loads with any friction",
    "weighings": "several are weighed one by one, each with its own model",
    "keep": "of several, no push is refused for disagreeing with the others",
    "fit_frame": "of several, each outline is supposed to be in the frame of its logged poses",
    "body_at": "several are placed in the frames of their logged poses by their files",
    "steer": "a steered finger pushes one object, and none into another",
}
"""What is for one object alone, by the name of the argument that asks for it, with the reason."""


def describe_one_alone(name: str, asked: str = "") -> str:
    """Says that something is for one object alone, and why.

    Args:
        name: a key of `ONE_OBJECT_ALONE`.
        asked: the argument that asks for it, where that has another name.
    """
    return f"{asked or name}: is for one object; {ONE_OBJECT_ALONE[name]}"


def refuse_several(
    error: type[GridPushError], name: str, wanted: object = True, asked: str = ""
) -> None:
    """Refuses what is for one object alone, where there are several.

    Args:
        error: class of the error.
        name: a key of `ONE_OBJECT_ALONE`.
        wanted: whether it was asked for.
        asked: the argument that asks for it, where that has another name.

    Raises:
        GridPushError: it was asked for; of the class `error`.
    """
    if wanted:
        raise error(describe_one_alone(name, asked))
