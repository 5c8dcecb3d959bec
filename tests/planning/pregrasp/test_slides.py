"""A slide is weighed with a hundred draws, of as few pushes as possible, each of them once."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.model_batch import simulate_models
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, QUASI_STATIC
from gridpush_drake.dynamics.push import DEFAULT_TIP_STEP, Push, make_path_times
from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.edge_motion import (
    COMPARED_TIP_STEP,
    follow_near_edge,
    simulate_near_edge,
)
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp import slides
from gridpush_drake.planning.pregrasp.goals import find_pregrasp_goals
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import find_grasp_parts
from gridpush_drake.planning.pregrasp.slides import SlideOptions, plan_slide
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import claw_hammer

TABLE = SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6))
DRAWS = 100


@pytest.fixture(scope="module")
def hammer():
    return GridObject.from_outline(claw_hammer(), max_cells=60, name="hammer")


@pytest.fixture(scope="module")
def draws(hammer):
    rng = np.random.default_rng(4)
    even = CellParameters.uniform(hammer)
    return [replace(even, mass=even.mass * rng.uniform(0.5, 2.0, hammer.n)) for _ in range(DRAWS)]


def push_over_the_edge(obj, distance=0.25):
    """A push along +x from behind, of an object 7 cm from where it falls off at x = 0.4."""
    pose = np.array([0.0, 0.05, 0.2])
    pose[0] = 0.33 - obj.cells_at(pose)[:, 0].mean()
    cells = obj.cells_at(pose)
    row = np.abs(cells[:, 1] - cells[:, 1].mean()) < 0.01
    start = (cells[row, 0].min() - obj.cell_size / 2 - 0.02, cells[:, 1].mean())
    return Push(start, (0.03, 0.0), distance / 0.03, 0.008), pose


def test_many_models_are_simulated_as_each_by_itself(hammer, draws):
    push, pose = push_over_the_edge(hammer)
    times = make_path_times(push, "quasi_static")
    options = {"times": times, "physics": QUASI_STATIC, "table": TABLE.corners}
    made = simulate_models(hammer, draws[:12], push, pose, **options)
    fell = 0
    for m, params in enumerate(draws[:12]):
        model = Model(hammer, params, QUASI_STATIC)
        alone = simulate(model, push, pose, times=times, table=TABLE.corners)
        np.testing.assert_array_equal(made.poses[m], alone.poses)
        motion = simulate_near_edge(Model(hammer, params), push, pose, TABLE)
        assert made.upright[m] == len(motion.poses) - motion.fell
        fell += motion.fell
    assert fell > 0
    # Wholly on the table no object falls, by whichever model.
    start = (push.start[0] - 0.3, push.start[1])
    middle = Push(start, push.velocity, push.duration, push.radius)
    inside = simulate_models(hammer, draws[:3], middle, pose - (0.3, 0.0, 0.0), **options)
    assert (inside.upright == len(times)).all()


def test_a_fast_push_is_not_simulated_by_many_models(hammer, draws):
    push, pose = push_over_the_edge(hammer)
    times = make_path_times(push, "quasi_static")
    with pytest.raises(SimulationError, match="regime is 'auto'; expected 'quasi_static'"):
        simulate_models(hammer, draws, push, pose, times=times, physics=DEFAULT_PHYSICS)


@pytest.mark.parametrize(
    ("distance", "tip_step", "error"),
    [(0.06, COMPARED_TIP_STEP, 2e-4), (0.25, DEFAULT_TIP_STEP, 1e-5)],
)
def test_models_are_followed_to_where_they_fall(hammer, draws, distance, tip_step, error):
    push, pose = push_over_the_edge(hammer, distance)
    places = np.unique(np.append(np.arange(0.0, distance, 0.003), distance))
    followed = follow_near_edge(hammer, draws[:20], push, pose, TABLE, places, tip_step=tip_step)
    assert followed.poses.shape == (20, len(places), 3)
    for m, params in enumerate(draws[:20]):
        motion = simulate_near_edge(Model(hammer, params), push, pose, TABLE)
        count = int((places < motion.traveled[-1]).sum()) if motion.fell else len(places)
        assert followed.counts[m] == count
        for i in range(3):
            exact = np.interp(places[:count], motion.traveled, motion.poses[:, i])
            # Within `error`, m, or ten times as many radians.
            bound = error if i < 2 else 10 * error
            np.testing.assert_allclose(followed.poses[m, :count, i], exact, rtol=0.0, atol=bound)
    fell = (followed.counts < len(places)).sum()
    assert fell == 0 if distance < 0.1 else fell > 0


def test_without_models_nothing_is_followed(hammer):
    push, pose = push_over_the_edge(hammer)
    followed = follow_near_edge(hammer, [], push, pose, TABLE, np.array([0.0, 0.01]))
    assert followed.poses.shape == (0, 2, 3)
    assert followed.counts.shape == (0,)


@pytest.fixture(scope="module")
def slide_task(hammer, draws):
    """What a slide is planned with; some of the draws are much heavier at one end than others."""
    even = CellParameters.uniform(hammer)
    masses = PlausibleMassSet(hammer, even.mass[None] / 1.5, even.mass[None])
    pose = np.array([0.15, 0.0, 0.6])
    goals = find_pregrasp_goals(masses, find_grasp_parts(hammer), pose, TABLE)
    return {
        "masses": masses,
        "params": even,
        "draws": draws,
        "pose": pose,
        "goals": goals,
        "surface": TABLE,
    }


def test_each_model_follows_a_push_once(slide_task, monkeypatch):
    asked = []

    def follow(models, push, **others):
        line = (*push.start, *push.velocity)
        asked.extend((np.round(line, 9).tobytes(), id(params)) for params in models)
        return follow_near_edge(models=models, push=push, **others)

    monkeypatch.setattr(slides, "follow_near_edge", follow)
    slide = plan_slide(**slide_task)
    assert slide is not None
    assert len(asked) == len(set(asked))
    # The chosen push was weighed with all of them; most of the others with a few.
    by_push = {line: sum(line == one for one, _ in asked) for line, _ in asked}
    chosen = np.round((*slide.planned.push.start, *slide.planned.push.velocity), 9).tobytes()
    assert by_push[chosen] == 1 + DRAWS
    few = 1 + SlideOptions().few
    assert sum(count > few for count in by_push.values()) <= 3


def test_sifting_finds_what_weighing_all_proposals_would(slide_task):
    """With all draws sifting, every proposal is weighed with all of them."""
    sifted = plan_slide(**slide_task)
    thorough = plan_slide(**slide_task, options=SlideOptions(few=DRAWS))
    assert sifted.planned.cost <= thorough.planned.cost + 5e-4
    assert thorough.planned.cost <= sifted.planned.cost + 5e-4


def test_the_cost_and_the_margin_are_those_of_all_models(slide_task):
    slide = plan_slide(**slide_task)
    obj, pose = slide_task["masses"].obj, slide_task["pose"]
    kept = slides.calc_kept_margin(slide_task["masses"], pose, TABLE, SlideOptions().margin)
    ends = []
    broken = 0
    for params in (slide_task["params"], *slide_task["draws"]):
        motion = simulate_near_edge(Model(obj, params), slide.planned.push, pose, TABLE)
        assert not motion.fell
        margins = slides.calc_stability_margins(slide_task["masses"], motion.poses, TABLE)
        broken += margins.min() < min(kept, slide.margin) - 2e-3
        ends.append(motion.final_pose)
    costs = calc_goal_error(obj, np.array(ends), slide.goal.pose)
    assert slide.planned.cost == pytest.approx(costs.mean(), abs=2e-4)
    assert broken <= 5
    np.testing.assert_allclose(slide.planned.pose, ends[0], atol=2e-4)


def test_a_push_is_given_up_once_too_many_draws_leave_nothing_of_it(slide_task, monkeypatch):
    """By each of the draws but the few that sift the object hangs over too far at once."""
    followed = []
    sifting = (slide_task["params"], *slide_task["draws"][: SlideOptions().few])
    known = [id(params) for params in sifting]

    def follow(models, **others):
        motions = follow_near_edge(models=models, **others)
        if id(models[0]) not in known:
            followed.append(len(models))
            return replace(motions, poses=motions.poses + np.array([5.0, 0.0, 0.0]))
        return motions

    monkeypatch.setattr(slides, "follow_near_edge", follow)
    assert plan_slide(**slide_task) is None
    assert followed
    assert set(followed) == {slides.BLOCK_SIZE}
    assert len(followed) <= SlideOptions().proposals


def test_a_push_that_is_cut_keeps_its_pushers_shape_and_angle(slide_task):
    plate = PusherShape.plate(width=0.05, thickness=0.02, radius=0.003)
    contact = ContactOptions(pusher=Pusher(shape=plate), starts=2, budget=4)
    pose = slide_task["pose"]
    model = Model(slide_task["masses"].obj, slide_task["params"])
    planned = optimize_contact(model, pose, pose + [0.05, 0.0, 0.0], options=contact).candidates[0]
    weighing = slides._SlideWeighing(
        masses=slide_task["masses"],
        models=(slide_task["params"],),
        pose=pose,
        surface=TABLE,
        kept_margin=0.0,
        checker=slides.PushConstraints().start_at(model.obj, pose, plate.reach),
        options=SlideOptions(contact=contact),
    )
    cut = weighing._make_push(planned, planned.distance / 2)
    assert cut.shape == plate
    assert cut.yaw is not None and planned.push.yaw is not None
    np.testing.assert_allclose(cut.yaw[0], planned.push.yaw[0])
    np.testing.assert_allclose(cut.start, planned.push.start)
    np.testing.assert_allclose(cut.length, planned.distance / 2)
