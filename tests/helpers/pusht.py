"""A T that a driven disc pushes, and its world, without gym-pusht."""

from gridpush_drake.bench.pusht import BlockEstimate, DiscWorld, FeedbackController
from gridpush_drake.bench.pusht.experiments import GOAL, make_block

TRUE = BlockEstimate(center_x=12.0, center_y=30.0, arm=50.0)
"""A T whose load is uneven."""


def make_world(disc, pose, truth=TRUE):
    return DiscWorld(make_block(), truth, disc, pose)


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
        coverages.append(world.calc_coverage(GOAL))
        if coverages[-1] > controller.options.success:
            break
    return decisions, coverages
