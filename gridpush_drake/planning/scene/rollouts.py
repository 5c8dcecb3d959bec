"""Many pushes of one scene, simulated one after another or by several threads.

What the kernels know of the objects does not depend on where they lie. It is made once for a scene,
and used for pushes from any poses: searches ask for hundreds.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.step import STEP_CONVERGED
from gridpush_drake.dynamics.push import Push, make_path_times, measure_steps
from gridpush_drake.dynamics.scene.kernel_call import (
    make_bodies,
    make_pusher_path,
    make_scene_contacts,
    make_scene_state,
    run_scene_kernel,
)
from gridpush_drake.dynamics.scene.simulation import check_together
from gridpush_drake.geometry.se2 import Array

TIP_STEP = 0.003
"""Farthest that the pusher moves in a step of a search, m. Ends differ by about 0.1 mm from those
of steps of 1 mm."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """One simulated push.

    Attributes:
        poses: (T+1, N, 3) the objects, m and rad.
        traveled: (T+1,) length of the pusher's path so far, m.
        touched: whether the pusher touched an object.
        solved: whether every step was solved; where one was not, the end is not to be trusted.
    """

    poses: Array
    traveled: Array
    touched: bool
    solved: bool

    def interpolate(self, places: Array) -> tuple[Array, Array]:
        """Interpolates between steps.

        Args:
            places: (K,) numbers of steps, which need not be whole.

        Returns:
            The length (K,) of the pusher's path until then, m, and the poses (K, N, 3), m and rad.
        """
        low = np.floor(places).astype(int)
        high = np.minimum(low + 1, len(self.traveled) - 1)
        fraction = places - low
        traveled = (1.0 - fraction) * self.traveled[low] + fraction * self.traveled[high]
        part = fraction[:, None, None]
        return traveled, (1.0 - part) * self.poses[low] + part * self.poses[high]


class SceneRollouts:
    """Simulates pushes of the same objects from any poses.

    Attributes:
        bodies: the objects.
        simulations: number of pushes that were simulated.
    """

    def __init__(
        self,
        bodies: Bodies,
        *,
        tip_step: float = TIP_STEP,
        workers: int = 1,
    ) -> None:
        """Prepares what does not depend on poses.

        Args:
            bodies: the objects, and how they slide.
            tip_step: farthest that the pusher moves in a step, m.
            workers: number of threads; no result depends on it.
        """
        self.bodies = check_together(bodies)
        self.simulations = 0
        self._physics = self.bodies.physics
        self._bodies = make_bodies(self.bodies)
        self._tip_step = tip_step
        self._workers = workers
        self._no_derivatives = np.empty((0, len(bodies), 3, 0))

    def roll(self, push: Push, poses: Array) -> Rollout:
        """Simulates a push of the objects from poses (N, 3), m and rad."""
        self.simulations += 1
        return self._simulate(push, poses)

    def roll_all(self, pushes: Sequence[Push], poses: Array) -> list[Rollout]:
        """Simulates several pushes, each from the same poses (N, 3), m and rad."""
        self.simulations += len(pushes)
        if self._workers == 1:
            return [self._simulate(push, poses) for push in pushes]
        with ThreadPoolExecutor(self._workers) as pool:
            return list(pool.map(lambda push: self._simulate(push, poses), pushes))

    def _simulate(self, push: Push, poses: Array) -> Rollout:
        n = len(poses)
        regime = self._physics.regime
        times = make_path_times(push, regime, tip_step=self._tip_step)
        contacts = make_scene_contacts(n)
        steps = run_scene_kernel(
            self._bodies,
            self._physics,
            pusher=make_pusher_path(push, times),
            state=make_scene_state(poses),
            contacts=contacts,
            dts=measure_steps(push, times, regime),
            row_of_step=np.full(len(times), -1),
            J=self._no_derivatives,
        )
        with_pusher = steps.ids[:, :, 1] < 0
        solved = bool((steps.statuses[:, 0] == STEP_CONVERGED).all()) and contacts.lost[0] == 0
        return Rollout(
            poses=steps.poses,
            traveled=push.distance_at(times),
            touched=bool((steps.modes[with_pusher] != 0).any()),
            solved=solved,
        )


def roll_models(
    models: Sequence[SceneRollouts], push: Push, poses: Array, workers: int = 1
) -> Iterator[Rollout]:
    """Simulates one push from poses (N, 3) with several models, one after another or by threads.

    Args:
        models: the models.
        push: the push.
        poses: (N, 3) where the objects lie, m and rad.
        workers: number of threads; no result depends on it. With one, a model is simulated only
            when its rollout is asked for.

    Yields:
        Each model's rollout.
    """
    if workers == 1 or len(models) < 2:
        for model in models:
            yield model.roll(push, poses)
        return
    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(lambda model: model.roll(push, poses), models)
