"""Simulated worlds in which the object's load is changed between two pushes."""

from collections.abc import Mapping
from types import MappingProxyType

from gridpush_drake.bench.pregrasp.world import EdgeWorld
from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.world import SimulatedWorld, WorldMotion


class ChangesLoad:
    """A world whose object has other masses from some push on.

    Attributes:
        changes: the masses and frictions that the object gets, by the number of pushes made before.
    """

    changes: Mapping[int, CellParameters] = MappingProxyType({})

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the object as it is by then."""
        self.bodies = self.bodies.with_params(self.changes.get(self.pushes, self.bodies.params))
        return super().do_push(push, pose)


class ChangingWorld(ChangesLoad, SimulatedWorld):
    """The LCP world on a table without end."""


class ChangingEdgeWorld(ChangesLoad, EdgeWorld):
    """The LCP world with an edge, at which loads shift."""
