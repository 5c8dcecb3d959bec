"""A world of one block and the disc that pushes it, by the law itself: to try a controller in."""

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.bench.pusht.sliding_block import BlockEstimate, SlidingBlock
from gridpush_drake.dynamics.kernels.steering.driven_disc import (
    PX,
    STATE_SIZE,
    THETA,
    VX,
    X,
    advance,
)
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector, transform_shape


class DiscWorld:
    """A block, and the disc that pushes it.

    Attributes:
        block: what everybody knows of the block.
        truth: what nobody is told.
    """

    def __init__(
        self,
        block: SlidingBlock,
        truth: BlockEstimate,
        disc: ArrayLike,
        pose: ArrayLike,
    ) -> None:
        """Puts the disc, at rest, and the block down.

        Args:
            block: what everybody knows of the block.
            truth: where its center of friction really is, and its arm.
            disc: (2,) position of the disc.
            pose: (3,) pose of the block.

        Raises:
            PlanningError: a position or a pose is not as many finite numbers.
        """
        self.block = block
        self.truth = truth
        self._record = block.make_record(truth)
        self._state = np.zeros(STATE_SIZE)
        self._state[PX : PX + 2] = check_vector(PlanningError, "disc", disc, 2)
        self.put(pose)

    @property
    def disc(self) -> Array:
        """(2,) position of the disc."""
        return self._state[PX : PX + 2].copy()

    @property
    def velocity(self) -> Array:
        """(2,) velocity of the disc."""
        return self._state[VX : VX + 2].copy()

    @property
    def pose(self) -> Array:
        """(3,) pose of the block."""
        return self._state[X : THETA + 1].copy()

    def put(self, pose: ArrayLike) -> None:
        """Puts the block down elsewhere, at a pose (3,).

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        self._state[X : THETA + 1] = check_vector(PlanningError, "pose", pose, 3)

    def step(self, target: ArrayLike) -> bool:
        """Lets the disc follow a target (2,) for one decision's time. Returns whether it touched.

        Raises:
            PlanningError: the target is not two finite numbers.
        """
        wanted = check_vector(PlanningError, "target", target, 2)
        return bool(advance(self._record, self._state, wanted) > 0)

    def calc_coverage(self, goal: ArrayLike) -> float:
        """Calculates the fraction of a goal (3,) that the block covers."""
        there = transform_shape(goal, self.block.outline)
        here = transform_shape(self.pose, self.block.outline)
        return float(there.intersection(here).area / there.area)
