"""`TrueParameters`: keeps the true masses and frictions of a simulated object in the Context."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.parameters import CellParameters


class TrueParameters(LeafSystem):
    """Remembers the hidden truth of a run, with which its results are judged.

    .. pydrake_system::

        name: TrueParameters

    It has no ports. The plant does not serve for this: it knows the truth as an inertia and as
    contact properties, from which the cells' masses cannot be read back.

    Abstract parameter: one `CellParameters`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, params: CellParameters) -> None:
        """Declares the parameter, with the value that it has in a fresh Context."""
        super().__init__()
        self._params = self.DeclareAbstractParameter(AbstractValue.Make(params))

    def SetParameters(self, root_context: Context, params: CellParameters) -> None:
        """Sets the truth in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_abstract_parameter(int(self._params)).set_value(params)

    def GetParameters(self, root_context: Context) -> CellParameters:
        """Returns the truth in a Diagram's Context."""
        context = self.GetMyContextFromRoot(root_context)
        params: CellParameters = context.get_abstract_parameter(int(self._params)).get_value()
        return params
