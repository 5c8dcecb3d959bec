"""A T that a driven disc pushes, and its world, without gym-pusht."""

import numpy as np

from gridpush_drake.bench.pusht import GOAL, make_block
from gridpush_drake.dynamics.kernels.driven_disc import PX, STATE, THETA, VX, X, advance
from gridpush_drake.planning.feedback.feedback_controller import FeedbackController
from gridpush_drake.planning.feedback.sliding_block import BlockEstimate
from gridpush_drake.planning.feedback.stroke_search import calc_coverage

TRUE = BlockEstimate(center_x=12.0, center_y=30.0, arm=50.0)
"""A T whose load is uneven."""


class DiscWorld:
    """The law itself as a world: a T with its own friction, and the disc."""

    def __init__(self, disc, pose, estimate=TRUE):
        self.record = make_block().make_record(estimate)
        self.state = np.zeros(STATE)
        self.state[PX : PX + 2] = disc
        self.state[X : THETA + 1] = pose

    @property
    def disc(self):
        return self.state[PX : PX + 2].copy()

    @property
    def velocity(self):
        return self.state[VX : VX + 2].copy()

    @property
    def pose(self):
        return self.state[X : THETA + 1].copy()

    def step(self, target):
        return advance(self.record, self.state, np.asarray(target, dtype=np.float64))


def make_controller(**options):
    return FeedbackController(make_block(), GOAL, **options)


def play(world, controller, steps=80):
    """Plays until the goal is covered; returns the decisions, and the coverages after them."""
    decisions = []
    coverages = []
    for _ in range(steps):
        decision = controller.decide(world.disc, world.pose)
        world.step(decision.target)
        decisions.append(decision)
        task = controller._make_task()
        coverages.append(float(calc_coverage(world.record, task, world.pose)))
        if coverages[-1] > controller.options.success:
            break
    return decisions, coverages
