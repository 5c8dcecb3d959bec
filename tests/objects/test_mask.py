import struct
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gridpush_drake.errors import ObjectError, ObjectWarning
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.mask import MAX_PIXELS, _keep_one_piece, read_labels
from tests.helpers.shared_data import shared_data

MASKS = ["book", "box", "hammer", "snack", "windex"]


def save(path, labels, **options):
    Image.fromarray(np.asarray(labels)).save(path, **options)
    return path


def read(path, labels, max_cells=127, scale=1.0, **options):
    return GridObject.from_mask(
        save(path, labels), meters_per_pixel=scale, max_cells=max_cells, **options
    )


def raster_rectangle(width, height, degrees, side=300):
    y, x = np.mgrid[:side, :side] + 0.5 - side / 2 - np.array([0.3, 0.7])[:, None, None]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return ((abs(c * x + s * y) <= width / 2) & (abs(c * y - s * x) <= height / 2)).astype(np.uint8)


@pytest.mark.parametrize("name", MASKS)
def test_paper_masks(name):
    path = shared_data("masks", f"{name}_label.pgm")
    obj = GridObject.from_mask(path, meters_per_pixel=0.001)
    pixels = np.asarray(Image.open(path))
    area = np.count_nonzero(pixels) * 1e-6
    assert 115 <= obj.n <= 127
    assert obj.outline.area == pytest.approx(area, rel=0.01)
    assert obj.n * obj.cell_size**2 == pytest.approx(area, rel=0.08)
    assert set(obj.labels) == set(np.unique(pixels)) - {0}
    np.testing.assert_allclose(obj.p_BC.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(obj.outline.centroid.coords[0], 0, atol=0.15 * obj.cell_size)


def test_hammer_has_the_papers_resolution():
    obj = GridObject.from_mask(shared_data("masks", "hammer_label.pgm"), meters_per_pixel=0.001)
    assert 122 <= obj.n <= 127


def test_frame_is_x_right_y_up_about_the_cells_centroid(tmp_path):
    labels = np.zeros((40, 60), np.uint8)
    labels[5:15, 10:50] = 1  # a bar at the top ...
    labels[15:35, 10:20] = 2  # ... and a leg below its left end
    obj = read(tmp_path / "l.png", labels, 24, 0.01)
    np.testing.assert_allclose(obj.p_BC.mean(axis=0), 0, atol=1e-12)
    bar, leg = (obj.p_BC[obj.labels == label].mean(axis=0) for label in (1, 2))
    assert bar[1] > leg[1] and bar[0] > leg[0]
    assert obj.outline.exterior.is_ccw
    assert obj.outline.area == pytest.approx(600e-4, rel=0.01)
    assert obj.name == "l"


def test_the_frames_origin_is_where_the_file_has_it_in_the_picture(tmp_path):
    labels = np.zeros((40, 60), np.uint8)
    labels[10:30, 20:50] = 1
    labels[2, 3] = 1  # another piece, up and to the left
    save(tmp_path / "mask.png", labels)
    file = tmp_path / "object.yaml"
    file.write_text("mask: {image: mask.png, meters_per_pixel: 0.001, origin: [25, 28]}")
    obj = GridObject.from_yaml(file, largest_piece=True)
    # the piece's lower left corner is 5 pixels to the left of the origin, and 2 below it
    np.testing.assert_allclose(obj.outline.bounds, (-0.005, -0.002, 0.025, 0.018), atol=1e-3)
    about_centroid = read(tmp_path / "mask.png", labels, scale=0.001, largest_piece=True)
    np.testing.assert_allclose(
        obj.p_BC - about_centroid.p_BC, np.tile([0.010, 0.008], (obj.n, 1)), atol=1e-9
    )


def test_few_pixels_become_one_cell_each(tmp_path):
    labels = np.zeros((9, 9), np.uint8)
    labels[2:5, 3:8] = [[1, 1, 2, 2, 0], [1, 2, 2, 3, 3], [0, 0, 0, 9, 9]]
    obj = read(tmp_path / "a.png", labels, scale=0.5)
    assert obj.n == 11
    assert obj.cell_size == 0.5
    assert sorted(obj.labels) == [1, 1, 1, 2, 2, 2, 2, 3, 3, 9, 9]


def test_majority_names_a_cells_part(tmp_path):
    labels = np.ones((30, 30), np.uint8)
    labels[:, 16:] = 5
    labels[2, 2] = 7
    obj = read(tmp_path / "a.png", labels, 9)
    assert sorted(obj.labels) == [1] * 6 + [5] * 3


@pytest.mark.parametrize("degrees", [0, 3, 30, 45, 77])
@pytest.mark.parametrize("width, height", [(160, 80), (200, 40)])
def test_long_edges_of_a_turned_rectangle_have_true_normals(tmp_path, degrees, width, height):
    obj = read(tmp_path / "r.png", raster_rectangle(width, height, degrees))
    edges = np.diff(np.array(obj.outline.exterior.coords), axis=0)
    length = np.linalg.norm(edges, axis=1)
    turn = np.degrees(np.arctan2(edges[:, 1], edges[:, 0])) + degrees  # y is turned up
    error = np.abs((turn + 45) % 90 - 45)
    assert error[length > 20].max() < 2.0
    assert (length * (error > 2.0)).sum() < 0.06 * length.sum()
    assert obj.outline.area == pytest.approx(width * height, rel=0.015)


def test_disc_is_round(tmp_path):
    y, x = np.mgrid[:120, :120] - 59.5
    obj = read(tmp_path / "d.png", (np.hypot(x, y) < 50).astype(np.uint8))
    radius = np.linalg.norm(np.array(obj.outline.exterior.coords), axis=1)
    assert abs(radius - 50).max() < 1.2
    assert obj.outline.area == pytest.approx(np.pi * 50**2, rel=0.01)


def test_holes_are_kept_and_specks_in_the_mask_dropped(tmp_path):
    labels = np.ones((80, 100), np.uint8)
    labels[20:60, 30:70] = 0
    labels[5, 5] = labels[70:72, 90] = 0
    with pytest.warns(
        ObjectWarning, match=r"h\.png: is the mask inverted\? .* hole of 1600 pixels"
    ):
        obj = read(tmp_path / "h.png", labels)
    assert len(obj.outline.interiors) == 1
    assert obj.outline.area == pytest.approx(80 * 100 - 40 * 40, rel=0.005)
    assert (np.abs(obj.p_BC).max(axis=1) > 14).all()


def test_a_mask_that_may_well_be_right_is_not_doubted(tmp_path):
    """A frame with background beside it, a plate with several holes, and one with a speck: each without a warning."""
    frame = np.ones((80, 100), np.uint8)
    frame[20:60, 30:70] = 0
    plate, speck = np.ones((80, 100), np.uint8), np.ones((80, 100), np.uint8)
    plate[20:40, 20:40] = plate[20:40, 60:80] = 0
    speck[40:44, 40:44] = 0
    for labels in (np.pad(frame, ((0, 1), (0, 0))), plate, speck, np.ones((20, 30), np.uint8)):
        read(tmp_path / "f.png", labels)
    with pytest.warns(ObjectWarning, match="inverted"):
        read(tmp_path / "f.png", frame)


def test_thin_and_corner_touching_masks_still_have_an_outline(tmp_path):
    line = np.zeros((5, 60), np.uint8)
    line[2, 5:55] = 1
    corner = np.zeros((20, 20), np.uint8)
    corner[2:10, 2:10] = corner[10:18, 10:18] = 1
    for labels in (line, corner, np.eye(200, dtype=np.uint8), np.ones((1, 1), np.uint8)):
        obj = read(tmp_path / "t.png", labels)
        assert obj.outline.is_valid and 1 <= obj.n <= 127
        assert 0.9 < obj.outline.area / labels.sum() < 2.5


def test_noise_is_traced_at_a_coarser_scale_instead_of_forever(tmp_path):
    labels = (np.random.default_rng(0).random((400, 400)) < 0.6).astype(np.uint8)
    obj = read(tmp_path / "n.png", labels, largest_piece=True)
    assert 100 <= obj.n <= 127


@given(st.integers(0, 2**32 - 1), st.integers(1, 300))
@settings(
    deadline=None, max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_random_blobs(tmp_path, seed, max_cells):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(70, 90)), 6)
    labels = (noise > np.quantile(noise, 0.6)).astype(np.uint8)
    obj = read(tmp_path / "b.png", labels, max_cells, 0.01, largest_piece=True)
    pieces, _ = ndimage.label(labels, np.ones((3, 3)))
    area = np.bincount(pieces.ravel())[1:].max() * 1e-4
    assert 1 <= obj.n <= max_cells
    assert obj.outline.is_valid and obj.outline.area == pytest.approx(area, rel=0.03)
    if max_cells > 100:
        assert obj.n * obj.cell_size**2 == pytest.approx(area, rel=0.12)


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.8))
@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_the_largest_of_random_pieces_is_kept(tmp_path, seed, density):
    labels = (np.random.default_rng(seed).random((23, 31)) < density).astype(np.uint8)
    labels[3, 4] = 1
    pixels = np.argwhere(labels)
    i, j = cKDTree(pixels).query_pairs(1.5, output_type="ndarray").T  # along a side or at a corner
    pieces = connected_components(
        coo_array((np.ones(len(i)), (i, j)), shape=(len(pixels), len(pixels)))
    )[1]
    path = save(tmp_path / "a.png", labels)
    kept = _keep_one_piece(path, read_labels(path), True).labels
    assert np.count_nonzero(kept) == np.bincount(pieces).max()
    assert kept.any(axis=0)[[0, -1]].all() and kept.any(axis=1)[[0, -1]].all()


# Files


def png(width, height, depth, color, data):
    """A PNG from its parts."""
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)),
        (b"IDAT", data),
        (b"IEND", b""),
    ]
    out = b"\x89PNG\r\n\x1a\n"
    for kind, body in chunks:
        out += (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )
    return out


STORED = np.array([[0, 1, 2], [3, 1, 0]])


@pytest.mark.parametrize("greatest", [3, 7, 255, 300, 65535])
@pytest.mark.parametrize("magic", ["P2", "P5"])
def test_pgm_labels_are_as_stored_whatever_its_greatest_value(tmp_path, magic, greatest):
    head = f"{magic}\n# a comment\n3 2\n# another\n{greatest}\n".encode()
    raw = STORED.astype(">u2" if greatest > 255 else "u1").tobytes()
    body = b"0 1 2 # row\n3 1 0\n" if magic == "P2" else raw
    (tmp_path / "a.pgm").write_bytes(head + body)
    np.testing.assert_array_equal(read_labels(tmp_path / "a.pgm").labels, STORED)


def test_png_labels_are_as_stored_whatever_its_depth(tmp_path):
    path = tmp_path / "a.png"
    for kind in (np.uint8, np.uint16):
        np.testing.assert_array_equal(read_labels(save(path, STORED.astype(kind))).labels, STORED)
    np.testing.assert_array_equal(
        read_labels(save(path, STORED.astype(np.uint16) * 20000)).labels, STORED * 20000
    )
    image = Image.new("P", (3, 2))
    image.putdata(STORED.ravel().tolist())
    image.putpalette([9, 9, 9] * 4)
    image.save(path)
    np.testing.assert_array_equal(read_labels(path).labels, STORED)
    rows = zlib.compress(bytes([0, 0b00011000, 0, 0b11010000]))
    path.write_bytes(png(3, 2, 2, 0, rows))  # gray of two bits
    np.testing.assert_array_equal(read_labels(path).labels, STORED)
    np.testing.assert_array_equal(read_labels(save(path, STORED > 0)).labels, STORED > 0)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA"])
def test_photographs_are_refused(tmp_path, mode):
    Image.new(mode, (8, 8)).save(tmp_path / "photo.png")
    with pytest.raises(ObjectError, match=r"photo\.png.*expected a PGM or PNG label image"):
        GridObject.from_mask(tmp_path / "photo.png", meters_per_pixel=1)


@pytest.mark.parametrize(
    "content, word",
    [
        (b"", "neither PGM nor PNG"),
        (b"\xff\xd8\xff\xe0 jpeg", "neither PGM nor PNG"),
        (b"P6\n1 1\n255\nabc", "color"),
        (b"P5\nx 2\n255\n", "header"),
        (b"P5\n3 2\n255\nab", "shorter"),
        (b"P5\n3 2\n0\nab", "greatest"),
        (b"P5\n0 2\n255\n", "pixels"),
        (b"P2\n3 2\n255\n1 2 3", "shorter"),
        (b"P2\n3 2\n255\n1 2 3 a b c", "damaged"),
        (b"\x89PNG\r\n\x1a\n", "damaged PNG"),
        (b"\x89PNG\r\n\x1a\n" + b"x" * 100, "damaged PNG"),
        (png(3, 2, 8, 0, zlib.compress(b"\x00" * 8)[:6]), "damaged PNG"),
    ],
)
def test_damaged_files_are_refused(tmp_path, content, word):
    (tmp_path / "bad.png").write_bytes(content)
    with pytest.raises(ObjectError, match=rf"bad\.png.*{word}"):
        GridObject.from_mask(tmp_path / "bad.png", meters_per_pixel=1)


def test_every_cut_of_a_png_is_refused_or_read(tmp_path):
    content = save(tmp_path / "a.png", raster_rectangle(20, 10, 30, 40)).read_bytes()
    for end in [*range(60), *range(60, len(content) - 1, 7)]:
        (tmp_path / "b.png").write_bytes(content[:end])
        try:
            GridObject.from_mask(tmp_path / "b.png", meters_per_pixel=1, max_cells=5)
        except ObjectError as error:
            assert "b.png" in str(error)


def test_missing_file_and_folder_are_refused(tmp_path):
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(ObjectError, match="cannot be read"):
            GridObject.from_mask(path, meters_per_pixel=1)


def test_empty_mask_is_refused(tmp_path):
    with pytest.raises(ObjectError, match="background"):
        read(tmp_path / "e.png", np.zeros((5, 5), np.uint8))


def test_pieces_are_counted_and_the_largest_kept_on_request(tmp_path):
    labels = np.zeros((30, 30), np.uint8)
    labels[2:12, 2:12], labels[20:25, 20:25], labels[28, 3] = 1, 2, 3
    with pytest.raises(
        ObjectError, match=r"3 separate pieces \(of 100, 25, 1 pixels\).*--largest-piece"
    ):
        read(tmp_path / "p.png", labels)
    obj = read(tmp_path / "p.png", labels, 100, largest_piece=True)
    assert obj.n == 100
    assert set(obj.labels) == {1}


def test_too_many_labels_are_taken_for_a_photograph(tmp_path):
    with pytest.raises(ObjectError, match="different labels"):
        read(tmp_path / "g.png", np.arange(1, 241, dtype=np.uint8).reshape(12, 20))


@pytest.mark.parametrize("scale", [0, -1, np.nan, np.inf])
def test_scale_must_be_positive(tmp_path, scale):
    with pytest.raises(ObjectError, match="meters_per_pixel"):
        read(tmp_path / "a.png", np.ones((4, 4), np.uint8), scale=scale)


@pytest.mark.parametrize("max_cells", [0, -1, 1.5])
def test_max_cells_must_be_positive(tmp_path, max_cells):
    with pytest.raises(ObjectError, match="max_cells"):
        read(tmp_path / "a.png", np.ones((4, 4), np.uint8), max_cells)


def test_bomb_is_refused_before_it_is_decoded(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1
    (tmp_path / "bomb.png").write_bytes(png(side, side, 1, 0, zlib.compress(b"\x00" * 1000)))
    (tmp_path / "bomb.pgm").write_bytes(f"P5 {side} {side} 255\n".encode())
    for name in ("bomb.png", "bomb.pgm"):
        with pytest.raises(ObjectError, match="at most 100 million"):
            GridObject.from_mask(tmp_path / name, meters_per_pixel=1)


@pytest.mark.slow
def test_hundred_megapixels_are_read(tmp_path):
    labels = np.zeros((10_000, 10_000), np.uint8)
    labels[1000:9000, 500:9500] = 1
    labels[1000:9000, 5000:9500] = 2
    labels[4000:5000, 4000:5000] = 0
    path = save(tmp_path / "big.png", labels, compress_level=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Pillow's bomb warning among them
        obj = GridObject.from_mask(path, meters_per_pixel=1e-5)
    assert 110 <= obj.n <= 127
    assert obj.outline.area == pytest.approx(71e-4, rel=0.002)
    assert set(obj.labels) == {1, 2}
