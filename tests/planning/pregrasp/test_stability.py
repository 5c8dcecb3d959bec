import numpy as np
import pytest
import shapely
from scipy.optimize import linprog

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.polygons import calc_margin_inside, find_weakest_direction, hull_of
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import PRIOR_AMPLITUDE, Belief
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.stability import (
    calc_stability_margin,
    calc_stability_margins,
    calc_support_polygon,
)
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.made_identifications import make_identification
from tests.helpers.random_objects import make_random_object
from tests.helpers.shapes import claw_hammer, make_shape, rectangle

LENGTH, WIDTH = 0.2, 0.02  # of the rod, m


@pytest.fixture
def rod():
    return GridObject.from_outline(rectangle(LENGTH, WIDTH), max_cells=40, name="rod")


@pytest.fixture
def hammer():
    return GridObject.from_outline(claw_hammer(), max_cells=60, name="hammer")


def make_directions(count):
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angle), np.sin(angle)])


def solve_linear_program(p, least, most, direction):
    """Charnes and Cooper's form: the masses add up to one, their common scale is an unknown more."""
    n = len(p)
    upper = np.hstack([np.eye(n), -most[:, None]])
    lower = np.hstack([-np.eye(n), least[:, None]])
    found = linprog(
        np.append(-(p @ direction), 0.0),
        A_ub=np.vstack([upper, lower]),
        b_ub=np.zeros(2 * n),
        A_eq=np.append(np.ones(n), 0.0)[None],
        b_eq=[1.0],
        bounds=[(0, None)] * (n + 1),
        method="highs",
    )
    assert found.status == 0
    return -found.fun


@pytest.mark.parametrize("seed", range(4))
def test_the_worst_center_of_mass_is_the_linear_program_s(seed):
    rng = np.random.default_rng(seed)
    obj = make_random_object(rng, 25)
    fraction = rng.dirichlet(np.full(25, 0.5)) + 1e-4
    low, high = 0.2, 0.2 * rng.uniform(1, 10)
    masses = PlausibleMassSet(obj, fraction[None] / high, fraction[None] / low)
    directions = make_directions(12)
    expected = [
        solve_linear_program(obj.p_BC, fraction / high, fraction / low, d) for d in directions
    ]
    np.testing.assert_allclose(masses.calc_support(directions), expected, atol=1e-9)


def test_a_uniform_rod_s_worst_center_is_known(rod):
    ratio = 4.0
    fraction = np.full((1, rod.n), 1 / rod.n)
    far = PlausibleMassSet(rod, fraction / ratio, fraction).calc_support([[1.0, 0.0]])[0]
    # light to the left of x, heavy to the right of it: (x + L/2)² = ratio (L/2 - x)²
    expected = LENGTH * np.sqrt(ratio) / (1 + np.sqrt(ratio)) - LENGTH / 2
    assert far == pytest.approx(expected, abs=rod.cell_size / 4)


def test_the_polygon_holds_every_center_of_mass_of_the_set(hammer):
    rng = np.random.default_rng(3)
    fraction = rng.dirichlet(np.ones(hammer.n))
    masses = PlausibleMassSet(hammer, fraction[None] / 0.6, fraction[None] / 0.2)
    hull = shapely.Polygon(masses.center_of_mass_polygon)
    for i in range(200):
        mu = np.where(hammer.p_BC @ make_directions(200)[i] > rng.uniform(-0.1, 0.1), 0.2, 0.6)
        mass = fraction / mu
        assert hull.buffer(1e-9).contains(shapely.Point(mass @ hammer.p_BC / mass.sum()))


def test_masses_known_for_certain_leave_one_point(hammer):
    params = CellParameters.random(hammer, 0, by="cell")
    corners = PlausibleMassSet.of_masses(Model(hammer, params)).center_of_mass_polygon
    np.testing.assert_allclose(corners - params.center_of_mass(hammer), 0.0, atol=1e-8)


def test_what_was_learned_narrows_the_set_and_friction_widens_it(hammer):
    prior = Belief.of_prior(hammer).posterior
    sure = type(prior)(prior.mean, 1e-4 * prior.covariance, prior.prior_covariance)
    area = {
        (name, high): shapely.Polygon(
            PlausibleMassSet.from_posterior(hammer, posterior, (0.2, high)).center_of_mass_polygon
        ).area
        for name, posterior in (("prior", prior), ("sure", sure))
        for high in (0.3, 0.6)
    }
    assert area["sure", 0.3] < area["sure", 0.6] < area["prior", 0.6]
    assert area["sure", 0.3] < area["prior", 0.3] < area["prior", 0.6]


def test_a_known_center_of_mass_cuts_the_set_down():
    prior = PhysicalPrior(center_of_mass=(-0.02, 0.0), center_of_mass_std=0.001)
    obj = GridObject.from_outline(claw_hammer(), max_cells=60, prior=prior)
    corners = PlausibleMassSet.from_posterior(
        obj, Belief.of_prior(obj).posterior
    ).center_of_mass_polygon
    assert np.abs(corners - (-0.02, 0.0)).max() <= 0.003 + 1e-12


def test_a_rod_over_an_edge_tips_where_the_lever_says(rod):
    table = SupportSurface.rectangle((-0.5, 0.0), (1.0, 1.0))
    known = PlausibleMassSet.of_masses(Model(rod))
    columns = np.unique(rod.p_BC[:, 0])
    for out in np.linspace(0.01, 0.15, 29):
        pose = (out - LENGTH / 2, 0.0, 0.0)
        held = columns + pose[0] <= 0
        expected = min(
            columns[held].max() if held.any() else -np.inf, WIDTH / 2 - rod.cell_size / 2
        )
        if (
            held.sum() > 1
            and np.abs(columns + pose[0]).min() > 1e-9
            and abs(out - LENGTH / 2) > 1e-9
        ):
            assert calc_stability_margin(known, pose, table, inset=0.0) == pytest.approx(
                expected, abs=1e-9
            )
            stays = calc_loads(Model(rod), pose, table.corners) is not None
            assert stays == (out < LENGTH / 2) and (stays or expected <= 0)


def test_an_inset_and_a_worse_set_only_take_margin_away(hammer):
    table = SupportSurface.round((0.0, 0.0), 0.3)
    poses = np.column_stack([np.linspace(0.1, 0.4, 20), np.zeros(20), np.linspace(0, 2, 20)])
    params = CellParameters.uniform(hammer)
    known, doubtful = (
        PlausibleMassSet.of_masses(Model(hammer, params)),
        PlausibleMassSet(hammer, params.mass[None] / 3, params.mass[None]),
    )
    plain = calc_stability_margins(known, poses, table, 0.0)
    safe = plain > 0
    assert 5 < safe.sum() < 20
    assert (calc_stability_margins(known, poses, table, 0.01)[safe] <= plain[safe] + 1e-12).all()
    assert (calc_stability_margins(doubtful, poses, table, 0.0) <= plain + 1e-12).all()


def test_the_compiled_hull_is_the_hull(hammer):
    rng = np.random.default_rng(5)
    table = SupportSurface.round((0.0, 0.0), 0.25)
    masses = PlausibleMassSet.of_masses(Model(hammer, CellParameters.random(hammer, 2, by="cell")))
    poses = np.column_stack([rng.uniform(-0.3, 0.3, (100, 2)), rng.uniform(-4, 4, 100)])
    expected = []
    for pose in poses:
        hull = calc_support_polygon(hammer, pose, table)
        assert len(hull) == 0 or shapely.Polygon(hull).exterior.is_ccw
        expected.append(calc_margin_inside(masses.center_of_mass_polygon, hull))
    np.testing.assert_allclose(calc_stability_margins(masses, poses, table), expected, atol=1e-12)
    assert 10 < np.isfinite(expected).sum() < 100


def test_the_weakest_direction_points_off_the_nearest_edge():
    hull = hull_of(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5]]))
    np.testing.assert_allclose(find_weakest_direction(np.array([[0.9, 0.25]]), hull), [1.0, 0.0])
    np.testing.assert_allclose(find_weakest_direction(np.array([[0.5, 0.6]]), hull), [0.0, 1.0])
    assert calc_margin_inside(np.array([[0.5, 0.6]]), hull) == pytest.approx(-0.1)


@pytest.mark.parametrize("seed", range(5))
def test_loads_over_an_edge_balance_and_only_press(seed, hammer):
    params = CellParameters.random(hammer, seed, by="cell")
    center = params.center_of_mass(hammer)
    weight = 9.81 * params.total_mass
    for x in np.linspace(-0.15, 0.1, 15):
        table = SupportSurface.rectangle((x - 1, 0.0), (2.0, 2.0))
        load = calc_loads(Model(hammer, params), table=table.corners)
        held = hammer.p_BC[:, 0] < x + hammer.cell_size / 2
        if center[0] > x:
            assert load is None
        elif (
            calc_margin_inside(center[None], hull_of(hammer.p_BC[hammer.p_BC[:, 0] < x]))
            > hammer.cell_size
        ):
            assert (load >= 0).all() and not load[~held].any()
            np.testing.assert_allclose(load.sum(), weight)
            np.testing.assert_allclose(
                load @ hammer.p_BC / weight, center, atol=0.01 * hammer.cell_size
            )


def test_a_rod_s_loads_over_an_edge_are_known(rod):
    """Of equal cells on [-L/2, a] the loads grow as exp(b x), with the mean of x where the weight is."""
    edge = -LENGTH / 2 + 0.75 * LENGTH
    on = np.unique(rod.p_BC[:, 0]) < edge
    table = SupportSurface.rectangle((edge - 1, 0.0), (2.0, 2.0))
    load = calc_loads(Model(rod), table=table.corners)
    columns = [load[rod.p_BC[:, 0] == x].sum() for x in np.unique(rod.p_BC[:, 0])]
    growth = np.diff(np.log(np.array(columns)[on]))[:-1]
    np.testing.assert_allclose(growth, growth[0], rtol=1e-6)
    assert load @ rod.p_BC[:, 0] / load.sum() == pytest.approx(0.0, abs=0.01 * rod.cell_size)


def test_all_on_the_table_every_cell_bears_its_own_weight(hammer):
    params = CellParameters.random(hammer, 1, by="cell")
    np.testing.assert_allclose(calc_loads(Model(hammer, params)), 9.81 * params.mass, rtol=1e-12)


def test_a_push_over_the_edge_drops_the_rod_when_it_tips(rod):
    table = SupportSurface.rectangle((-0.5, 0.0), (1.0, 1.0))
    params = CellParameters.uniform(rod)
    push = Push((-0.308, 0.0), (0.03, 0.0), 8.0, 0.008)
    motion = simulate_near_edge(Model(rod, params), push, (-0.2, 0.0, 0.0), table)
    assert motion.fell
    assert motion.final_pose[0] == pytest.approx(0.0, abs=0.001)
    short = Push((-0.308, 0.0), (0.03, 0.0), 5.0, 0.008)
    stays = simulate_near_edge(Model(rod, params), short, (-0.2, 0.0, 0.0), table)
    assert not stays.fell
    assert stays.final_pose[0] == pytest.approx(-0.05, abs=1e-3)


def test_a_push_that_stays_on_the_table_is_the_plain_one(hammer):
    params = CellParameters.random(hammer, 1)
    push = Push.on_outline(hammer, 0.3, 0.2, 0.05, radius=0.008, speed=0.03)
    table = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
    motion = simulate_near_edge(Model(hammer, params), push, (0.0, 0.0, 0.0), table)
    plain = simulate(Model(hammer, params), push, regime="quasi_static")
    np.testing.assert_allclose(motion.poses, plain.poses, atol=1e-9)


def test_the_way_around_a_corner_is_all_of_the_path(rod):
    table = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
    push = Push.along([0.0, 1.0, 2.0], [[-0.2, -0.2], [-0.1507, -0.2], [-0.1507, -0.1504]], 0.008)
    motion = simulate_near_edge(Model(rod), push, (0.0, 0.0, 0.0), table)
    assert motion.traveled[-1] == pytest.approx(push.length, abs=1e-12)


def test_an_overhanging_rod_pushed_at_its_center_of_mass_hardly_turns(rod):
    """The loads' moment is the weight's wherever they are, but they lie nearer to it: the rod resists turning less."""
    table = SupportSurface.rectangle((-0.5, 0.0), (1.0, 1.0))
    params = CellParameters.uniform(rod)
    push = Push((-0.03, -0.018), (0.0, 0.03), 1.0, 0.008)
    motion = simulate_near_edge(Model(rod, params), push, (-0.03, 0.0, 0.0), table)
    load = calc_loads(Model(rod, params), (-0.03, 0.0, 0.0), table.corners)
    assert load @ rod.p_BC[:, 0] / load.sum() == pytest.approx(0.0, abs=0.01 * rod.cell_size)
    assert abs(motion.final_pose[2]) < 0.05
    assert (load @ rod.p_BC[:, 0] ** 2) / load.sum() < (
        params.mass @ rod.p_BC[:, 0] ** 2
    ) / params.total_mass


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda obj: PlausibleMassSet(obj, np.ones((1, 3)), np.ones((1, 3))), "shapes"),
        (
            lambda obj: PlausibleMassSet(obj, 2 * np.ones((1, obj.n)), np.ones((1, obj.n))),
            "mass_min <= mass_max",
        ),
        (
            lambda obj: PlausibleMassSet(obj, np.ones((1, obj.n)), np.ones((1, obj.n)), 0.0),
            "confidence",
        ),
        (
            lambda obj: PlausibleMassSet.from_posterior(
                obj, Belief.of_prior(obj).posterior, (0.5, 0.2)
            ),
            "friction_range",
        ),
    ],
)
def test_refuses_sets_that_make_no_sense(make, says, rod):
    with pytest.raises(PlanningError, match=says):
        make(rod)


@pytest.fixture(scope="module")
def found():
    return make_identification(seed=2)


def test_one_path_leads_from_an_identification_to_samples_and_masses(found):
    model = Belief.of_identification(found, friction_range=(0.2, 0.5), sample_count=3, seed=7)
    assert model.params is found.params
    assert model.posterior is found.posterior
    noise = NoiseModel()
    expected = (found.noise_std / noise.pose, found.load_shift_std / noise.load_shift)
    assert model.noise_scale == pytest.approx(expected)
    for sample, expected in zip(model.samples, found.draws(3, seed=7), strict=True):
        np.testing.assert_array_equal(sample.params.mass, expected.mass)
    expected = PlausibleMassSet.from_posterior(found.obj, found.posterior, (0.2, 0.5), seed=7)
    np.testing.assert_array_equal(model.masses.mass_min, expected.mass_min)
    np.testing.assert_array_equal(model.masses.mass_max, expected.mass_max)


def test_the_prior_is_described_as_any_identification():
    obj = make_shape("square", 16)
    model = Belief.of_prior(obj)
    prior = describe_prior(obj, MapEnsemble(hypotheses=(SmoothField(PRIOR_AMPLITUDE),)))
    np.testing.assert_array_equal(model.posterior.covariance, prior.posterior.covariance)
    np.testing.assert_allclose(np.diag(model.posterior.covariance)[:-1].mean(), PRIOR_AMPLITUDE**2)
    assert (model.samples, model.noise_scale, len(model.poke_starts)) == ((), (1.0, 1.0), 0)


def test_parameters_taken_for_granted_leave_nothing_to_learn():
    obj = make_shape("square", 16)
    params = CellParameters.uniform(obj)
    model = Belief.of_parameters(Model(obj, params))
    assert model.samples == ()
    np.testing.assert_array_equal(model.masses.mass_min, model.masses.mass_max)
    with pytest.raises(PlanningError, match="taken for granted"):
        model.require_posterior()


def test_knows_where_pokes_began_in_the_body_frame(found):
    pose, p_BS = np.array([0.3, -0.2, 2.1]), np.array([0.05, 0.02])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    start = pose[:2] + np.array([[c, -s], [s, c]]) @ p_BS
    seen = ObservedPush(
        "poke", Push(tuple(start), (0.03, 0.0), 1.0, 0.008), pose, np.array([1.0]), pose[None]
    )
    model = Belief.of_identification(found, log=PushLog((seen,)))
    np.testing.assert_allclose(model.poke_starts, p_BS[None], atol=1e-12)


def test_refuses_a_friction_range_that_is_none(found):
    with pytest.raises(PlanningError, match="friction_range"):
        _ = Belief.of_identification(found, friction_range=(0.5, 0.2)).masses
