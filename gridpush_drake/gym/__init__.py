"""Pushing as reinforcement learning sees it: Gymnasium environments of the project's simulator.

Importing this package registers, for `gymnasium.make` and `gymnasium.make_vec`,

    gridpush/PushToGoal-v0    push an object of hidden masses to a goal pose
    gridpush/SlideToEdge-v0   push it over the table's edge so far that it can be grasped;
                              falling ends the episode
    gridpush/Explore-v0       poke it so that its motion under other pushes can be predicted
    gridpush/Rearrange-v0     push several objects, which push each other, to their goals
    gridpush/PushTHidden-v0   bring the T of PushT, with a hidden load, to a goal in four strokes
    gridpush/Follow-v0        push an object along a path, with a finger that is steered 10 times a
                              second

It needs `pip install '.[gym]'`.
"""

import lazy_loader

from gridpush_drake.gym.environments import register_environments

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

register_environments()
