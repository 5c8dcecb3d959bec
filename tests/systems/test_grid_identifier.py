"""The identifier in a Diagram: the LCP is the world, an ideal finger pokes it, a camera watches with noise."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.errors import IdentificationError, SimulationError
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.exploration import RandomPokeOptions
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest
from gridpush_drake.systems.learning import grid_identifier
from gridpush_drake.systems.learning.grid_identifier import GridIdentifier, IdentifierState
from tests.helpers.poke_diagram import PokeDiagram, make_poke_diagram
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

FAST = RandomPokeOptions(distance=(0.05, 0.08), speed=0.06)


def make_hammer(cells: int = 30) -> tuple[GridObject, CellParameters]:
    """A hammer whose head is four times as heavy a cell as its handle."""
    obj = make_shape("claw_hammer", cells)
    mass = np.where(obj.p_BC[:, 0] > 0.02, 4.0, 1.0)
    return obj, CellParameters(mass / mass.sum(), np.full(obj.n, 0.4), 0.3)


class Run:
    """A Diagram in its Simulator."""

    def __init__(self, parts: PokeDiagram) -> None:
        self.parts = parts
        self.simulator = Simulator(parts.diagram)
        self.root = self.simulator.get_mutable_context()

    def until(self, pushes: int, longest: float = 120.0) -> "Run":
        def done() -> bool:
            return self.eval("num_pushes")[0] >= pushes or self.root.get_time() > longest

        while not done():
            self.simulator.AdvanceTo(self.root.get_time() + 0.5)
        return self

    def eval(self, port: str, system: str = "identifier"):
        leaf = getattr(self.parts, system)
        return leaf.GetOutputPort(port).Eval(leaf.GetMyContextFromRoot(self.root))


@pytest.fixture(scope="module")
def cold() -> Run:
    obj, truth = make_hammer()
    return Run(make_poke_diagram(obj, truth, pokes=4, seed=1, style=FAST, warm_start=False)).until(
        4
    )


def test_learns_what_it_has_never_seen(cold):
    obj, truth = make_hammer()
    held_out = make_pokes(obj, truth, 10, 99, observations=1, length=0.1)
    found = CellParameters(
        cold.eval("mass"), cold.eval("friction"), float(cold.eval("contact_friction")[0])
    )
    errors = [
        calc_mean_cell_error(Model(obj, p, QUASI_STATIC), held_out)
        for p in (CellParameters.uniform(obj), found)
    ]
    assert errors[1] < errors[0] / 3 and errors[1] < 0.003, errors
    miss = cold.eval("center_of_mass") - truth.center_of_mass(obj)
    covariance = cold.eval("center_of_mass_covariance").reshape(2, 2)
    assert np.linalg.norm(miss) < 0.006
    assert miss @ np.linalg.solve(covariance, miss) < 13.8, "beyond the 99.9 % ellipse"
    assert 0 < cold.eval("loss")[0] < 0.002
    assert (cold.eval("mass_std") > 0).all() and cold.eval("mass_std").shape == cold.eval(
        "friction_std"
    ).shape


def test_is_the_offline_answer_bit_for_bit(cold):
    log = cold.eval("push_log")
    assert len(log) == 4 and cold.eval("status", "executor").refused == 0
    offline = identify(Model(cold.parts.identifier.obj), log, seed=1)
    np.testing.assert_array_equal(cold.eval("mass"), offline.params.mass)
    np.testing.assert_array_equal(cold.eval("mass_std"), offline.std.mass)
    np.testing.assert_array_equal(
        cold.eval("identification").posterior.covariance, offline.posterior.covariance
    )


def test_csv_gives_the_same_answer(cold, tmp_path):
    path = tmp_path / "pushes.csv"
    log = cold.eval("push_log")
    log.write_csv(path)
    back = PushLog.read_csv(path)
    for one, other in zip(log, back, strict=True):
        assert one.name == other.name
        for name in ("t", "xy"):
            np.testing.assert_array_equal(getattr(one.push, name), getattr(other.push, name))
        for name in ("pose", "t_observed", "poses_observed"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    offline = identify(Model(cold.parts.identifier.obj), back, seed=1)
    np.testing.assert_array_equal(cold.eval("mass"), offline.params.mass)
    np.testing.assert_array_equal(
        cold.eval("identification").posterior.mean, offline.posterior.mean
    )


def test_log_holds_what_was_to_be_seen(cold):
    """First and last poses are averages of many looks: nearer to the world's than one look is."""
    obj, truth = make_hammer()
    exact = Run(make_poke_diagram(obj, truth, pokes=1, seed=1, noise=(0.0, 0.0), style=FAST)).until(
        1
    )
    (seen,) = exact.eval("push_log")
    np.testing.assert_allclose(seen.final_pose, exact.eval("pose", "world"), atol=1e-6)
    np.testing.assert_allclose(seen.pose, 0.0, atol=1e-12)
    noisy = cold.eval("push_log")[0]
    assert np.abs(noisy.pose[:2]).max() < 4 * 5e-4 / np.sqrt(30)
    assert seen.push.length == pytest.approx(
        exact.parts.policy.pokes.options.clearance + 0.065, abs=0.016
    )
    assert len(seen.t_observed) == 10
    problem = PushProblem(obj, PushLog((seen,)), truth, Physics(regime="inertial"))
    errors = problem.residuals(problem.unknowns(truth))[0].reshape(-1, 3)
    assert np.abs(errors).max() < 4e-4, (
        "poses belong to the tip's place at their time, with the camera's delay"
    )


@pytest.mark.slow
def test_weighings_and_forces_make_the_estimate_absolute(cold):
    """As `estimate_masses` does of what was learned from the pushes alone; older weighings are kept."""
    obj = cold.parts.identifier.obj
    log = cold.eval("push_log")
    pushed = identify(Model(obj), log, seed=1)
    press = TiltTest(np.zeros(3), np.array([0.1, 0.0]), 3.0, np.array([0.05, 0.0]), 0.0)
    lift = LiftTest(np.zeros(3), np.array([0.0, 0.1]), 6.0)
    system = GridIdentifier(obj, seed=1)
    state = replace(
        IdentifierState(), log=log, estimate=grid_identifier._make_estimate(pushed, log)
    )
    for weighings in (MassTestLog((press,)), MassTestLog((press,), (lift,))):
        state = system._weigh(state, weighings)
        expected = estimate_masses(pushed, weighings).absolute
        np.testing.assert_array_equal(state.estimate.found.absolute.mean, expected.mean)
        np.testing.assert_array_equal(state.estimate.center_of_mass, expected.center_of_mass)
        assert state.estimate.found.unweighed is pushed
    # Then the pushes are learned from once more, as from the files afterwards.
    system = GridIdentifier(obj, seed=1, warm_start=False)
    weighings = MassTestLog((press,), (lift,))
    learned = replace(state, considered=len(log), weighings=MassTestLog(), learned_with=0)
    assert not learned.is_behind
    due = system._weigh(learned, weighings)
    assert due.is_behind
    again = system._learn(due, 1.0)
    assert again.considered == len(log) and not again.is_behind

    found = identify(Model(obj), log, seed=1, weighings=weighings)
    offline = found.unweighed
    assert np.ptp(offline.params.friction) > 0
    np.testing.assert_array_equal(
        again.estimate.found.unweighed.params.friction, offline.params.friction
    )
    np.testing.assert_array_equal(again.estimate.found.params.mass, found.params.mass)
    np.testing.assert_array_equal(again.estimate.found.absolute.mean, found.absolute.mean)
    # A push that nothing could be learned from does not keep the others from being learned anew.
    without = replace(due, left_out=(log[-1].name,))
    again = system._learn(without, 1.0)
    assert not again.is_behind and again.estimate.found.push_names == offline.push_names[:-1]
    # After the object became another one, what was weighed before does not count.
    changed = replace(state, weighed_before=(1, 1))
    assert not len(changed.counting_mass_tests)
    again = system._weigh(changed, MassTestLog((press, press), (lift,)))
    assert (again.estimate.found.absolute.presses, again.estimate.found.absolute.lifts) == (1, 0)


def test_warm_start_ends_at_the_same_answer(cold):
    obj, truth = make_hammer()
    warm = Run(make_poke_diagram(obj, truth, pokes=4, seed=1, style=FAST)).until(4)
    one, other = warm.eval("identification"), cold.eval("identification")
    for a, b in zip(warm.eval("push_log"), cold.eval("push_log"), strict=True):
        np.testing.assert_array_equal(a.poses_observed, b.poses_observed)
    std = np.sqrt(np.diag(other.posterior.covariance))
    assert (np.abs(one.posterior.mean - other.posterior.mean) < 0.3 * std).all()


def test_clone_learns_the_same():
    obj, truth = make_hammer(12)
    run = Run(make_poke_diagram(obj, truth, pokes=2, seed=3, style=FAST)).until(1)
    run.simulator.AdvanceTo(run.root.get_time() + 3.0)
    clone = Simulator(run.parts.diagram, run.root.Clone())
    end = run.root.get_time() + 5.0
    clone.AdvanceTo(end)
    run.simulator.AdvanceTo(end)
    context = run.parts.identifier.GetMyContextFromRoot(clone.get_context())
    assert run.eval("num_pushes")[0] == 2
    for name in ("mass", "mass_std", "center_of_mass", "loss", "num_pushes"):
        np.testing.assert_array_equal(
            run.parts.identifier.GetOutputPort(name).Eval(context), run.eval(name)
        )


def test_later_pushes_are_logged_but_not_learned_from():
    obj, truth = make_hammer(12)
    run = Run(
        make_poke_diagram(obj, truth, pokes=2, seed=3, style=FAST, max_learning_pushes=1)
    ).until(1)
    mass = run.eval("mass")
    run.until(2)
    assert run.eval("num_pushes")[0] == 2 and len(run.eval("push_log")) == 2
    assert run.eval("identification").push_names == ("push_1",)
    np.testing.assert_array_equal(run.eval("mass"), mass)


def test_the_prior_is_made_when_it_is_first_looked_at(monkeypatch):
    obj, _ = make_hammer()
    made = []

    def describe(*arguments):
        made.append(arguments)
        return describe_prior(*arguments)

    monkeypatch.setattr("gridpush_drake.systems.learning.grid_identifier.describe_prior", describe)
    system = GridIdentifier(obj)
    context = system.CreateDefaultContext()
    assert not made
    for name in ("mass", "friction_std", "identification"):
        system.GetOutputPort(name).Eval(context)
    assert len(made) == 1


def test_prior_before_the_first_push():
    obj, _ = make_hammer()
    system = GridIdentifier(obj)
    context = system.CreateDefaultContext()
    prior = describe_prior(obj)

    def look(name: str):
        return system.GetOutputPort(name).Eval(context)

    uniform = CellParameters.uniform(obj)
    np.testing.assert_allclose(look("mass"), uniform.mass, rtol=1e-12)
    np.testing.assert_array_equal(look("friction"), uniform.friction)
    np.testing.assert_array_equal(look("mass_std"), prior.std.mass)
    np.testing.assert_allclose(look("center_of_mass"), obj.p_BC.mean(axis=0), atol=1e-12)
    assert look("num_pushes")[0] == 0 and np.isnan(look("loss")[0])
    assert look("identification").push_names == () and len(look("push_log")) == 0
    assert np.linalg.eigvalsh(look("center_of_mass_covariance").reshape(2, 2)).min() > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "method"),
        ({"regime": "fast"}, "regime"),
        ({"period": 0.0}, "period"),
        ({"max_learning_pushes": -1}, "max_learning_pushes"),
    ],
)
def test_bad_arguments_are_refused(options: dict, message: str) -> None:
    with pytest.raises((IdentificationError, SimulationError), match=message):
        GridIdentifier(make_hammer(12)[0], **options)


@pytest.mark.slow
def test_a_load_that_was_changed_is_learned_anew(monkeypatch):
    obj, truth = make_hammer()
    handle = np.where(obj.p_BC[:, 0] > 0.02, 1.0, 12.0)
    swapped = CellParameters(handle / handle.sum(), truth.friction, truth.contact_friction)
    noise = (5e-4, 3.5e-3)
    before = make_pokes(obj, truth, 5, 7, noise=noise)
    after = make_pokes(obj, swapped, 4, 8, noise=noise)
    coming = iter([*before, *after])
    monkeypatch.setattr(
        grid_identifier,
        "make_observed_push",
        lambda episode, obj, radius, name, options: replace(next(coming), name=name),
    )
    identifier = GridIdentifier(obj, period=0.1)
    state = IdentifierState()
    records = []
    for number in range(len(before) + len(after)):
        state = identifier._learn(identifier._log_push(state, object()), float(number))
        records.append(state.innovations)
    assert [record.total for record in records[:5]] == [0] * 5
    forgotten = state.innovations.forgotten
    assert forgotten >= 5 and state.innovations.total >= 2
    # The estimate is that of the later pushes alone, as `identify` makes it of them.
    assert len(state.log) == 9 and not state.message
    offline = identify(Model(identifier.obj), state.log[forgotten:])
    assert state.estimate.found.push_names == offline.push_names
    np.testing.assert_allclose(
        state.estimate.found.posterior.mean, offline.posterior.mean, atol=0.2
    )
