"""A table with an edge, a body on feet that can tip over it, and a finger that presses: in MuJoCo.

The bodies are those of `bench.truth.sets`: rigid, on feet, with a flat underside that the edge
touches. Nothing in them knows what `identification.absolute.estimate` supposes. The finger is held
by springs along x, y and z, as an arm under impedance control is, and its force is measured with
noise and an offset. `bench.tilt_tests.world` has the same in Drake, which takes some ten times as
long.
"""

from typing import TYPE_CHECKING

import numpy as np

from gridpush_drake.bench.tilt_tests.world import (
    FINGER_DAMPING,
    FINGER_MASS,
    FINGER_STIFFNESS,
    MAX_PRESS_TIME,
    TIP_RADIUS,
    TiltTestNoise,
    TiltTestRun,
    draw_believed_target,
)
from gridpush_drake.bench.truth.mujoco_world import (
    BODY_HEIGHT,
    EDGE_BEARING,
    EDGE_RADIUS,
    EDGE_TIME_STEP,
    PLATE_HALF,
    TruthBody,
    calc_poses,
    calc_tilts,
    describe_feet,
    describe_inertia,
    describe_options,
    describe_pairs,
    describe_plates,
)
from gridpush_drake.bench.worlds.mujoco_plant import set_springs
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.mjcf import TABLE_HALF
from gridpush_drake.planning.weighing.press import (
    PressOptions,
    PressSample,
    PressState,
    PressTarget,
    advance_press,
)

if TYPE_CHECKING:
    import mujoco

SAMPLE_PERIOD = 0.01
"""Time between two samples of a press, s."""

TIP_SINKAGE = 2e-5
"""Distance by which the tip would sink into the body if it pressed with the body's weight, m."""

TIP_FRICTION = 0.5
"""Friction of the tip on the body."""

PARKED_HEIGHT = 0.3
"""Height of the tip while nothing is pressed, m."""

APPROACH_HEIGHT = 0.01
"""Height over its hovering place at which the tip begins a press, m."""

BODY_ENTRIES = slice(0, 7)
"""Entries of the positions that are the body's: place and quaternion."""

TIP_ENTRIES = slice(7, 10)
"""Entries of the positions that are the tip's place."""

TIP_RATES = slice(6, 9)
"""Entries of velocities and forces that are the tip's."""


class MujocoScale:
    """A rigid body on a table whose edge is x = 0, which a finger presses.

    Attributes:
        body: the body.
        height: height of its top above its feet's ends, m.
        options: how presses are made.
        noise: of what is measured.
    """

    def __init__(
        self,
        body: TruthBody,
        *,
        options: PressOptions | None = None,
        noise: TiltTestNoise | None = None,
        seed: int = 0,
    ) -> None:
        """Builds the scene.

        Args:
            body: the body; its feet are made as stiff as at a table's edge.
            options: how presses are made.
            noise: of what is measured.
            seed: seed of all noise.

        Raises:
            MissingExtraError: MuJoCo is not installed.
        """
        self._mujoco = import_extra("mujoco", "bench")
        self.body = body.harden()
        self.height = BODY_HEIGHT
        self.options = options or PressOptions()
        self.noise = noise or TiltTestNoise()
        self._rng = np.random.default_rng((seed, 15))
        self._model = self._mujoco.MjModel.from_xml_string(_describe(self.body))
        _set_contacts(self._model, self.body)
        self._data = self._mujoco.MjData(self._model)

    def put(self, pose: Array) -> None:
        """Puts the body down at a pose (3,), m and rad, with the finger far above."""
        x, y, theta = pose
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[BODY_ENTRIES] = x, y, 0.0, np.cos(theta / 2), 0.0, 0.0, np.sin(theta / 2)
        self._move_finger(np.array([x, y, PARKED_HEIGHT]))

    def let_pass(self, time: float) -> None:
        """Lets time pass, s."""
        for _ in range(round(time / SAMPLE_PERIOD)):
            self._step()

    def observe(self) -> Array:
        """Looks at the body: (3,) q_WB with noise, m and rad."""
        std = (self.noise.position, self.noise.position, self.noise.angle)
        seen: Array = self.read_pose() + std * self._rng.standard_normal(3)
        return seen

    def read_pose(self) -> Array:
        """Reads where the body truly is, (3,) q_WB, m and rad; for judges only."""
        return calc_poses(self._data.qpos[None, BODY_ENTRIES])[0]

    def read_tilt(self) -> float:
        """Reads how far the body is truly tilted, rad; for judges only."""
        return float(calc_tilts(self._data.qpos[None, BODY_ENTRIES])[0])

    def press(self, target: PressTarget) -> TiltTestRun:
        """Presses where the robot wants to, and goes up again.

        Args:
            target: where to press, by the true edge. The robot's own idea of the edge is off by
                noise, and is in what is returned.
        """
        before = self.read_pose()
        believed = draw_believed_target(target, self.noise, self._rng)
        offset = self.noise.offset * self._rng.standard_normal(3)
        self._move_finger(target.hover + [0.0, 0.0, self.options.clearance + APPROACH_HEIGHT])
        state = PressState()
        tilt = 0.0
        begin = self._data.time
        while not state.over and self._data.time < begin + MAX_PRESS_TIME:
            felt = self._data.qfrc_constraint[TIP_RATES] + offset
            sample = PressSample(
                time=float(self._data.time),
                tip=self._data.qpos[TIP_ENTRIES].copy(),
                force=felt + self.noise.force * self._rng.standard_normal(3),
            )
            state = advance_press(believed, self.options, state, sample)
            assert state.command is not None
            self._data.ctrl[:] = state.command
            self._step()
            tilt = max(tilt, self.read_tilt())
        moved = float(np.linalg.norm(self.read_pose()[:2] - before[:2]))
        time = float(self._data.time - begin)
        return TiltTestRun(state=state, target=believed, max_tilt=tilt, moved=moved, time=time)

    def _move_finger(self, place: Array) -> None:
        """Puts the finger at rest at a place (3,), m, and keeps it there."""
        self._data.qpos[TIP_ENTRIES] = place
        self._data.qvel[TIP_RATES] = 0.0
        self._data.ctrl[:] = place
        self._mujoco.mj_forward(self._model, self._data)

    def _step(self) -> None:
        """Lets a period pass."""
        self._mujoco.mj_step(self._model, self._data, round(SAMPLE_PERIOD / EDGE_TIME_STEP))


def _describe(body: TruthBody) -> str:
    """Describes the scene in MJCF.

    Feet f touch the table, plates p of the underside touch its rim, and plates t of the top the
    tip.
    """
    obj = body.obj
    friction = body.params.friction
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    joints = "".join(f'<joint name="{n}" type="slide" axis="{axis}"/>' for n, axis in axes.items())
    motors = "".join(
        f'<position joint="{n}" kp="{FINGER_STIFFNESS}" kv="{FINGER_DAMPING}"/>' for n in axes
    )
    geoms = (
        describe_feet(body.feet, body.gap)
        + describe_plates(obj, "p", body.bottom + PLATE_HALF)
        + describe_plates(obj, "t", BODY_HEIGHT - PLATE_HALF)
    )
    pairs = (
        describe_pairs("foot", "table", "f", friction[body.cell])
        + describe_pairs("edge", "rim", "p", friction)
        + describe_pairs("tip", "tip", "t", [TIP_FRICTION] * obj.n)
    )
    return f"""
<mujoco>
  {describe_options(EDGE_TIME_STEP)}
  <worldbody>
    <geom name="table" type="box" pos="{-TABLE_HALF} 0 -0.5"
     size="{TABLE_HALF} {TABLE_HALF} 0.5"/>
    <geom name="rim" type="capsule" size="{EDGE_RADIUS}"
     fromto="0 {-TABLE_HALF} {-EDGE_RADIUS} 0 {TABLE_HALF} {-EDGE_RADIUS}"/>
    <body><freejoint/>{describe_inertia(obj, body.params)}{geoms}</body>
    <body gravcomp="1">
      <inertial pos="0 0 0" mass="{FINGER_MASS}" diaginertia="1e-3 1e-3 1e-3"/>{joints}
      <geom name="tip" type="sphere" size="{TIP_RADIUS}"/>
    </body>
  </worldbody>
  <contact>{pairs}</contact>
  <actuator>{motors}</actuator>
</mujoco>"""


def _set_contacts(model: "mujoco.MjModel", body: TruthBody) -> None:
    """Gives feet, rim and tip their stiffness."""
    weight = np.array([body.params.total_mass * GRAVITY])
    own, finger = (float(value) for value in model.body_invweight0[1:, 0])
    set_springs(model, "foot", body.load, body.sinkage, own)
    set_springs(model, "edge", weight / EDGE_BEARING, body.sinkage, own)
    set_springs(model, "tip", weight, TIP_SINKAGE, own + finger)
