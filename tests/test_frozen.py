import copy
import pickle
from dataclasses import fields

import numpy as np
import pytest

from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

OBJ = GridObject.from_outline([[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05]], max_cells=8)
PUSH = Push.on_outline(OBJ, 0.02, 0.1, 0.03, radius=0.005, speed=0.02)
SEEN = ObservedPush(
    "a", PUSH, np.zeros(3), [PUSH.duration], np.ones((1, 3)), [0.0], np.zeros((1, 2))
)
RECORDS = [
    OBJ,
    OBJ.edges,
    CellParameters.uniform(OBJ, 0.5),
    PUSH,
    ForcePush([0.0, 0.0], [1.0, 0.0], 1.0),
    SEEN,
    PushLog((SEEN,), table=[[0, 0], [1, 0], [1, 1]]),
    Camera(640, 480, np.diag([600.0, 600.0, 1.0]), np.zeros(0), np.eye(4)),
]


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: type(record).__name__)
@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda record: pickle.loads(pickle.dumps(record))]
)
def test_copies_are_as_frozen_and_equal(record, copied):
    other = copied(record)
    arrays = [
        field.name
        for field in fields(record)
        if isinstance(getattr(record, field.name), np.ndarray)
    ]
    assert arrays
    for name in arrays:
        np.testing.assert_array_equal(getattr(other, name), getattr(record, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(other, name)[...] = 0


def test_a_log_holds_frozen_pushes():
    for log in (copy.deepcopy(RECORDS[6]), pickle.loads(pickle.dumps(RECORDS[6]))):
        assert not (log[0].pose.flags.writeable or log[0].push.xy.flags.writeable)
