"""`TrueParameters`: what the object of a simulation really weighs and how it rubs, as part of the Context."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.parameters import CellParameters


class TrueParameters(LeafSystem):
    """Remembers the hidden truth of a run, for judgment; it has no ports.

    .. pydrake_system::

        name: TrueParameters

    A plant knows the truth as an inertia and as contact properties, from which the cells' masses
    cannot be read back.

    Abstract parameter: one `CellParameters`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, params: CellParameters) -> None:
        """Declares the parameter, with its default."""
        super().__init__()
        self._params = self.DeclareAbstractParameter(AbstractValue.Make(params))

    def SetParameters(self, root_context: Context, params: CellParameters) -> None:
        """Sets the truth in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_abstract_parameter(int(self._params)).set_value(params)

    def GetParameters(self, root_context: Context) -> CellParameters:
        """The truth in a Diagram's Context."""
        context = self.GetMyContextFromRoot(root_context)
        params: CellParameters = context.get_abstract_parameter(int(self._params)).get_value()
        return params
