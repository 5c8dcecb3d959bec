import numpy as np
import pytest
from scipy.optimize import linprog

from gridpush_drake.identification.identifiability import (
    calc_center_of_mass_box,
    calc_identifiability,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import LEARNED_FRACTION, Posterior
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters

RECTANGLE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]


def make_object() -> GridObject:
    prior = PhysicalPrior(friction=0.4, friction_min=0.2, friction_max=0.8, total_mass=2.0)
    return GridObject.from_outline(RECTANGLE, max_cells=18, prior=prior)


def calc_box_by_linear_program(fraction: np.ndarray, obj: GridObject) -> np.ndarray:
    # Charnes and Cooper: y = m/sum(m), t = 1/sum(m); the extreme of y·p s.t. sum y = 1, k t/mu_max
    # <= y <= k t/mu_min.
    n, box = obj.n, np.empty((2, 2))
    upper = np.hstack([np.eye(n), -(fraction / obj.prior.friction_min)[:, None]])
    lower = np.hstack([-np.eye(n), (fraction / obj.prior.friction_max)[:, None]])
    equal = np.append(np.ones(n), 0.0)[None]
    for axis in (0, 1):
        for row, sign in ((0, 1.0), (1, -1.0)):
            cost = np.append(sign * obj.p_BC[:, axis], 0.0)
            found = linprog(cost, np.vstack([upper, lower]), np.zeros(2 * n), equal, [1.0])
            box[row, axis] = sign * found.fun
    return box


def test_center_of_mass_box_agrees_with_linear_programs() -> None:
    obj = make_object()
    for seed in range(5):
        fraction = np.random.default_rng(seed).dirichlet(np.ones(obj.n))
        np.testing.assert_allclose(
            calc_center_of_mass_box(fraction, obj),
            calc_box_by_linear_program(fraction, obj),
            atol=1e-9,
        )


def make_posterior(obj: GridObject, learned: int) -> Posterior:
    n = obj.n
    prior = np.eye(n + 1)
    after = prior.copy()
    after[range(learned), range(learned)] = 0.01
    return Posterior(np.zeros(n + 1), after, prior)


def test_counts_learned_directions_and_spans_the_rest() -> None:
    obj = make_object()
    params = CellParameters.uniform(obj)
    report = calc_identifiability(Model(obj, params), make_posterior(obj, 5))
    assert report.null_space.shape[1] == obj.n
    np.testing.assert_allclose(
        report.null_space @ report.null_space.T, np.eye(len(report.null_space)), atol=1e-9
    )
    np.testing.assert_allclose(report.null_space[0], np.full(obj.n, obj.n**-0.5), atol=1e-9)
    # The common scale is no combination of the 13 directions left unknown, so 14 are.
    assert report.learned_directions == obj.n - 14
    assert (report.learned_share[:5] > 0.9).all() and (report.learned_share[5:] == 0).all()


def test_mass_bounds_hold_for_every_agreeing_mass_distribution() -> None:
    obj = make_object()
    fraction = np.random.default_rng(0).dirichlet(np.ones(obj.n))
    posterior = Posterior(
        np.append(np.log(fraction), 0.0), np.eye(obj.n + 1) * 0.01, np.eye(obj.n + 1)
    )
    params = CellParameters(2.0 * fraction, np.full(obj.n, 0.4))
    report = calc_identifiability(Model(obj, params), posterior)
    rng = np.random.default_rng(1)
    for _ in range(200):
        mass = fraction / rng.uniform(0.2, 0.8, obj.n)
        mass *= 2.0 / mass.sum()
        assert (mass >= report.mass_min - 1e-12).all() and (mass <= report.mass_max + 1e-12).all()
        center = mass @ obj.p_BC / 2.0
        assert (center >= report.center_of_mass_box[0] - 1e-12).all()
        assert (center <= report.center_of_mass_box[1] + 1e-12).all()


def test_statements_say_what_cannot_be_known() -> None:
    obj = make_object()
    report = calc_identifiability(Model(obj), make_posterior(obj, 3))
    assert sum("Not identifiable from these data" in text for text in report.statements) == 2
    # Of patterns and of cells it is said in one sentence how they go together.
    (told,) = [text for text in report.statements if "pattern" in text]
    cells = int((report.learned_share >= LEARNED_FRACTION).sum())
    assert f"determined {report.learned_directions} independent patterns" in told
    assert f"half of the variance from {cells} of the cells" in told
    assert "neighboring cells are supposed to be alike" in told
    nothing = calc_identifiability(Model(obj), make_posterior(obj, 0))
    assert any(
        "determined nothing of how the friction is spread" in text for text in nothing.statements
    )
    assert report.center_of_friction == pytest.approx([0.0, 0.0], abs=1e-9)
