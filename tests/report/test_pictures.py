from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from gridpush_drake.dynamics.push import Push
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.report.draw import calc_round_length
from gridpush_drake.report.figures import draw_model, draw_motion, draw_object
from tests.helpers.made_identifications import make_block, make_identification


def motion():
    poses = np.linspace((0, 0, 0), (0.05, 0.02, 0.4), 30)
    return draw_motion(make_block(), Push((-0.1, 0), (0.1, 0), 1.0, 0.01), poses)


@pytest.mark.parametrize("draw", [lambda: draw_object(make_block()), lambda: draw_model(make_identification()), motion])
def test_is_a_png_with_something_on_it(draw):
    with Image.open(BytesIO(draw())) as image:
        assert image.format == "PNG"
        assert len(image.convert("RGB").getcolors(1 << 24)) > 10


@pytest.mark.parametrize("sides", [(1e-3, 1e-3), (5.0, 5.0), (0.02, 0.6), (0.6, 0.02)])
def test_draws_objects_of_any_size_and_shape(sides):
    x, y = sides
    obj = GridObject.from_outline([[0, 0], [x, 0], [x, y], [0, y]], max_cells=12)
    for picture in (draw_object(obj), draw_model(make_identification(obj))):
        with Image.open(BytesIO(picture)) as image:
            assert 200 < image.width < 2000
            assert 100 < image.height < 2000


@pytest.mark.parametrize(("longest", "length"), [(0.12, 0.1), (0.1, 0.1), (0.099, 0.05), (0.0021, 0.002), (3.0, 2.0)])
def test_scale_bars_are_round(longest, length):
    assert calc_round_length(longest) == pytest.approx(length)
