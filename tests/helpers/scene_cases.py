"""Rows of objects to be pushed through each other, and scenes as functions of all they depend on."""

from typing import NamedTuple

import numpy as np

from gridpush_drake.dynamics.bodies import DEFAULT_PAIR_FRICTION, Bodies
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.geometry.polygons import hull_of
from gridpush_drake.geometry.se2 import rotate, transform_shape
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.loop_run import run_loop
from gridpush_drake.planning.scene.joint_loop import STILL_WORLD, JointLoop
from tests.helpers.random_pushes import make_random_contents
from tests.helpers.shapes import make_shape

RADIUS = 0.01
SPACING = 0.001
CLEARANCE = 1e-4


class Layout(NamedTuple):
    """Objects, and where they lie, (N, 3)."""

    bodies: Bodies
    poses: np.ndarray

    @classmethod
    def of(cls, placed, pair_friction=DEFAULT_PAIR_FRICTION):
        """Of (object, parameters, pose) each; the pose is the origin by default."""
        objects = [each[0] for each in placed]
        poses = [each[2] if len(each) > 2 else np.zeros(3) for each in placed]
        bodies = Bodies(objects, [each[1] for each in placed], None, pair_friction)
        return cls(bodies, np.array(poses, dtype=float))

    @property
    def objects(self):
        return self.bodies.objects

    @property
    def params(self):
        return self.bodies.parameters

    def with_poses(self, poses):
        return self._replace(poses=np.array(poses, dtype=float))

    def simulate(self, push, **options):
        return simulate_together(self.bodies, push, self.poses, **options)


def run_task(world, planner, belief, **options):
    """Carries a task with several objects out in a world in which nothing moves by itself."""
    loop = JointLoop(planner, belief, options=STILL_WORLD, **options)
    return run_loop(loop, world)


TIPS = PusherShape.discs([(0.0, -0.02), (0.0, 0.02)], 0.004)
"""Two fingertips, 40 mm apart."""

PLATE = PusherShape.plate(0.06, 0.015, 0.002)
"""A plate, or a closed gripper."""

SKEW = 0.01
"""How far from flush the first object may lie before a shaped pusher, rad."""

TURN = 0.3
"""How far a shaped pusher turns on its way, rad."""


def make_row(seed, shapes, cells=20, pusher=None):
    """Objects side by side along x, at random angles, a millimeter apart at most, and a push along x.

    A disc pushes straight ahead, and another pusher, of a shape, turns on its way.
    """
    rng = np.random.default_rng(seed)
    bodies = []
    taken = None
    for shape in shapes:
        obj = make_shape(shape, cells)
        pose = np.array([0.0, rng.uniform(-0.01, 0.01), rng.uniform(-np.pi, np.pi)])
        if pusher is not None and not bodies:
            # the longest side lies almost flush before a shaped pusher, in front of its middle
            hull = hull_of(obj.edges.start)
            sides = np.roll(hull, -1, axis=0) - hull
            side = int(np.argmax(np.linalg.norm(sides, axis=1)))
            pose[2] = -np.pi / 2 - np.arctan2(sides[side, 1], sides[side, 0])
            pose[2] += rng.uniform(-SKEW, SKEW)
            pose[1] = -rotate(pose[2], hull[side] + sides[side] / 2)[1]
        while taken is not None and taken.distance(transform_shape(pose, obj.outline)) == 0:
            pose[0] += SPACING
        placed = transform_shape(pose, obj.outline)
        taken = placed if taken is None else taken.union(placed)
        bodies.append((obj, make_random_contents(rng, obj), pose))
    first = transform_shape(bodies[0][2], bodies[0][0].outline)
    middle = 0.5 * (first.bounds[1] + first.bounds[3])
    layout = Layout.of(bodies, rng.uniform(0.1, 0.5))
    if pusher is not None:
        front = pusher.core[:, 0].max() + pusher.radius
        start = np.array([first.bounds[0] - front - CLEARANCE, 0.0])
        center = start + (0.0, rng.choice([-1, 1]) * 0.05 / TURN)
        angle = TURN * np.sign(center[1])
        return layout, Push.about(center, angle, shape=pusher, start=start, duration=1.0)
    start = np.array([first.bounds[0] - RADIUS - CLEARANCE, middle])
    return layout, Push(start, (0.05, 0.0), 1.0, RADIUS)


class SceneCase:
    """A push of a scene, as a function of everything that its poses depend on."""

    def __init__(self, scene, push, steps, spin="coupled", law="isotropic"):
        self.scene = scene
        self.push = push
        self.times = np.linspace(0.0, push.duration, steps + 1)
        self.physics = Physics(law, spin=spin)
        self.result = self.run(gradients=True)
        self.switched = False

    def run(
        self,
        *,
        gradients=False,
        turn=0.0,
        stretch=0.0,
        yaw=0.0,
        twist=0.0,
        center=(0, 0),
        **changed,
    ):
        """Simulates with some of what `blocks` lists changed; notes a change of modes."""
        scene = self.scene
        n = len(scene.bodies)
        bodies = []
        for b in range(n):
            params = scene.params[b]
            bodies.append(
                (
                    scene.objects[b],
                    CellParameters(
                        changed.get(f"mass {b}", params.mass),
                        changed.get(f"friction {b}", params.friction),
                        float(changed.get("contact_friction", self.contact_friction)[b]),
                        patch_ratio=params.patch_ratio,
                    ),
                    scene.poses[b] + changed.get("pose", np.zeros((n, 3)))[b],
                )
            )
        pairs = np.zeros((n, n))
        pairs[np.triu_indices(n, 1)] = changed.get("pair_friction", self.pair_friction)
        c, s = np.cos(turn), np.sin(turn)
        path = self.push.xy - self.push.xy[0]
        length = self.push.length
        start = self.push.start + changed.get("start", np.zeros(2))
        xy = start + (1 + stretch / length) * path @ np.array([[c, s], [-s, c]])
        layout = Layout.of(bodies, pairs + pairs.T)
        layout = layout._replace(bodies=layout.bodies.with_physics(self.physics))
        push = Push.along(self.push.t, xy, self.push.radius)
        if self.push.shape is not None:
            turned = self.push.yaw - self.push.yaw[0]
            xy = xy + center - rotate(turned, np.array(center, dtype=float))
            angles = self.push.yaw + turn + yaw + twist * turned / turned[-1]
            push = Push.along(self.push.t, xy, shape=self.push.shape, yaw=angles)
        result = layout.simulate(push, gradients=gradients, times=self.times)
        if not gradients:
            same = result.modes.shape == self.result.modes.shape
            same = same and (result.modes == self.result.modes).all()
            same = same and (result.contact_bodies == self.result.contact_bodies).all()
            self.switched |= not same
        return result

    @property
    def contact_friction(self):
        return np.array([params.contact_friction for params in self.scene.params])

    @property
    def pair_friction(self):
        return self.scene.bodies.pair_friction[np.triu_indices(len(self.scene.bodies), 1)]

    def blocks(self):
        """Name, value and Jacobian of everything; the names are the keywords of `run`.

        Places are varied by what is added to them, so that all differences have the same step.
        """
        J = self.result.jacobian
        i, j = np.triu_indices(len(self.scene.bodies), 1)
        blocks = [
            ("contact_friction", self.contact_friction, J.contact_friction),
            ("pair_friction", self.pair_friction, J.pair_friction[..., i, j]),
            ("start", np.zeros(2), J.start),
            ("pose", np.zeros(self.scene.poses.shape), J.pose),
            ("turn", np.array(0.0), J.direction),
            ("stretch", np.array(0.0), J.length),
        ]
        if self.push.shape is not None:
            blocks.append(("yaw", np.array(0.0), J.yaw))
            blocks.append(("twist", np.array(0.0), J.turn))
            blocks.append(("center", np.zeros(2), J.center))
        ends = np.cumsum([obj.n for obj in self.scene.objects])[:-1]
        mass = np.split(J.mass, ends, axis=-1)
        friction = np.split(J.friction, ends, axis=-1)
        for b, params in enumerate(self.scene.params):
            blocks.append((f"mass {b}", params.mass, mass[b]))
            blocks.append((f"friction {b}", params.friction, friction[b]))
        return blocks
