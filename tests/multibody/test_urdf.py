"""A grid object as a URDF file: Drake's parser makes the same body of it as of the SDFormat file."""

import numpy as np
from pydrake.geometry import Box, Sphere

from gridpush_drake.multibody.sdformat import WriteSdf, WriteUrdf
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.plant_object import parse_sdf
from tests.helpers.shapes import make_shape


def describe(path, name):
    """The body's spatial inertia, and each collision's place, size, friction and stiffness."""
    plant, scene_graph = parse_sdf(path)
    body, inspector = plant.GetBodyByName(name), scene_graph.model_inspector()
    rows = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape, properties = inspector.GetShape(geometry), inspector.GetProximityProperties(geometry)
        assert isinstance(shape, Box | Sphere)
        size = shape.size() if isinstance(shape, Box) else np.full(3, shape.radius())
        friction = properties.GetProperty("material", "coulomb_friction")
        rows.append(
            [
                *inspector.GetPoseInFrame(geometry).GetAsMatrix4().ravel(), *size,
                friction.static_friction(), friction.dynamic_friction(),
                properties.GetProperty("material", "point_contact_stiffness"),
                properties.GetProperty("material", "hunt_crossley_dissipation"),
            ]
        )  # fmt: skip
    inertia = body.CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext()).CopyToFullMatrix6()
    return plant.num_positions(), inertia, np.array(rows)


def test_is_the_body_of_the_sdformat_file(tmp_path):
    obj, rng = make_shape("claw_hammer", 60), np.random.default_rng(5)
    params = CellParameters(rng.uniform(0.002, 0.02, obj.n), rng.uniform(0.2, 0.6, obj.n), 0.45)
    WriteUrdf(obj, params, tmp_path / "hammer.urdf", height=0.04)
    WriteSdf(obj, params, tmp_path / "hammer.sdf", height=0.04)
    urdf, sdf = (describe(tmp_path / f"hammer.{kind}", obj.name) for kind in ("urdf", "sdf"))
    assert urdf[0] == sdf[0] == 7
    np.testing.assert_allclose(urdf[1], sdf[1], rtol=1e-9, atol=1e-15)
    assert len(urdf[2]) > obj.n
    np.testing.assert_allclose(urdf[2], sdf[2], rtol=1e-12, atol=1e-12)
