"""Corrects a learned model while the finger is steered, by an ensemble filter.

A model that was learned from a few pokes is off most where it was not poked. An ensemble of models,
the estimate x and draws x_i from its posterior, is taken along: from one pose that was seen, each
of them predicts where the object is after it moved a little, y_i. What was seen there, y, corrects
them as an ensemble Kalman filter does (Evensen 1994; in the form of Sakov and Oke 2008, which needs
no random numbers):

    K = C_xy (C_yy + R)^-1        x <- x + K (y - y_0)        A <- A - K Y / 2

with the covariances C of the ensemble, A and Y the deviations of the x_i and y_i from their means,
and R the noise of poses and what no model explains. It takes a rollout of a few steps for each
model, some times a second. It is not for learning an object anew: every model is a combination of
those that were drawn. That is `identification`'s, from a `FollowLog`.

The theory is in `docs/theory/feedback.md`, section 8.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    X,
    follow_tip,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pushed_object import FeedbackFinger, SearchModel, make_model

LEAST_MASS = 1e-4
"""Least mass of a cell after a correction, as a fraction of the mean cell's."""

CONTACT_FRICTIONS = (0.02, 1.5)
"""Least and greatest friction of the finger against the outline after a correction."""


@dataclass(frozen=True)
class EnsembleOptions:
    """How models are corrected.

    Attributes:
        motion: motion of the object from one correction to the next, m; a turn is counted by the
            radius of gyration.
        longest: time after which a motion that is less tells nothing, s.
        position_std: standard deviation of a filtered position, per axis, m.
        angle_std: standard deviation of a filtered angle, rad.
        unexplained: fraction of the motion that no model of the ensemble explains.
        growth: factor by which the ensemble spreads with each correction, at most to the spread
            that it had first: so it never becomes too sure to be corrected.
    """

    motion: float = 0.008
    longest: float = 1.0
    position_std: float = 0.0005
    angle_std: float = 0.003
    unexplained: float = 0.05
    growth: float = 1.03

    def __post_init__(self) -> None:
        require_positive(
            PlanningError,
            "ensemble: ",
            "m",
            motion=self.motion,
            position_std=self.position_std,
        )
        require_positive(PlanningError, "ensemble: ", "rad", angle_std=self.angle_std)
        require_positive(PlanningError, "ensemble: ", "s", longest=self.longest)


class ModelEnsemble:
    """An estimate and draws of one object's parameters, which are corrected together.

    Attributes:
        options: how they are corrected.
        corrections: number of corrections so far.
    """

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        draws: Sequence[CellParameters],
        finger: FeedbackFinger,
        physics: Physics | None = None,
        options: EnsembleOptions | None = None,
    ) -> None:
        """Begins with nothing seen.

        Args:
            obj: the object.
            params: the estimate.
            draws: other models that may be the true one; with less than two nothing is corrected.
            finger: the finger.
            physics: physics of the models.
            options: how they are corrected.

        Raises:
            PlanningError: a model is of another object.
        """
        self.options = options or EnsembleOptions()
        self.corrections = 0
        self._obj = obj
        self._params = params
        self._finger = finger
        self._physics = physics
        self._estimate = _to_numbers(params)
        drawn = np.array([_to_numbers(each) for each in draws]).reshape(-1, len(self._estimate))
        self._deviations = drawn - drawn.mean(axis=0) if len(drawn) else drawn
        self._first_spread = float(np.linalg.norm(self._deviations))
        # What was drawn is used as it is, until something was seen.
        self.models = [self._make_model(each) for each in (params, *draws)]
        self.forget()

    def copy(self) -> "ModelEnsemble":
        """Makes a copy that goes on by itself; models are never changed, but replaced."""
        other = object.__new__(ModelEnsemble)
        other.__dict__.update(self.__dict__)
        other._tips = list(self._tips)
        return other

    def forget(self) -> None:
        """Forgets where the object was: it was shoved, or is seen for the first time."""
        self._begin = np.full(STATE_SIZE, np.nan)
        self._begun_at = -np.inf
        self._tips: list[Array] = []

    def add(self, time: float, pose: Array, tips: Array) -> bool:
        """Takes in a filtered pose (3,) of a time, s, and the finger's path (K, D) to there, m.

        Returns:
            Whether the models were corrected.
        """
        if len(self._deviations) < 2:
            return False
        if np.isfinite(self._begun_at):
            self._tips.extend(tips)
            motion = self._measure(pose - self._begin[X : THETA + 1])
            is_late = time - self._begun_at > self.options.longest
            if motion < self.options.motion and not is_late:
                return False
            corrects = motion >= self.options.motion
            if corrects:
                self._correct(pose, motion)
        else:
            corrects = False
        # from here on
        self._begin = np.zeros(STATE_SIZE)
        self._begin[X : THETA + 1] = pose
        self._begin[TIP_X : TIP_X + tips.shape[1]] = tips[-1]
        self._begun_at = time
        self._tips = []
        return corrects

    def _correct(self, pose: Array, motion: float) -> None:
        """Corrects all models by a pose (3,), m and rad, seen after the object moved so far, m."""
        options = self.options
        arm = self._obj.radius_of_gyration
        tips = np.array(self._tips)
        off = np.empty((len(self.models), 3))
        for off_row, model in zip(off, self.models, strict=True):
            state = self._begin.copy()
            follow_tip(model, state, tips)
            difference = pose - state[X : THETA + 1]
            off_row[:2] = difference[:2]
            off_row[2] = arm * wrap_angle(difference[2])
        # y_i - mean of y, as what was seen is the same for all
        Y = off[1:].mean(axis=0) - off[1:]
        A = self._deviations
        count = len(A) - 1
        turn_std = arm * options.angle_std
        noise = 2.0 * np.array([options.position_std, options.position_std, turn_std]) ** 2
        noise += (options.unexplained * motion) ** 2
        K = np.linalg.solve(Y.T @ Y / count + np.diag(noise), Y.T @ A / count).T
        self._estimate = self._estimate + K @ off[0]
        self._deviations = A - 0.5 * Y @ K.T
        spread = float(np.linalg.norm(self._deviations))
        if spread > 0.0:
            self._deviations *= min(options.growth, max(1.0, self._first_spread / spread))
        self._remake()
        self.corrections += 1

    def _remake(self) -> None:
        """Makes the models of the estimate and of the draws about it."""
        least = LEAST_MASS * float(self._params.mass.mean())
        self._estimate[:-1] = np.maximum(self._estimate[:-1], least)
        self._estimate[-1] = np.clip(self._estimate[-1], *CONTACT_FRICTIONS)
        self.models = []
        for numbers in (self._estimate, *(self._estimate + self._deviations)):
            params = replace(
                self._params,
                mass=np.maximum(numbers[:-1], least),
                contact_friction=float(np.clip(numbers[-1], *CONTACT_FRICTIONS)),
            )
            self.models.append(self._make_model(params))

    def _make_model(self, params: CellParameters) -> SearchModel:
        """Makes a model of parameters, as the compiled search takes it."""
        finger = self._finger
        return make_model(self._obj, params, finger.radius, self._physics, shape=finger.shape)

    def _measure(self, off: Array) -> float:
        """Size of a difference of poses (3,), m."""
        arm = self._obj.radius_of_gyration
        return float(np.hypot(np.hypot(off[0], off[1]), arm * wrap_angle(off[2])))


def _to_numbers(params: CellParameters) -> Array:
    """The numbers (n + 1,) that are corrected: masses, kg, and the contact friction."""
    return np.append(params.mass, params.contact_friction)
