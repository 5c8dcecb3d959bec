"""`ContactForceSensor`: the force of contacts on bodies of a plant, told with noise."""

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS

DEFAULT_PERIOD = 0.01
"""Time between two samples, s."""


class ContactForceSensor(LeafSystem):
    """Samples the sum of all contact forces on bodies of a MultibodyPlant that move together.

    .. pydrake_system::

        name: ContactForceSensor
        input_ports:
        - contact_results
        output_ports:
        - force

    * contact_results: abstract `ContactResults` of the plant.
    * force: vector of 3, force on the bodies in W, N, as last sampled, with noise and an offset.

    Discrete state: the force on the port, and the number of samples so far. The noise of the k-th
    sample depends only on k and the seed, which is numeric parameter 0; the offset, N, is numeric
    parameter 1.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        *bodies: BodyIndex,
        period: float = DEFAULT_PERIOD,
        noise: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Makes the sensor.

        Args:
            bodies: indices in the plant of a body, or of several, such as those of a gripper.
            period: time between two samples, s.
            noise: standard deviation of the noise per axis, N.
            seed: seed of the noise.
        """
        super().__init__()
        self._bodies = frozenset(bodies)
        self._noise = noise
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self._offset = self.DeclareNumericParameter(BasicVector(np.zeros(3)))
        self._results = self.DeclareAbstractInputPort("contact_results", Value(ContactResults()))
        self._felt = self.DeclareDiscreteState(3)
        self._count = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("force", self._felt)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)

    def SetOffset(self, root_context: Context, offset: np.ndarray) -> None:
        """Sets the offset (3,), N, in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(self._offset).SetFromVector(offset)

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        """Takes the next sample."""
        results: ContactResults = self._results.Eval(context)
        force = np.array(context.get_numeric_parameter(self._offset).value())
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            # The contact's force acts on body B.
            if info.bodyB_index() in self._bodies:
                force += info.contact_force()
            elif info.bodyA_index() in self._bodies:
                force -= info.contact_force()
        count = int(context.get_discrete_state(self._count).value()[0])
        seed = int(context.get_numeric_parameter(self._seed).value()[0])
        force += self._noise * np.random.default_rng((seed, count)).normal(size=3)
        state.set_value(self._felt, force)
        state.set_value(self._count, [count + 1])
