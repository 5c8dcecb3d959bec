"""What is said beside a recording, and from when on."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.task import OBSERVATION_PERIOD, TaskStep
from gridpush_drake.station.tasks.task_kind import BEFORE_LOOKING
from gridpush_drake.systems.base.messages import (
    ContactPointMode,
    ContactPointStatus,
    PreGraspMode,
    PreGraspStatus,
    PushPhase,
    PushStatus,
)

NOWHERE = np.full(3, np.nan)


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [
        (
            "pregrasp",
            PreGraspStatus(),
            PreGraspStatus(PreGraspMode.EXPLORING, "It tells most.", pokes=1),
        ),
        (
            "push",
            ContactPointStatus(),
            ContactPointStatus(ContactPointMode.PUSHING, "It brings it nearest."),
        ),
    ],
)
def test_a_push_is_named_before_it_is_drawn(name, first, second):
    """A step is noted up to OBSERVATION_PERIOD after it was taken, and its prediction drawn meanwhile."""
    steps = [TaskStep(0.1, first, NOWHERE), TaskStep(0.4, second, NOWHERE)]
    looking, push = TASK_KINDS[name].list_phases(SimpleNamespace(steps=steps))
    assert (looking.time, looking.detail) == (0.0, BEFORE_LOOKING)
    assert push.time == pytest.approx(0.4 - OBSERVATION_PERIOD)
    assert push.detail == second.reason


def test_pushes_to_learn_from_are_named_likewise():
    pushing = PushStatus(phase=PushPhase.APPROACHING, command_id=1)
    record = SimpleNamespace(phases=[(0.1, PushStatus()), (0.4, pushing)], training=2)
    looking, push = TASK_KINDS["identify"].list_phases(record)
    assert (looking.time, looking.detail) == (0.0, BEFORE_LOOKING)
    assert (push.time, push.title) == (
        pytest.approx(0.4 - OBSERVATION_PERIOD),
        "Push 1: approaching",
    )
