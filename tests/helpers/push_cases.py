"""Pushes to be differentiated, and the check of all their derivatives against central differences."""

import numpy as np

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import make_direction
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_pose
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.shapes import make_shape

STEPS = 30

GEOMETRY, PARAMETERS = (1e-6, 1e-7), (1e-4, 1e-5, 1e-6)
"""Relative steps of the differences, tried in turn: a long one may reach over a corner of the
outline, where the second derivative jumps, and a short one is lost in round-off."""

ROUND_OFF = 1e-12
"""m and rad, of a simulated pose."""


class PushCase:
    """A push along a sampled path, as a function of everything that its poses depend on."""

    def __init__(self, obj, params, pose, push, physics=None, **options):
        self.obj, self.params, self.pose = obj, params, pose
        self.t, self.path, self.radius = push.t, push.xy, push.radius
        self.physics = physics
        self.options = {"times": np.linspace(0, push.duration, STEPS + 1), **options}
        self.result = self.run(gradients=True)
        self.switched = False

    def run(self, *, gradients=False, turn=0.0, stretch=0.0, **changed):
        """Simulates with some of mass, friction, contact_friction, start, pose changed; notes a change of modes."""
        values = {
            "mass": self.params.mass,
            "friction": self.params.friction,
            "contact_friction": self.params.contact_friction,
            "start": self.path[0],
            "pose": self.pose,
            "push_height": self.params.push_height,
            **changed,
        }
        c, s = np.cos(turn), np.sin(turn)
        length = np.linalg.norm(np.diff(self.path, axis=0), axis=1).sum()
        xy = values["start"] + (1 + stretch / length) * (self.path - self.path[0]) @ np.array(
            [[c, s], [-s, c]]
        )
        contact_friction, push_height = (
            float(values["contact_friction"]),
            float(values["push_height"]),
        )
        params = CellParameters(values["mass"], values["friction"], contact_friction, push_height)
        push = Push.along(self.t, xy, self.radius)
        result = simulate(
            Model(self.obj, params, self.physics),
            push,
            values["pose"],
            gradients=gradients,
            **self.options,
        )
        if not gradients:
            self.switched |= bool((result.modes != self.result.modes).any())
        return result

    def blocks(self):
        """Name, value and Jacobian of everything, and the keyword by which `run` varies it."""
        J = self.result.jacobian
        shifted = (
            []
            if J.push_height is None
            else [("push_height", np.array(self.params.push_height), J.push_height)]
        )
        return [
            *shifted,
            ("mass", self.params.mass, J.mass),
            ("friction", self.params.friction, J.friction),
            ("contact_friction", np.array(self.params.contact_friction), J.contact_friction),
            ("start", self.path[0], J.start),
            ("pose", self.pose, J.pose),
            ("turn", np.array(0.0), J.direction),
            ("stretch", np.array(0.0), J.length),
        ]


def check_case(case, shape, seed):
    """Checks every block; where the sequence of contact modes differs within the stencil, there is no derivative."""
    skipped = 0
    for name, value, jacobian in case.blocks():
        if not np.any(np.abs(jacobian) > 1e-9):
            continue  # the block is zero to the accuracy of the solution: a stuck contact ignores its friction
        case.switched = False
        failures = []
        for step in (
            PARAMETERS
            if name in ("mass", "friction", "contact_friction", "push_height")
            else GEOMETRY
        ):
            size = max(np.abs(value).max(), 0.1 if name in ("turn", "stretch") else 0.0)
            floor = ROUND_OFF / (step * size) + 1e-6 * np.abs(jacobian).max()
            try:
                check_jacobian(
                    lambda x, name=name: case.run(**{name: x}).poses,
                    value, jacobian, step=step * (1 if np.any(value) else 0.1), order=4, rtol=1e-5, atol=floor,
                )  # fmt: skip
                break
            except AssertionError as error:
                failures.append(str(error))
        else:
            assert case.switched, f"{shape}, seed {seed}, {name}: {failures}"
            skipped += 1
    return skipped


def make_random_case(shape, seed, regime, spin, push_height=0.0, overhang=None):
    """A random curved push of a random object, which moves at the beginning where the seed is odd.

    With `overhang` that fraction of its length hangs over an edge whose direction is random.
    """
    rng = np.random.default_rng(seed)
    obj = make_shape(shape, 20)
    params, pose = make_random_contents(rng, obj), make_random_pose(rng)
    straight = make_random_push(rng, obj, pose, length=0.03, speeds=(0.02, 0.1, 0.3))
    t = np.linspace(0, straight.duration, 5)
    path = straight.tip_at(t)
    path[1:] += rng.normal(size=(4, 2)) * 1e-3
    moving = regime == "inertial" and seed % 2
    nu = rng.uniform(-1, 1, 3) * (0.05, 0.05, 1.0) if moving else np.zeros(3)
    options = {"velocity": nu, "physics": Physics(regime=regime, spin=spin)}
    if push_height or overhang:
        params = CellParameters(params.mass, params.friction, params.contact_friction, push_height)
    if overhang:
        options["table"] = make_table_edge(obj, pose, rng.uniform(0, 2 * np.pi), overhang)
    return PushCase(obj, params, pose, Push.along(t, path, straight.radius), **options)


def make_table_edge(obj, pose, angle, overhang):
    """A large table beyond whose edge, with its normal at an angle, a fraction of the object's length hangs."""
    normal, along = make_direction(angle), make_direction(angle + np.pi / 2)
    reached = obj.cells_at(pose) @ normal
    edge = reached.max() - overhang * np.ptp(reached)
    far = (edge - 2) * normal
    return np.array([edge * normal + along, far + along, far - along, edge * normal - along])


def make_notch_case(seed, regime):
    """A disc pushed into a V-notch, up to 50° askew."""
    rng = np.random.default_rng(seed)
    obj = make_shape("notched_block", 20)
    contents, pose = make_random_contents(rng, obj), make_random_pose(rng)
    params = CellParameters(contents.mass, contents.friction, rng.choice([0.02, 0.1, 0.3]))
    angle, radius = rng.uniform(-0.9, 0.9), 0.01
    start = np.array([-0.026 - radius * np.sqrt(2), rng.uniform(-0.004, 0.004)])
    way = np.outer(np.linspace(0, 0.03, 5), [np.cos(angle), np.sin(angle)])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    path = pose[:2] + (start + way) @ np.array([[c, s], [-s, c]])
    return PushCase(
        obj, params, pose, Push.along(np.linspace(0, 0.3, 5), path, radius), regime=regime
    )
