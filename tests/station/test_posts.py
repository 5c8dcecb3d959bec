"""Posts on the table: a scenario names them, the plant has them, and pushes keep clear of them."""

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator

from gridpush_drake import MakePushStation, PushCommand, PushScenario
from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.posts import leave_out, place_posts
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.schema.scenario import PostConfig
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.tasks.identify_task import make_policy
from gridpush_drake.station.tasks.push_task import make_rules

POST = {"position": [0.7, 0.1], "radius": 0.03, "height": 0.05}


def make_scenario(**fields):
    return PushScenario(object="pliers", object_pose=[0.55, -0.1, 0.0], **fields)


@pytest.fixture(scope="module")
def station():
    return MakePushStation(make_scenario(posts=[POST]))


def test_tasks_plan_around_a_post(station):
    center = shapely.Point(POST["position"])
    (outline,) = station.obstacles
    # the polygon lies around the circle, and not far
    assert outline.covers(center.buffer(POST["radius"] - 1e-9, 64))
    assert outline.hausdorff_distance(center.buffer(POST["radius"], 64)) < 0.001
    region = MakeFingerRegion(station)
    gap = POST["radius"] + station.robot.finger.tip_radius
    assert gap - 1e-6 < region.distance(center) < gap + 0.001
    assert make_rules(station, make_surface(station.table_top)).constraints.obstacles == (outline,)
    policy = make_policy(station)
    assert policy.pokes.region.keep_in.distance(center) > POST["radius"]


def test_what_touches_a_post_is_told(station):
    context = station.CreateDefaultContext()
    station.SetStart(context)
    station.GetInputPort("push_command").FixValue(context, PushCommand().to_vector())
    simulator = Simulator(station, context)
    monitor = LimitMonitor(station, period=0.002)
    simulator.set_monitor(monitor)
    simulator.AdvanceTo(0.02)
    assert not monitor.limit_report.touched
    assert monitor.limit_report.force == 0.0
    # the object is laid where the post stands
    plant = station.plant
    plant_context = plant.GetMyMutableContextFromRoot(context)
    SetGridObjectPose(plant, plant_context, station.object_in_plant, (0.7, 0.1, 0.0))
    simulator.AdvanceTo(0.04)
    assert any("post_0" in pair for pair in monitor.limit_report.touched)


def test_nothing_is_cut_out_where_there_is_nothing():
    region = shapely.box(0, 0, 1, 1)
    assert leave_out(region, (), 0.1) is region
    cut = leave_out(region, place_posts([PostConfig(position=[0.5, 0.5])]), 0.1)
    assert cut.area == pytest.approx(1 - np.pi * 0.12**2, abs=1e-3)


@pytest.mark.parametrize(
    ("post", "message"),
    [
        ({"position": [1.5, 0.0]}, r"posts\[0\].position is \[1.5, 0\]: there the post is not"),
        ({"position": [0.55, -0.1]}, r"posts\[0\].position is .* in the object of object_pose"),
        ({"position": [0.7, 0.1], "height": 0.115}, r"posts\[0\].height is 0.115 m; expected less"),
    ],
)
def test_a_post_that_will_not_do_is_refused(post, message):
    with pytest.raises(ScenarioError, match=message):
        resolve(make_scenario(posts=[post]))


@pytest.mark.parametrize(
    ("post", "field"),
    [
        ({"position": [0.7]}, "posts.*position"),
        ({"position": [0.7, 0.1], "radius": -1.0}, "posts.*radius"),
        ({"radius": 0.02}, "posts.*position"),
    ],
)
def test_a_post_of_another_form_is_refused(post, field):
    with pytest.raises(ScenarioError, match=field):
        make_scenario(posts=[post])
