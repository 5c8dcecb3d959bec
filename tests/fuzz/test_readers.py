"""Whatever is in a file, a reader returns or raises a GridPushError of one line: nothing else, and soon."""

import io
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from PIL import Image

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, ObjectWarning, PushLogWarning
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.cmu import CmuImporter
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog
from gridpush_drake.station.schema.scenario_file import read_scenario
from tests.fuzz.mutations import broken
from tests.helpers.made_identifications import make_block, make_identification

MAX_MESSAGE = 1000
"""Characters: a message is a line to read, not the file once more."""

OBJECT = b"""\
name: block
outline: [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
holes: [[[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]]]
parts:
  - {label: 2, outline: [[0.02, -0.03], [0.06, -0.03], [0.06, 0.03], [0.02, 0.03]]}
max_cells: 30
total_mass: 1.2
center_of_mass: {at: [0.0, 0.001], std: 3e-3}
friction: {prior: 0.3, min: 0.1, max: 0.9}
contact_friction: {prior: 0.45, std: 0.1}
pusher: {radius: 0.004}
"""

CELLS = b"""\
outline: [[0.0, 0.0], [0.02, 0.0], [0.02, 0.01], [0.0, 0.01]]
cells: {size: 0.01, centers: [[0.005, 0.005], [0.015, 0.005]], labels: [1, 2]}
"""

SCENARIO = b"""\
_base: &base {rate: 30.0, position_noise: 5e-4}
version: 1
object: claw_hammer
object_pose: [0.6, 0.0, 0.0]
object_height: 0.03
base: free
directives:
  - add_directives: {file: package://gridpush_drake/scenes/iiwa_push.dmd.yaml}
  - add_frame: {name: eye, X_PF: {base_frame: world, rotation: !Rpy {deg: [0, 0, 90]}}}
finger: {push_height: 0.012, travel_height: 0.12}
pokes: {count: 8, test_count: 6, distance: [0.06, 0.1], speed: 0.03}
camera: {<<: *base, angle_noise: 0.003}
truth: {cell_mass: [0.1, 1.0], friction_by_part: false, parts: [{label: 1, cell_mass: null}]}
simulation: {time_step: 0.002, stiction_tolerance: 1e-4}
workspace: {x: [0.42, 0.8], y: [-0.4, 0.4]}
seed: 3
"""

LOG = b"""\
push,t,tip_x,tip_y,object_x,object_y,object_theta,force_x,force_y
a,0,-0.02,0.034,0,0,0,0,0
a,0.5,-0.02,0.02,,,,0.1,1.0
a,1,-0.02,0.01,0.001,-0.02,0.2,0.1,1.0
b,5,0.02,-0.034,0,0,-0.2,0,0
b,6,0.02,-0.01,0.001,0.02,0.1,,
"""

WEIGHINGS = b"""\
kind,object_x,object_y,object_theta,place_x,place_y,force,edge_x,edge_y,edge_angle,torque_x,torque_y,force_std
press,-0.06,0.01,0.3,0.05,0.0,4.2,0.0,0.5,0.0,,,0.1
lift,-0.06,0.01,0.3,0.02,0.0,6.7,,,,0.1,-0.2,
"""

PLAIN_PGM = b"P2 # a mask\n8 6\n255\n" + b"\n".join(
    [b"0 0 0 0 0 0 0 0", *[b"0 1 1 1 2 2 2 0"] * 4, b"0 0 0 0 0 0 0 0"]
)
RAW_PGM = b"P5\n8 6 255\n" + bytes([0] * 8 + [0, 1, 1, 1, 2, 2, 2, 0] * 4 + [0] * 8)


def make_png() -> bytes:
    labels = np.zeros((12, 16), np.uint8)
    labels[2:10, 2:14], labels[2:10, 8:14] = 1, 2
    buffer = io.BytesIO()
    Image.fromarray(labels).save(buffer, "png")
    return buffer.getvalue()


def make_cmu() -> bytes:
    pose, tool = "0 0 0 1 0 0 0", "{t} {x} 0 0 1 0 0 0"
    rows = [tool.format(t=0.1 * i, x=i) for i in range(5)]
    return "\n".join(["1", pose, pose, "2", "0 0 0", "1 0.1 0.2", "5", *rows]).encode() + b"\n"


@pytest.fixture(scope="module")
def block():
    return make_block()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def model_text(place):
    path = place / "whole.yaml"
    write_model(path, make_identification())
    return path.read_bytes()


def few(count: int) -> settings:
    """The same `count` examples in every run, however long they take."""
    return settings(
        max_examples=count, derandomize=True, deadline=None, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip


def survives(path, text, read) -> None:
    """Reads `text` as a file: it is read, or refused in one line that names the file."""
    path.write_bytes(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for doubt in (ObjectWarning, PushLogWarning):
            warnings.simplefilter("ignore", doubt)
        try:
            read(path)
        except GridPushError as error:
            assert str(path) in str(error) or path.stem in str(error)
            assert "\n" not in str(error) and len(str(error)) < MAX_MESSAGE + len(str(path))


def read_and_push(path) -> None:
    obj = GridObject.from_yaml(path)
    simulate(Model(obj), make_push(obj), regime="quasi_static")


def make_push(obj: GridObject):
    from gridpush_drake.dynamics.push import Push

    return Push.on_outline(obj, 0.0, 0.1, 0.01, radius=0.005, speed=0.05)


@few(150)
@given(text=broken(OBJECT) | broken(CELLS))
def test_objects(place, text):
    survives(place / "object.yaml", text, GridObject.from_yaml)


@few(60)
@given(text=broken(OBJECT))
def test_objects_that_are_read_can_be_pushed(place, text):
    survives(place / "object.yaml", text, read_and_push)


@few(60)
@given(data=broken(b"") | broken(SCENARIO))
def test_scenarios(place, data):
    survives(place / "scenario.yaml", data, read_scenario)


@few(150)
@given(text=broken(LOG))
def test_push_logs(place, block, text):
    def read(path) -> None:
        predict(Model(block), PushLog.read_csv(path, require_final=False))

    survives(place / "pushes.csv", text, read)


@few(100)
@given(text=broken(WEIGHINGS))
def test_weighings(place, text):
    survives(place / "weighings.csv", text, MassTestLog.read_csv)


@few(150)
@given(text=broken(PLAIN_PGM) | broken(RAW_PGM) | broken(make_png()))
def test_masks(place, text):
    survives(
        place / "mask.pgm",
        text,
        lambda path: GridObject.from_mask(path, meters_per_pixel=0.01, max_cells=20),
    )


@few(100)
@given(text=broken(make_cmu()))
def test_cmu_logs(place, text):
    survives(place / "cmu.txt", text, CmuImporter().read)


@few(40)
@given(data=broken(b"x"))
def test_models_of_any_text(place, data):
    survives(place / "model.yaml", data, read_model)


def test_models(place, model_text):
    @few(60)
    @given(text=broken(model_text))
    def run(text):
        survives(place / "model.yaml", text, read_model)

    run()
