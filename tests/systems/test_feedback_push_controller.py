"""Pushing with feedback in a Diagram: late poses in, velocities out, the grid LCP in between."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, Integrator

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback import FollowOptions, FollowStatus, PosePath
from gridpush_drake.planning.feedback.pose_path import PathProgress
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.systems import FeedbackPushController, GridLcpSystem
from tests.helpers.made_identifications import make_block, make_identification

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
FINGER = FeedbackFinger(radius=0.01, speed=0.1, walking_speed=0.2)
OPTIONS = FollowOptions(strokes=40, changes=60, draws=0)
GOAL = (0.12, 0.08, 0.6)
DELAY = 0.12


class LateCamera(LeafSystem):
    """Sees every 0.03 s, says so `DELAY` later, and misses every fourth picture."""

    def __init__(self, blind_from=np.inf):
        super().__init__()
        self._blind_from = blind_from
        self.DeclareVectorInputPort("pose", 3)
        self._log = self.DeclareDiscreteState(np.full(4 * 8, np.nan))
        self.DeclareVectorOutputPort("object_pose", 3, self._calc_pose)
        self.DeclareVectorOutputPort("pose_time", 1, self._calc_time)
        self.DeclarePeriodicDiscreteUpdateEvent(0.03, 0.0, self._look)

    def _look(self, context, state):
        log = context.get_discrete_state(self._log).value().reshape(8, 4)
        time = context.get_time()
        seen = self.get_input_port().Eval(context)
        if round(time / 0.03) % 4 == 3 or time > self._blind_from:
            seen = np.full(3, np.nan)
        state.set_value(self._log, np.vstack([log[1:], [[time, *seen]]]).ravel())

    def _find(self, context):
        log = context.get_discrete_state(self._log).value().reshape(8, 4)
        come = log[log[:, 0] <= context.get_time() - DELAY]
        return come[-1] if len(come) else np.full(4, np.nan)

    def _calc_pose(self, context, output):
        output.SetFromVector(self._find(context)[1:])

    def _calc_time(self, context, output):
        output.SetFromVector(self._find(context)[:1])


class Finger(LeafSystem):
    """Puts place and velocity together, as the world and as a sensor have them."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("tip", 2)
        self.DeclareVectorInputPort("velocity", 2)
        self.DeclareVectorOutputPort("planar_state", 4, self._calc_planar)
        self.DeclareVectorOutputPort("pusher_state", 6, self._calc_state)

    def _calc_planar(self, context, output):
        output.SetFromVector([*self.get_input_port(0).Eval(context),
                              *self.get_input_port(1).Eval(context)])  # fmt: skip

    def _calc_state(self, context, output):
        x, y = self.get_input_port(0).Eval(context)
        vx, vy = self.get_input_port(1).Eval(context)
        output.SetFromVector([x, y, 0.02, vx, vy, 0.0])


class Run:
    """The Diagram, its simulator and its parts."""

    def __init__(self, path=None, goal=GOAL, blind_from=np.inf, tip=(-0.1, 0.0), learned=None):
        builder = DiagramBuilder()
        add = builder.AddSystem
        self.world = add(GridLcpSystem(Model(OBJ, TRUTH), pusher_radius=FINGER.radius))
        self.controller = add(
            FeedbackPushController(OBJ, FINGER, path, params=TRUTH, options=OPTIONS, seed=1)
        )
        camera = add(LateCamera(blind_from))
        finger = add(Finger())
        place = add(Integrator(np.array(tip)))
        self.goal = add(ConstantVectorSource(np.array(goal)))
        connect = builder.Connect
        velocity = self.controller.GetOutputPort("tip_velocity")
        connect(velocity, place.get_input_port())
        connect(place.get_output_port(), finger.GetInputPort("tip"))
        connect(velocity, finger.GetInputPort("velocity"))
        connect(finger.GetOutputPort("planar_state"), self.world.GetInputPort("pusher_state"))
        connect(finger.GetOutputPort("pusher_state"), self.controller.GetInputPort("pusher_state"))
        connect(self.world.GetOutputPort("pose"), camera.get_input_port())
        for name in ("object_pose", "pose_time"):
            connect(camera.GetOutputPort(name), self.controller.GetInputPort(name))
        connect(self.goal.get_output_port(), self.controller.GetInputPort("goal_pose"))
        self.simulator = Simulator(builder.Build())
        if learned is not None:
            context = self.controller.GetMyMutableContextFromRoot(
                self.simulator.get_mutable_context()
            )
            self.controller.GetInputPort("identification").FixValue(context, learned)

    def read(self, system, port, simulator=None):
        context = (simulator or self.simulator).get_context()
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))

    def go_on(self, most, note=None):
        """Simulates while it pushes, or waits for a first pose; returns the status."""
        end = self.simulator.get_context().get_time() + most
        while self.simulator.get_context().get_time() < end:
            self.simulator.AdvanceTo(self.simulator.get_context().get_time() + 0.05)
            status = self.read(self.controller, "status")
            if note is not None:
                note(self.read(self.world, "pose"))
            waits = status.mode == FollowStatus.NO_GOAL or (
                status.mode == FollowStatus.NO_POSE and status.decisions < 5
            )
            if status.mode != FollowStatus.PUSHING and not waits:
                break
        return status


def test_reaches_the_goal_with_late_and_missing_poses():
    run = Run()
    status = run.go_on(30.0)
    assert status.mode == FollowStatus.REACHED, status
    assert status.reason.endswith("tolerance.")
    pose = run.read(run.world, "pose")
    middle = OBJ.p_BC.mean(axis=0)[None]
    assert np.linalg.norm(transform(pose, middle) - transform(np.array(GOAL), middle)) < 2.5e-3
    assert abs(wrap_angle(pose[2] - GOAL[2])) < np.radians(1.3)
    assert status.pose == pytest.approx(tuple(pose), abs=2e-3)
    assert not run.read(run.controller, "tip_velocity").any()
    # and to another goal, which comes on the port
    source = run.goal.GetMyMutableContextFromRoot(run.simulator.get_mutable_context())
    run.goal.get_mutable_source_value(source).SetFromVector([0.14, 0.1, 0.5])
    run.simulator.AdvanceTo(run.simulator.get_context().get_time() + 0.1)
    assert run.read(run.controller, "status").mode == FollowStatus.PUSHING


def test_follows_a_path_at_its_speed():
    s = np.linspace(0.0, 0.2, 30)
    points = OBJ.p_BC.mean(axis=0) + np.column_stack([s, 1.0 * s**2])
    path = PosePath.through(OBJ, points, 0.05)
    run = Run(path, tip=(-0.065, 0.0))
    poses = []
    status = run.go_on(20.0, poses.append)
    assert status.mode == FollowStatus.REACHED, status
    off = PathProgress(OBJ, path).measure_distance(
        transform(np.array(poses), OBJ.p_BC.mean(axis=0)[None])[:, 0]
    )
    assert np.sqrt((off**2).mean()) < 3e-3
    assert status.progress == pytest.approx(PathProgress(OBJ, path).length, abs=3e-3)


def test_a_clone_goes_on_alike():
    run = Run()
    run.simulator.AdvanceTo(1.5)
    clone = Simulator(run.simulator.get_system(), run.simulator.get_context().Clone())
    for each in (run.simulator, clone):
        each.AdvanceTo(2.5)
    for system, port in ((run.world, "pose"), (run.controller, "tip_velocity")):
        assert run.read(system, port) == pytest.approx(run.read(system, port, clone), abs=1e-9)


def test_rests_without_poses_and_without_a_goal():
    run = Run(blind_from=0.5)
    run.simulator.AdvanceTo(0.5)
    assert run.read(run.controller, "status").mode == FollowStatus.PUSHING
    run.simulator.AdvanceTo(2.0)
    status = run.read(run.controller, "status")
    assert status.mode == FollowStatus.NO_POSE
    assert "No pose" in status.reason
    assert not run.read(run.controller, "tip_velocity").any()
    idle = Run(goal=(np.nan, np.nan, np.nan))
    idle.simulator.AdvanceTo(0.5)
    assert not idle.read(idle.controller, "tip_velocity").any()
    status = idle.read(idle.controller, "status")
    assert (status.mode, status.decisions) == (FollowStatus.NO_GOAL, 0)
    assert status.reason == "No goal is given."


def test_a_finger_or_a_goal_that_is_no_place_for_one_period_is_a_status():
    run = Run()
    simulator = run.simulator
    simulator.AdvanceTo(0.5)
    root = simulator.get_mutable_context()
    source = run.goal.GetMyMutableContextFromRoot(root)
    run.goal.get_mutable_source_value(source).SetFromVector([1e300, 0.0, 0.0])
    simulator.AdvanceTo(0.62)
    status = run.read(run.controller, "status")
    assert status.mode == FollowStatus.GOAL_TOO_FAR
    assert not run.read(run.controller, "tip_velocity").any()
    run.goal.get_mutable_source_value(source).SetFromVector(GOAL)
    simulator.AdvanceTo(0.8)
    assert run.read(run.controller, "status").mode == FollowStatus.PUSHING
    port = run.controller.GetInputPort("pusher_state")
    port.FixValue(run.controller.GetMyMutableContextFromRoot(root), np.full(6, np.nan))
    simulator.AdvanceTo(1.0)
    status = run.read(run.controller, "status")
    assert status.mode == FollowStatus.NO_FINGER
    assert status.reason.endswith(".")
    assert not run.read(run.controller, "tip_velocity").any()


def test_takes_the_learned_model_from_the_port():
    learned = make_identification(OBJ)
    run = Run(learned=learned)
    run.simulator.AdvanceTo(0.2)
    context = run.controller.GetMyContextFromRoot(run.simulator.get_context())
    state = context.get_abstract_state(0).get_value()
    assert state.learned.push_names == learned.push_names
    loads = learned.params.friction * learned.params.mass * learned.physics.gravity
    assert state.follower.model.body.k == pytest.approx(loads)


def test_a_plate_is_steered_with_its_angle():
    plate = PusherShape.plate(0.04, 0.016, 0.003)
    finger = FeedbackFinger(plate.radius, shape=plate, turning_speed=1.2)
    controller = FeedbackPushController(OBJ, finger, params=TRUTH, options=OPTIONS)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    values = {
        "object_pose": np.zeros(3),
        "pusher_state": np.array([-0.15, 0.0, 0.02, 0.0, 0.0, 0.0]),
        "pusher_yaw": np.array([1.0]),
        "goal_pose": np.array(GOAL),
    }
    for port, value in values.items():
        controller.GetInputPort(port).FixValue(context, value)
    simulator.AdvanceTo(0.3)
    status = controller.GetOutputPort("status").Eval(context)
    velocity = controller.GetOutputPort("tip_velocity").Eval(context)
    assert status.mode == FollowStatus.PUSHING
    assert velocity.shape == (3,)
    # it goes to the object, and turns to face it
    assert np.linalg.norm(velocity[:2]) > 0.05
    assert 0.0 < abs(velocity[2]) <= 1.2 + 1e-9
