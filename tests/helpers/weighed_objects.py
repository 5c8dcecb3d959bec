"""Made-up weighings of made-up truths, with just the noise that the estimate supposes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.geometry.se2 import make_rotation
from gridpush_drake.identification.absolute.estimate import AbsolutePrior, MassProblem, PoseNoise
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.absolute.masses import make_absolute_parameters
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest

CENTER = np.array([0.02, -0.01])
"""Where the pushes say that the center of mass is, m."""

CENTER_STD = np.array([0.015, 0.01])
"""How surely, m."""

SCALE_STD = 0.05
"""How surely the friction's scale is known from forces."""


@dataclass(frozen=True)
class Truth:
    """What is true of an object."""

    mass: float
    center: NDArray[np.float64]
    friction: float

    @property
    def unknowns(self) -> NDArray[np.float64]:
        return np.array([np.log(self.mass), *self.center, np.log(self.friction)])


def draw_truth(rng: np.random.Generator) -> Truth:
    """Draws a truth within the bounds of the default prior: not from the prior's normals."""
    prior = AbsolutePrior()
    return Truth(
        mass=float(np.exp(rng.uniform(*np.log(prior.mass)))),
        center=CENTER + CENTER_STD * rng.standard_normal(2),
        friction=float(np.exp(rng.uniform(*np.log(prior.friction)))),
    )


def weigh_exactly(
    obj: GridObject, truth: CellParameters
) -> tuple[NDArray[np.float64], CellParameters]:
    """What is learned of an object that was weighed and pushed without error.

    Returns:
        The mean (4,) of the estimate, and the parameters. Loads, mass and center of mass are true,
        and how friction is spread is not known.
    """
    k = truth.mass * truth.friction
    mass = truth.total_mass
    mean = Truth(mass, truth.center_of_mass(obj), float(k.sum()) / mass).unknowns
    return mean, make_absolute_parameters(Model(obj, truth), k / k.sum(), mean)


def make_problem(
    truth: Truth,
    rng: np.random.Generator,
    headings: tuple[float, ...] = (0.3, 0.3 + np.pi),
    presses: int = 2,
    lift: bool = True,
    noise: float = 1.0,
    force_std: float = 0.2,
    size: float = 1.0,
) -> MassProblem:
    """Makes weighings of an object whose edge lies along y, the table at x < 0.

    Args:
        truth: the object.
        rng: draws places and noise.
        headings: of the object, one for each rest over the edge, rad.
        presses: number of presses of each rest.
        lift: whether it was lifted, too.
        noise: factor on all noise, which the estimate supposes to be 1.
        force_std: of all forces, N.
        size: of the object; with 1, presses are up to 180 mm from the center of mass.
    """
    std = PoseNoise()
    weight = GRAVITY * truth.mass
    made = []
    poses = []
    for heading in headings:
        # The expected center of mass is 60 to 100 mm inside the edge, times the size.
        inside = size * rng.uniform(0.06, 0.1)
        p = np.array([-inside, size * rng.uniform(-0.1, 0.1)]) - make_rotation(heading) @ CENTER
        pose = np.array([*p, heading])
        seen = pose + noise * rng.standard_normal(3) * (std.position, std.position, std.angle)
        poses.append((pose, seen))
        b = -(p + make_rotation(heading) @ truth.center)[0]
        for _ in range(presses):
            a = size * rng.uniform(0.03, 0.08)
            y = size * rng.uniform(-0.02, 0.02)
            # The edge is off: the tip is as much nearer to it as the center is farther from it.
            e = noise * std.edge * rng.standard_normal()
            force = weight * (b + e) / (a - e)
            made.append(
                TiltTest(
                    pose=seen,
                    place=np.array([a, y]),
                    force=force + noise * force_std * rng.standard_normal(),
                    edge_point=np.array([0.0, 0.4]),
                    edge_angle=0.0,
                    force_std=force_std,
                )
            )
    lifts = []
    if lift:
        pose, seen = poses[-1]
        place = np.array([size * 0.02, pose[1]])
        arm = pose[:2] + make_rotation(pose[2]) @ truth.center - place
        torque = weight * np.array([-arm[1], arm[0]])
        lifts.append(
            LiftTest(
                pose=seen,
                place=place,
                weight=weight + noise * force_std * rng.standard_normal(),
                torque=torque + noise * 0.02 * rng.standard_normal(2),
                weight_std=force_std,
            )
        )
    scale = GRAVITY * truth.mass * truth.friction
    force = ForceScale(scale * np.exp(noise * SCALE_STD * rng.standard_normal()), SCALE_STD, 5)
    return MassProblem(
        MassTestLog(tuple(made), tuple(lifts)), CENTER, np.diag(CENTER_STD**2), force
    )
