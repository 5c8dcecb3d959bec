"""All methods of learning by name, and what cannot be asked of them.

A method is an object (`fit.learning_task.LearningMethod`), and `identify` takes one of a user's own
as well. What a method can do it says itself; what is asked of it and it cannot is refused in
`screening`.
"""

from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.baselines.methods import SEARCH_METHODS
from gridpush_drake.identification.baselines.search_learner import SearchLearner
from gridpush_drake.identification.fit.learning_task import LearningMethod
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.multi_object.joint_fit import JointEnsemble

LEARNING_METHODS: dict[str, tuple[LearningMethod, ...]] = {
    "default": (MapEnsemble(), JointEnsemble()),
    **{name: (SearchLearner(name, search),) for name, search in SEARCH_METHODS.items()},
}
"""The methods by name; the first of each is that for one object."""

METHOD_NAMES = tuple(LEARNING_METHODS)
"""Names of the methods that `identify` offers."""


def find_method(method: str | LearningMethod, several: bool = False) -> LearningMethod:
    """Finds a method by its name.

    Args:
        method: the name; an object is given back as it is.
        several: whether there are several objects to learn.

    Raises:
        IdentificationError: there is no method of that name, or it is for one object alone.
    """
    named = LEARNING_METHODS.get(method) if isinstance(method, str) else (method,)
    if named is None:
        raise IdentificationError(
            f"method is {method!r}; expected one of {', '.join(METHOD_NAMES)}"
        )
    able = [one for one in named if one.abilities.takes_several or not several]
    refuse_several(IdentificationError, "method", not able)
    return able[0]
