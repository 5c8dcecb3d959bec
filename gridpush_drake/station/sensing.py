"""What the station senses: where the object lies, by a camera, and where the finger's tip is, by the joints."""

from dataclasses import dataclass

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.scene.grid_object import GridObjectInPlant
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.arm_posture import TIP_FRAME
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.pusher_state_sensor import PusherStateSensor

LOST_BELOW = -0.01
"""z of the object's bottom in W below which the camera has lost it, m: it has left the table."""


@dataclass(frozen=True)
class Sensors:
    """What `AddSensors` put into a builder.

    Attributes:
        camera: sees the object, with noise.
        eye: sees it as it is, for display and judgement.
        tip: knows where the tip is and how it moves.
    """

    camera: PlanarPoseSensor
    eye: PlanarPoseSensor
    tip: PusherStateSensor


def AddSensors(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: PushScenario, object_in_plant: GridObjectInPlant
) -> Sensors:
    """Adds the sensors, and connects them to the plant."""
    camera, body = scenario.camera, object_in_plant.body.index()
    sensors = Sensors(
        builder.AddNamedSystem(
            "camera",
            PlanarPoseSensor(
                body,
                period=1 / camera.rate,
                position_noise=camera.position_noise,
                angle_noise=camera.angle_noise,
                lowest=LOST_BELOW,
                seed=scenario.seed,
            ),
        ),
        builder.AddNamedSystem("eye", PlanarPoseSensor(body, period=1 / camera.rate, lowest=LOST_BELOW)),
        builder.AddNamedSystem("tip_sensor", PusherStateSensor(plant.GetBodyByName(TIP_FRAME).index())),
    )
    tip = sensors.tip
    for sensor in (sensors.camera, sensors.eye, tip):
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    builder.Connect(plant.get_body_spatial_velocities_output_port(), tip.GetInputPort("body_spatial_velocities"))
    return sensors
