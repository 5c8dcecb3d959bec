"""The `camera` of a scenario: how the robot sees where the object is."""

from math import radians
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, InstanceOf, PlainSerializer
from pydrake.common.yaml import yaml_dump as dump_tagged
from pydrake.common.yaml import yaml_dump_typed, yaml_load_data, yaml_load_typed
from pydrake.systems.sensors import CameraConfig as DrakeCameraConfig

from gridpush_drake.errors import ScenarioError
from gridpush_drake.station.schema.fields import (
    MAX_DELAY,
    YAML_REFUSALS,
    Config,
    Number,
    check_keys,
    not_negative,
    positive,
)

DEFAULT_RGBD: dict[str, Any] = {
    "width": 640,
    "height": 480,
    "focal": {"y": 42.0, "_tag": "!FovDegrees"},
    "clipping_near": 0.1,
    "clipping_far": 5.0,
    "z_near": 0.1,
    "z_far": 5.0,
    "X_PB": {
        "translation": [0.6, -0.38, 1.0],
        "rotation": {"deg": [-162.768, 0.0, 1.848], "_tag": "!Rpy"},
    },
    "background": {"rgba": [0.30, 0.31, 0.33, 1.0]},
    "output_delay": 0.0,
}
"""The color and depth camera of a scenario that does not describe it. It stands beside the table
and looks down on it at an angle."""

NEW_POSE = (
    "is Drake's X_PB now; expected X_PB: {translation: [x, y, z], rotation: !Rpy {deg: [...]}}"
)

RENAMED_RGBD = {
    "fov_y": "is Drake's focal now; expected focal: !FovDegrees {y: DEGREES}",
    "position": NEW_POSE,
    "target": NEW_POSE,
    "latency": "is Drake's output_delay now, in s",
    "fps": "is not read here; camera.rate says it, in Hz",
    **{
        name: f"stands above now; expected camera.{name}"
        for name in ("depth_noise", "depth_edge", "color_noise", "exposure_noise")
    },
}
"""What became of keys that older scenarios had, for the message that refuses them; also keys of
Drake's CameraConfig that stand elsewhere in a scenario."""

RGBD_KEYS = (*DEFAULT_RGBD, "center_x", "center_y", "X_BC", "X_BD")
"""Keys of Drake's CameraConfig that a scenario may have. The others say nothing here: the station
has a renderer of its own, and takes all images."""

MIN_SIDE = 64
"""Least width and height of a picture, pixels."""

MAX_SIDE = 4096
"""Greatest width and height of a picture, pixels."""


def _read_rgbd(data: Any) -> DrakeCameraConfig:
    """Makes Drake's CameraConfig of YAML data, or checks one that is made already.

    Raises:
        ScenarioError: a key is unknown, or a value will not do.
    """
    place = "camera.rgbd"
    data = _dump_rgbd(data) if isinstance(data, DrakeCameraConfig) else data
    for key in data if isinstance(data, dict) else ():
        if key in RENAMED_RGBD:
            raise ScenarioError(f"{place}.{key}: {RENAMED_RGBD[key]}")
    check_keys(data, DrakeCameraConfig, place)
    for key in data:
        if key not in RGBD_KEYS:
            raise ScenarioError(
                f"{place}.{key}: says nothing here; expected one of {', '.join(RGBD_KEYS)}"
            )
    try:
        config: DrakeCameraConfig = yaml_load_typed(
            schema=DrakeCameraConfig, data=dump_tagged(DEFAULT_RGBD | data)
        )
        config.MakeCameras()
    except YAML_REFUSALS as error:
        raise ScenarioError(f"{place}: {' '.join(str(error).split())}") from error
    for name in ("width", "height"):
        side = getattr(config, name)
        if not MIN_SIDE <= side <= MAX_SIDE:
            raise ScenarioError(
                f"{place}.{name} is {side}; expected {MIN_SIDE} to {MAX_SIDE} pixels"
            )
    if not 0 <= config.output_delay <= MAX_DELAY:
        raise ScenarioError(
            f"{place}.output_delay is {config.output_delay}; expected 0 to {MAX_DELAY:g} s"
        )
    return config


def _dump_rgbd(config: DrakeCameraConfig) -> dict[str, Any]:
    """Makes YAML data of Drake's CameraConfig, with tags under _tag, as Drake's reader has them."""
    data = yaml_load_data(yaml_dump_typed(config, schema=DrakeCameraConfig))
    return {key: data[key] for key in RGBD_KEYS if key in data}


CameraKind = Literal["ideal", "rgbd"]
"""Kind of a scenario's camera, see `CameraConfig.kind`."""

RGBD_RATE = 10.0
"""Greatest rate of the color and depth camera that `CameraConfig.use` puts in the place of another,
Hz. Each picture takes long to render."""


class CameraConfig(Config):
    """How the robot sees the object's pose. Noise is drawn from the scenario's seed.

    Attributes:
        kind: "ideal": the camera measures the true pose, with noise; "rgbd": pictures of color and
            depth are rendered, and the robot finds the object in the first of them, and its pose in
            all.
        rate: number of poses, or pictures, a second, Hz.
        position_noise: standard deviation of the noise of x and y, m; for an ideal camera.
        angle_noise: standard deviation of the noise of theta, rad; for an ideal camera.
        depth_noise: standard deviation of depth at a distance of 1 m, m. It grows with the square
            of the distance.
        depth_edge: if depth jumps by more than this between neighboring pixels, it is not measured
            there, m.
        color_noise: standard deviation of a color's value, of 255.
        exposure_noise: standard deviation of a picture's exposure, relative to the exposure.
        rgbd: the color and depth camera, as Drake's CameraConfig, of which `RGBD_KEYS` are read.
            `output_delay` is the time from a picture to its pose. `gridpush object --camera` reads
            the same description.
    """

    kind: Annotated[CameraKind, Field(description="one of ideal, rgbd")] = "ideal"
    rate: Annotated[Number, positive("Hz", low=0.1, high=1000.0)] = 30.0
    position_noise: Annotated[Number, not_negative("m")] = 0.0005
    angle_noise: Annotated[Number, not_negative("rad")] = radians(0.2)
    depth_noise: Annotated[Number, not_negative("m")] = 0.0015
    depth_edge: Annotated[Number, positive("m")] = 0.01
    color_noise: Annotated[Number, not_negative("of 255")] = 2.0
    exposure_noise: Annotated[Number, not_negative("a fraction")] = 0.02
    rgbd: Annotated[
        InstanceOf[DrakeCameraConfig],
        BeforeValidator(_read_rgbd),
        PlainSerializer(_dump_rgbd),
    ] = Field(default_factory=lambda: _read_rgbd({}), description="keys of Drake's CameraConfig")

    def use(self, kind: CameraKind) -> None:
        """Changes the kind of the camera; one that renders pictures takes them at a lower rate."""
        self.kind = kind
        if kind == "rgbd":
            self.rate = min(self.rate, RGBD_RATE)
