"""What a planner of pre-grasps is asked, and what it answers.

It is asked by `PreGraspOptions`, and answers by `PreGraspDecision`.

The decisions are made in `planner`.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.exploration.designed_pokes import PokeOptions
from gridpush_drake.planning.pregrasp.goals import GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.units import MM_PER_M

Action = Literal["poke", "slide", "weigh", "grasp", "fail"]


@dataclass(frozen=True)
class PreGraspOptions:
    """How far to go, and how carefully.

    Attributes:
        gripper: the gripper.
        pad_force: force with which both its jaws press on an object that they take from the side,
            N. If it is given, an object that is narrow nowhere is taken by its rim, as far as the
            pads hold it; and a heavy object only by a narrow part near its center of mass. If it is
            None, only narrow parts are taken, however heavy the object is.
        goal: how goals are sought, and what counts as safe.
        slide: how pushes of the slide are chosen.
        poke: what pokes may be chosen from.
        min_pokes: number of pokes made first, as long as one keeps the object on the table, unless
            it can be grasped where it lies.
        max_pokes: number of pokes made before giving up.
        max_slides: number of slides made before giving up.
        poke_margin: how far inside the edge pokes keep every cell, m.
        max_arm: farthest that a narrow part may be from where the center of mass is estimated, m:
            held farther off, the object would turn in the gripper. It is less where the pads would
            not hold the object's weight so far off.
    """

    gripper: Gripper = field(default_factory=Gripper)
    pad_force: float | None = None
    goal: GoalOptions = field(default_factory=GoalOptions)
    slide: SlideOptions = field(default_factory=SlideOptions)
    poke: PokeOptions = field(default_factory=PokeOptions)
    min_pokes: int = 3
    max_pokes: int = 15
    max_slides: int = 30
    poke_margin: float = 0.02
    max_arm: float = np.inf


@dataclass(frozen=True)
class PokeForecast:
    """What a poke is expected to bring, said before it is made.

    Attributes:
        across_edge: True if the poke is about how far the center of mass can be across the table's
            edge; False if it is about the center of mass in the direction in which it is known
            least.
        std: standard deviation of that quantity before the poke, m.
        expected_std: standard deviation expected after the poke, m: about half of all pokes leave
            less, see `poke_forecast`.
    """

    across_edge: bool
    std: float
    expected_std: float

    def describe(self) -> str:
        """The forecast in words."""
        what = "how far the center can be across the edge" if self.across_edge else "the center"
        now, expected = (f"{std * MM_PER_M:.1f} mm" for std in (self.std, self.expected_std))
        if self.expected_std < self.std:
            return (
                f"this poke is expected to bring the standard deviation of {what} "
                f"from {now} to {expected}"
            )
        return (
            f"the standard deviation of {what} is {now}, and may be {expected} after this poke, "
            "as the poke may show that another kind of object explains the pushes better"
        )

    def describe_outcome(self, after: "PokeForecast") -> str:
        """What came of the poke, in a sentence.

        Args:
            after: the forecast of the next poke.

        Returns:
            The sentence; empty if `after` is about another quantity, or all came as expected.
        """
        if after.across_edge != self.across_edge:
            return ""
        expected = f"{self.expected_std * MM_PER_M:.1f} mm"
        came = f"{after.std * MM_PER_M:.1f} mm"
        if came == expected:
            return ""
        return (
            f" The poke before was expected to leave {expected} and left {came}: what to expect is "
            "computed from the estimate before the poke, and that has changed."
        )


@dataclass(frozen=True, eq=False)
class PreGraspDecision:
    """What to do next.

    Attributes:
        action: "poke" and "slide" are pushes to make; "weigh" is a press at the table's edge, which
            only a `TiltTestPlanner` asks for; "grasp" and "fail" end the task.
        reason: why, in half a sentence.
        goal: the goal that the slide goes to; the present pose, if the object can be grasped where
            it lies; the best goal that there is, even if it is not safe, before a poke or a
            failure. None where there is none.
        push: the push to make; None at the end.
        expected_pose: (3,) pose in which a slide is predicted to leave the object, X_WB, m and rad;
            None otherwise.
        forecast: what a poke is expected to bring; None otherwise.
        press: where to press to weigh the object; None otherwise.
    """

    action: Action
    reason: str
    goal: PreGraspGoal | None = None
    push: Push | None = None
    expected_pose: Array | None = None
    forecast: PokeForecast | None = None
    press: PressTarget | None = None

    @property
    def margin(self) -> float:
        """Stability margin of the goal at the worst, m; NaN without a goal."""
        return np.nan if self.goal is None else self.goal.margin
