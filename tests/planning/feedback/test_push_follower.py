"""A learned object is pushed with feedback: along paths, to goals, and where it cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from shapely import Point, box, get_coordinates, unary_union

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    X,
    follow_tip,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform, transform_shape, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback import (
    FollowOptions,
    FollowStatus,
    PosePath,
    PoseSensorModel,
    PushFollower,
    SteeredFinger,
    follow,
)
from gridpush_drake.planning.feedback.follow_log import SeenPose
from gridpush_drake.planning.feedback.follow_options import AT_GOAL
from gridpush_drake.planning.feedback.pose_path import PathProgress
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger, make_model, make_room
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
FINGER = FeedbackFinger(radius=0.01)
FEW = FollowOptions(strokes=40, changes=60, refinements=2, draws=0)
BLIND = PoseSensorModel(delay=0.15, missing=0.2)
TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
GOAL = np.array([0.12, 0.08, 0.6])
BESIDE = np.array([-0.15, 0.0])


def make_finger(pose=(0.0, 0.0, 0.0), tip=BESIDE, sight=BLIND, seed=0):
    world = SimulatedWorld(Model(OBJ, TRUTH), pose)
    return SteeredFinger(world, tip, FINGER.radius, sight, seed)


def make_follower(goal, params=TRUTH, options=FEW, **more):
    return PushFollower(OBJ, params, goal, FINGER, options=options, **more)


def make_arc(speed=0.05):
    """An S along which the block is pushed by its short side, from where it lies."""
    s = np.linspace(0.0, 0.3, 40)
    center = OBJ.p_BC.mean(axis=0)
    points = center + np.column_stack([s, 0.02 * (1 - np.cos(2 * np.pi * s / 0.3))])
    return PosePath.through(OBJ, points, speed)


def measure(pose, goal):
    """Distance of the centroids, mm, and the turn, degrees."""
    middle = OBJ.p_BC.mean(axis=0)[None]
    off = transform(np.asarray(pose), middle) - transform(np.asarray(goal), middle)
    return 1e3 * np.linalg.norm(off), abs(np.degrees(wrap_angle(pose[2] - goal[2])))


def test_the_search_moves_the_object_as_simulate_does():
    tips = np.array([[-0.08, 0.004], [-0.055, 0.004], [-0.04, 0.006], [-0.03, 0.014]])
    push = Push.along(np.arange(4.0), tips, FINGER.radius)
    expected = simulate(Model(OBJ, TRUTH, Physics(regime="quasi_static")), push).final_pose
    state = np.zeros(STATE_SIZE)
    state[TIP_X : TIP_X + 2] = tips[0]
    follow_tip(make_model(OBJ, TRUTH, FINGER.radius), state, tips[1:])
    assert np.abs(expected).max() > 0.01
    assert state[X : THETA + 1] == pytest.approx(expected, abs=2e-4)


def test_the_world_is_simulated_exactly_and_the_search_approximately():
    searched = make_follower(GOAL).model.scheme
    finger = make_finger()
    finger.move((0.0, 0.1))
    (model,) = finger.world._models.values()
    steered = model.scheme
    assert steered.early_end == 0.0
    assert searched.early_end > 0.0
    assert searched._replace(early_end=0.0) == steered


def test_a_finger_that_passes_by_moves_nothing():
    steered = make_finger()
    start = steered.pose
    for _ in range(20):
        steered.move((0.0, 0.2))
    assert (steered.pose == start).all()


def test_a_late_pose_is_carried_on_to_now():
    sight = PoseSensorModel(delay=0.15, missing=0.3, position_std=0.0, angle_std=0.0)
    steered = make_finger(sight=sight, tip=(-0.07, 0.0))
    follower = make_follower(GOAL)
    follower.add_tip(steered.time, steered.tip)
    late = steered.pose
    for _ in range(40):
        for seen in steered.move((0.08, 0.0)):
            follower.add_pose(seen.time, seen.pose)
            late = seen.pose
        follower.add_tip(steered.time, steered.tip)
    now = follower.track.predict(follower.model)[X : THETA + 1]
    assert abs(late - steered.pose).max() > 0.008
    assert now == pytest.approx(steered.pose, abs=3e-4)


def test_follows_a_path_though_poses_are_late_and_missing():
    path = make_arc()
    steered = make_finger(tip=(-0.07, 0.0))
    run = follow(make_follower(path), steered)
    way = PathProgress(OBJ, path)
    off = way.measure_distance(transform(run.poses, OBJ.p_BC.mean(axis=0)[None])[:, 0])
    assert run.status == FollowStatus.REACHED
    assert np.sqrt((off**2).mean()) < 2e-3
    assert max(measure(steered.pose, path.goal)) < 2.0
    # not faster than it should go, and not much slower
    assert run.time > way.length / path.speed


def test_goes_round_to_the_goal_and_back_to_it_after_a_shove():
    steered = make_finger(tip=(0.15, 0.05))
    follower = make_follower(GOAL)
    run = follow(follower, steered)
    assert run.status == FollowStatus.REACHED
    distance, turn = measure(steered.pose, GOAL)
    assert distance < 2.0
    assert turn < 1.0
    steered.world.put(steered.pose + [0.02, -0.022, np.radians(20)])
    # it is seen, and no longer counts as reached
    for _ in range(20):
        for seen in steered.move((0.0, 0.0)):
            follower.add_pose(seen.time, seen.pose)
        follower.add_tip(steered.time, steered.tip)
    run = follow(follower, steered)
    assert run.status == FollowStatus.REACHED
    assert run.time > 0.5
    distance, turn = measure(steered.pose, GOAL)
    assert distance < 2.0
    assert turn < 1.0


def test_follows_a_goal_that_moves():
    steered = make_finger(sight=PoseSensorModel(delay=0.1))
    follower = make_follower(GOAL, constraints=PushConstraints(TABLE))
    room = follower._room
    follower.add_tip(steered.time, steered.tip)
    end = GOAL + [0.06, 0.02, 0.3]
    for k in range(300):
        goal = GOAL + min(k / 60, 1.0) * (end - GOAL)
        follower.set_goal(goal)
        decision = follower.decide(steered.time, steered.tip)
        for _ in range(5):
            for seen in steered.move(decision.velocity):
                follower.add_pose(seen.time, seen.pose)
            follower.add_tip(steered.time, steered.tip)
        distance, turn = measure(steered.pose, end)
        if k > 60 and distance < 2.0 and turn < 1.0:
            break
    assert distance < 2.0
    assert turn < 1.0
    # where the object may be was worked out once
    assert follower._room is room


def test_object_and_finger_keep_clear_of_an_obstacle():
    free = follow(make_follower(GOAL), make_finger())
    swept = unary_union([transform_shape(pose, OBJ.outline) for pose in free.poses])
    for end in (np.zeros(3), GOAL):
        swept = swept.difference(transform_shape(end, OBJ.outline).buffer(0.015))
    # something that the object would run into on its way
    x, y = max(get_coordinates(swept), key=lambda at: at[0] - at[1])
    obstacle = box(x - 0.004, y - 0.03, x + 0.03, y + 0.004)
    rules = PushConstraints(obstacles=(obstacle,))
    run = follow(make_follower(GOAL, constraints=rules), make_finger())
    assert run.status == FollowStatus.REACHED
    for pose in run.poses:
        assert transform_shape(pose, OBJ.outline).distance(obstacle) > 0.0
    assert min(obstacle.distance(Point(tip)) for tip in run.tips) > FINGER.radius


def test_a_copy_goes_on_alike_and_leaves_the_first_alone():
    steered = make_finger()
    follower = make_follower(GOAL)
    follower.add_tip(0.0, steered.tip)
    follower.add_pose(0.0, steered.pose)
    follower.decide(0.0, steered.tip)
    other = follower.copy()
    ahead = [other.decide(0.1 * k, steered.tip).velocity for k in range(1, 4)]
    again = [follower.decide(0.1 * k, steered.tip).velocity for k in range(1, 4)]
    assert np.array_equal(ahead, again)
    assert np.abs(ahead).max() > 0


def test_rests_while_no_pose_comes_and_goes_on_with_the_next():
    steered = make_finger()
    follower = make_follower(GOAL)
    decision = follower.decide(0.0, steered.tip)
    assert (decision.status, *decision.velocity) == (FollowStatus.NO_POSE, 0.0, 0.0)
    assert "No pose" in decision.reason
    follower.add_pose(0.0, (np.nan, 0.0, 0.0))
    assert follower.decide(0.1, steered.tip).status == FollowStatus.NO_POSE
    follower.add_pose(0.1, steered.pose)
    assert follower.decide(0.2, steered.tip).status == FollowStatus.PUSHING
    assert follower.decide(0.9, steered.tip).status == FollowStatus.NO_POSE


@pytest.mark.parametrize("motion", [[0.01, 0.0, 0.05], [0.004, 0.0, 0.02]])
def test_rests_while_somebody_carries_the_object_away(motion):
    steered = make_finger()
    follower = make_follower(GOAL)
    status = FollowStatus.PUSHING
    for k in range(60):
        time = 0.1 * k
        follower.add_tip(time, steered.tip)
        # somebody carries it away, which no finger does
        follower.add_pose(time, steered.pose + k * np.array(motion))
        status = follower.decide(time, steered.tip).status
        if status != FollowStatus.PUSHING:
            break
    assert status == FollowStatus.DISTURBED
    assert follower.decide(time + 0.1, steered.tip).velocity.tolist() == [0.0, 0.0]


class MisseenFinger(SteeredFinger):
    """A finger whose object is seen where it is not.

    A lie takes the true pose, the first one that was seen, the number of the pose and a generator.
    """

    def __init__(self, lie, seed):
        self._lie = lie
        self._first = None
        self._count = 0
        self._lies = np.random.default_rng((seed, 1))
        world = SimulatedWorld(Model(OBJ, TRUTH), np.zeros(3))
        super().__init__(world, BESIDE, FINGER.radius, BLIND, seed)

    def _look(self):
        known = len(self._coming)
        super()._look()
        if len(self._coming) > known:
            seen = self._coming.pop()
            self._first = seen.pose if self._first is None else self._first
            self._count += 1
            pose = self._lie(seen.pose, self._first, self._count, self._lies)
            self._coming.append(SeenPose(seen.time, np.asarray(pose)))


def freeze(pose, first, count, rng):
    return first


def shift(pose, first, count, rng):
    return pose + [0.1, 0.0, 0.0]


def hold(pose, first, count, rng):
    return first + rng.normal(size=3) * [5e-4, 5e-4, 3e-3]


def jump(pose, first, count, rng):
    return pose + rng.uniform(-1, 1, 3) * [0.1, 0.1, 1.0]


def mistake(pose, first, count, rng):
    return pose if count % 2 else [0.3, -0.2, 1.0]


@pytest.mark.parametrize(
    ("lie", "goal", "statuses"),
    [
        (freeze, GOAL, {FollowStatus.UNLIKE_MODEL}),
        (shift, GOAL, {FollowStatus.DISTURBED, FollowStatus.UNLIKE_MODEL}),
        (shift, make_arc(), {FollowStatus.DISTURBED, FollowStatus.UNLIKE_MODEL}),
        (hold, GOAL, {FollowStatus.UNLIKE_MODEL}),
        (jump, GOAL, {FollowStatus.DISTURBED, FollowStatus.STUCK}),
        (mistake, GOAL, {FollowStatus.REACHED}),
    ],
)
def test_comes_to_rest_for_good_though_poses_stay_wrong(lie, goal, statuses):
    """Nobody ends the run: the controller is asked for 30 s, as in a Diagram."""
    steered = MisseenFinger(lie, seed=0)
    follower = make_follower(goal)
    follower.add_tip(0.0, steered.tip)
    way = 0.0
    for k in range(300):
        decision = follower.decide(steered.time, steered.tip)
        way += 0.1 * float(np.hypot(*decision.velocity))
        if k >= 200:
            assert decision.status in statuses
            assert decision.reason
            assert not decision.velocity.any()
        for _ in range(5):
            for seen in steered.move(decision.velocity):
                follower.add_pose(seen.time, seen.pose)
            follower.add_tip(steered.time, steered.tip)
    assert way < 1.0


def test_reaches_the_goal_though_the_object_is_disturbed_three_times():
    steered = make_finger(tip=(0.15, 0.05))
    follower = make_follower(GOAL)
    follower.add_tip(0.0, steered.tip)
    rng = np.random.default_rng(0)
    for k in range(300):
        if k in (10, 25, 40):
            steered.world.put(steered.pose + rng.uniform(-1, 1, 3) * [0.03, 0.03, 0.35])
        decision = follower.decide(steered.time, steered.tip)
        if decision.status == FollowStatus.REACHED and k > 40:
            break
        for _ in range(5):
            for seen in steered.move(decision.velocity):
                follower.add_pose(seen.time, seen.pose)
            follower.add_tip(steered.time, steered.tip)
    assert decision.status == FollowStatus.REACHED
    assert max(measure(steered.pose, GOAL)) < 2.0


def test_rests_while_the_finger_is_not_known_and_while_the_goal_is_no_place():
    steered = make_finger()
    follower = make_follower(GOAL)
    follower.add_tip(0.0, steered.tip)
    follower.add_pose(0.0, steered.pose)
    for tip in ((np.nan, 0.0), (1e300, 0.0)):
        follower.add_tip(0.05, tip)
        decision = follower.decide(0.1, tip)
        assert (decision.status, *decision.velocity) == (FollowStatus.NO_FINGER, 0.0, 0.0)
        assert "finger" in decision.reason
    follower.add_pose(0.1, (1e300, 0.0, 0.0))
    follower.set_goal((1e300, 0.0, 0.0))
    decision = follower.decide(0.2, steered.tip)
    assert (decision.status, *decision.velocity) == (FollowStatus.GOAL_TOO_FAR, 0.0, 0.0)
    follower.set_goal(GOAL)
    assert follower.decide(0.3, steered.tip).status == FollowStatus.PUSHING


def test_says_why_the_finger_rests_at_the_goal():
    steered = make_finger(pose=GOAL)
    follower = make_follower(GOAL)
    follower.add_tip(0.0, steered.tip)
    follower.add_pose(0.0, GOAL)
    decision = follower.decide(0.1, steered.tip)
    assert (decision.status, decision.reason) == (FollowStatus.PUSHING, AT_GOAL)
    assert not decision.velocity.any()


@pytest.mark.parametrize(
    ("goal", "rules", "status"),
    [
        (np.array([0.6, 0.0, 0.0]), PushConstraints(TABLE), FollowStatus.GOAL_OFF_TABLE),
        (GOAL, PushConstraints(obstacles=(box(0.1, 0.1, 0.2, 0.2),)), FollowStatus.GOAL_BLOCKED),
        (
            make_arc(),
            PushConstraints(obstacles=(box(0.12, -0.1, 0.16, 0.1),)),
            FollowStatus.PATH_BLOCKED,
        ),
        (make_arc(speed=0.3), PushConstraints(), FollowStatus.TOO_FAST),
    ],
)
def test_says_why_a_goal_or_path_cannot_be_followed(goal, rules, status):
    follower = make_follower(goal, constraints=rules)
    follower.add_tip(0.0, BESIDE)
    follower.add_pose(0.0, np.zeros(3))
    decision = follower.decide(0.0, BESIDE)
    assert decision.status == status
    assert decision.reason.endswith(".")
    assert decision.velocity.tolist() == [0.0, 0.0]


def test_the_fields_tell_how_far_points_may_move():
    obstacle = box(0.2, 0.2, 0.3, 0.3)
    rules = PushConstraints(TABLE, (obstacle,), obstacle_margin=0.01, edge_margin=0.02)
    room = make_room(OBJ, rules, FINGER, np.zeros((1, 2)))
    for x, y in ((0.0, 0.0), (0.25, 0.1), (0.45, -0.2)):
        i, j = np.rint((np.array([x, y]) - room.low) / room.spacing).astype(int)
        node = room.low + room.spacing * np.array([i, j])
        edge = 0.5 - np.abs(node).max()
        away = obstacle.distance(box(*node, *node))
        assert room.object_field[i, j] == pytest.approx(min(edge - 0.02, away - 0.01))
        assert room.finger_field[i, j] == pytest.approx(min(edge, away - 0.01 - FINGER.radius))


def test_refuses_what_makes_no_sense():
    with pytest.raises(PlanningError, match="model: has 3 cells; expected"):
        make_follower(GOAL, params=CellParameters(np.ones(3), np.ones(3)))
    with pytest.raises(PlanningError, match="goal"):
        make_follower((0.0, np.nan, 0.0))
    with pytest.raises(PlanningError, match="horizon is 0"):
        replace(FEW, horizon=0)
    with pytest.raises(PlanningError, match="finger: radius"):
        FeedbackFinger(radius=0.0)
    with pytest.raises(PlanningError, match="missing is 2"):
        PoseSensorModel(missing=2)
    for poses in ([[0.0, 0.0, 0.0]], np.zeros((3, 3)), [[0.0, np.inf, 0.0], [1.0, 0.0, 0.0]]):
        with pytest.raises(PlanningError, match="path: "):
            PosePath(poses, 0.05)
    with pytest.raises(PlanningError, match="speed"):
        PosePath([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 0.0)
    with pytest.raises(PlanningError, match="no two in a row"):
        PosePath.through(OBJ, [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]], 0.05)


def test_a_way_is_measured_by_the_centroid_and_found_again():
    path = make_arc()
    way = PathProgress(OBJ, path)
    place = way.at(0.1)
    assert way.project(place[:2], float(place[2]), 0.09) == pytest.approx(0.1, abs=2e-3)
    assert np.linalg.norm(way.along(0.1)) == pytest.approx(1.0)
    assert way.measure_distance(place[None, :2]) == pytest.approx(0.0, abs=1e-4)
    # a turn on the spot is as long as the way of the radius of gyration
    middle = OBJ.p_BC.mean(axis=0)
    turned = transform(np.array([0.0, 0.0, 1.0]), middle[None])[0]
    turn = PosePath([[0.0, 0.0, 0.0], [*(middle - turned), 1.0]], 0.05)
    assert PathProgress(OBJ, turn).length == pytest.approx(OBJ.radius_of_gyration)
