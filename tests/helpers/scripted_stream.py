"""A tip that is moved piece by piece, an object that the LCP moves, and what a camera sees of both."""

from itertools import pairwise

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush
from gridpush_drake.pushes.segmentation import (
    RecordOptions,
    Sample,
    SegmenterOptions,
    SegmenterState,
    advance,
    make_observed_push,
)

PERIOD = 1 / 30
RADIUS = 0.008
HIGH, LOW = 0.12, 0.012
NOISE = np.array([5e-4, 5e-4, np.radians(0.2)])
SEGMENTER, RECORD = SegmenterOptions(), RecordOptions()


class Script:
    """A tip that is moved piece by piece, and what is seen of it and of the object every period."""

    def __init__(self, obj: GridObject, noise: np.ndarray = NOISE, start=(-0.2, 0.0, HIGH)) -> None:
        self.obj, self.params = obj, CellParameters.uniform(obj, 1.0, 0.4, 0.4)
        self.noise, self.rng = noise, np.random.default_rng(0)
        self.q, self.p, self.t = np.zeros(3), np.array(start), 0.0
        self.samples: list[Sample] = []
        self.truth: list[np.ndarray] = []
        self.wait(0.5)

    def _see(self, velocity=(0.0, 0.0, 0.0)) -> None:
        pose = self.q + self.noise * self.rng.normal(size=3)
        self.samples.append(Sample(self.t, tuple(pose), tuple(self.p), tuple(velocity)))
        self.truth.append(self.q.copy())
        self.t = len(self.samples) * PERIOD

    def wait(self, duration: float) -> "Script":
        for _ in range(round(duration / PERIOD)):
            self._see()
        return self

    def move(self, to, speed: float = 0.15) -> "Script":
        """Straight; where the tip is low it pushes."""
        to = np.array(to, dtype=float)
        steps = max(1, round(np.linalg.norm(to - self.p) / speed / PERIOD))
        way, velocity = np.linspace(self.p, to, steps + 1), (to - self.p) / (steps * PERIOD)
        for before, after in pairwise(way):
            self._see(velocity)
            if max(before[2], after[2]) < 0.03:
                push = Push(before[:2], velocity[:2], PERIOD, RADIUS)
                self.q = simulate(
                    Model(self.obj, self.params), push, self.q, regime="quasi_static"
                ).final_pose
            self.p = after
        return self

    def push(self, x: float, y: float = 0.0, speed: float = 0.03) -> "Script":
        return self.move((x, y, LOW), speed)

    def lift(self) -> "Script":
        return self.move((*self.p[:2], HIGH))

    def lower(self, x: float, y: float) -> "Script":
        return self.move((x, y, HIGH), 0.3).move((x, y, LOW))

    def blind(self, first: int, last: int) -> "Script":
        """Takes the poses of some samples away."""
        for i in range(first, last):
            self.samples[i] = self.samples[i]._replace(pose=(np.nan,) * 3)
        return self

    def segment(self, record: RecordOptions = RECORD) -> list[ObservedPush | None]:
        """What the segmenter finds, None for motions that are no pushes."""
        state, found = SegmenterState(), []
        for sample in self.samples:
            state, episode = advance(state, sample, SEGMENTER)
            if episode is not None:
                found.append(
                    make_observed_push(episode, self.obj, RADIUS, f"push_{len(found) + 1}", record)
                )
        return found

    def low(self, i: int) -> bool:
        """Whether the tip is down in sample i."""
        return self.samples[i].tip[2] < SEGMENTER.engaged_below


def poke_four_times(script: Script) -> Script:
    """Pushes of 10 cm from the left, each ending in contact."""
    for _ in range(4):
        x, y = script.q[:2].tolist()
        script.lower(x - 0.06, y + 0.01).wait(0.2).push(x + 0.04, y + 0.01).wait(0.3).lift().wait(
            1.0
        )
    return script
