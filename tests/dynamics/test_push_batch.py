from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.motion import Motion, MotionStatus
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics, Regime
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

OBJ = GridObject.from_outline(
    [[-0.05, -0.02], [0.05, -0.02], [0.05, 0.02], [-0.05, 0.03]], max_cells=24
)
TABLE = np.array([[-1.0, -1.0], [0.14, -1.0], [0.14, 1.0], [-1.0, 1.0]])
"""Its right edge is near some pushes and far from others."""


def make_pushes(regime: Regime, table: np.ndarray | None) -> list[BatchPush]:
    """Pushes at random, the last of which misses the object; of each a few poses, not in order of the steps."""
    rng = np.random.default_rng(4)
    pushes = []
    for i in range(6):
        pose = np.array([0.03 * i - 0.05, rng.uniform(-0.1, 0.1), rng.uniform(-3, 3)])
        push = Push.on_outline(
            OBJ, rng.uniform(0, 0.2), rng.uniform(-0.4, 0.4), 0.03, radius=0.004 + 0.001 * i, speed=0.02, pose=pose,
            clearance=0.2 if i == 5 else 0.0,
        )  # fmt: skip
        times = make_path_times(push, regime)
        rows = np.array([len(times) - 1, 0, 7 + i]) if i % 2 else np.array([len(times) - 1])
        pushes.append(BatchPush(push, pose, times, rows, table))
    return pushes


def simulate_one(params: CellParameters, one: BatchPush, regime: Regime) -> Motion:
    return simulate(
        Model(OBJ, params),
        one.push,
        one.pose,
        regime=regime,
        gradients="mass",
        times=one.times,
        record=one.rows,
        table=one.table,
    )


@pytest.mark.parametrize("table", [None, TABLE], ids=["endless", "edge"])
@pytest.mark.parametrize("height", [0.0, 0.01])
@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_a_batch_is_its_pushes_one_by_one_bit_for_bit(
    regime: Regime, height: float, table: np.ndarray | None
) -> None:
    params = replace(CellParameters.random(OBJ, seed=2), push_height=height)
    pushes = make_pushes(regime, table)
    batch = PushBatch(OBJ, pushes, Physics(regime=regime))
    motions = [simulate_one(params, one, regime) for one in pushes]
    for _ in range(2):  # nothing is left of the run before
        poses, touched = batch.simulate(params)
        both, J = batch.differentiate(params)
        assert np.array_equal(both, poses)
        for i, (one, motion) in enumerate(zip(pushes, motions, strict=True)):
            rows = slice(batch.offsets[i], batch.offsets[i + 1])
            assert np.array_equal(poses[rows], motion.poses[one.rows])
            named = motion.jacobian
            expected = np.concatenate(
                [named.mass, named.contact_friction[..., None], named.start, named.pose], axis=2
            )
            assert np.array_equal(J[rows], expected)
            assert touched[i] == (motion.status != MotionStatus.NO_CONTACT)
    assert touched.tolist() == [True] * 5 + [False]


@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_a_pose_may_be_wanted_twice(regime: Regime) -> None:
    params, pushes = CellParameters.random(OBJ, seed=2), make_pushes(regime, TABLE)
    poses, J = PushBatch(OBJ, pushes, Physics(regime=regime)).differentiate(params)
    twice = PushBatch(
        OBJ, [one._replace(rows=np.repeat(one.rows, 2)) for one in pushes], Physics(regime=regime)
    )
    again, J_again = twice.differentiate(params)
    assert np.array_equal(again, np.repeat(poses, 2, axis=0))
    assert np.array_equal(J_again, np.repeat(J, 2, axis=0))
    assert np.array_equal(twice.simulate(params)[0], again)


def test_no_pushes_are_no_poses() -> None:
    poses, J = PushBatch(OBJ, [], QUASI_STATIC).differentiate(CellParameters.uniform(OBJ))
    assert poses.shape == (0, 3)
    assert J.shape == (0, 3, OBJ.n + 6)


def test_an_object_beside_its_table_is_refused() -> None:
    (one,) = make_pushes("quasi_static", TABLE)[:1]
    with pytest.raises(SimulationError, match=r"no cell of .* is on it"):
        PushBatch(OBJ, [one._replace(pose=np.array([3.0, 0.0, 0.0]))], QUASI_STATIC)
