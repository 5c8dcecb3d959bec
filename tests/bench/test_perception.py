"""The rendered benches on one object: outline and pose as good as the tables say, and errors to act on."""

import numpy as np
import pytest

from gridpush_drake.bench.perception import experiments as perception
from gridpush_drake.bench.perception.found_outlines import (
    OutlineJob,
    OutlineScore,
    run_outline,
    tabulate_outlines,
)
from gridpush_drake.bench.perception.found_photographs import (
    PhotoScore,
    RenderedPhotoScore,
    find_photographs,
    tabulate_photos,
    tabulate_rendered_photos,
)
from gridpush_drake.bench.perception.multi_object import (
    MultiObjectJob,
    MultiObjectScore,
    draw_motion,
    run_multi_object,
    tabulate_multi_object,
)
from gridpush_drake.bench.perception.occluded_pushes import (
    OCCLUDED_OUTLINE_KINDS,
    OcclusionJob,
    OcclusionScore,
    run_occlusion,
    tabulate_occlusions,
)
from gridpush_drake.bench.perception.rendered_photographs import OUTLINE_KINDS as OUTLINE_KINDS
from gridpush_drake.bench.perception.rendered_photographs import make_outline, take_photograph
from gridpush_drake.bench.perception.tracked_pushes import (
    TagJob,
    TrackJob,
    TrackScore,
    run_tag,
    run_track,
    tabulate_tags,
    tabulate_tracks,
)
from gridpush_drake.errors import GridPushError


@pytest.mark.slow
def test_a_rendered_object_is_found():
    score = run_outline(OutlineJob("spray_bottle", 2, 1))
    assert max(score.errors) < 1e-3
    assert np.abs(score.areas).max() < 0.02
    assert np.abs(score.heights).max() < 1e-3


@pytest.mark.slow
def test_a_rendered_push_is_tracked_past_the_arm():
    score = run_track(TrackJob("claw_hammer", 1, 0))
    errors = np.array(score.errors)
    assert score.lost == 0
    assert len(errors) == score.frames
    assert np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 1e-3
    assert np.sqrt((errors[:, 2] ** 2).mean()) < np.radians(0.5)


@pytest.mark.slow
def test_a_tag_is_tracked():
    score = run_tag(TagJob("claw_hammer", 1, 0))
    errors = np.array(score.errors)
    assert len(errors) == score.frames - score.lost > score.frames / 2
    assert np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 3e-4
    assert np.sqrt((errors[:, 2] ** 2).mean()) < np.radians(0.3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", OCCLUDED_OUTLINE_KINDS)
def test_no_hidden_push_flips_what_looks_alike(kind):
    score = run_occlusion(OcclusionJob(kind, 4, seed=100, model=True))
    assert (score.pushes, score.flipped, score.unseen) == (4, 0, 0)
    assert score.doubted <= 2


@pytest.mark.slow
def test_a_rendered_photograph_is_drawn_from_its_number_alone():
    photo, again = take_photograph("reporting", 8), take_photograph("reporting", 8)
    np.testing.assert_array_equal(photo.frame.color, again.frame.color)
    np.testing.assert_array_equal(photo.frame.depth, again.frame.depth)
    other = take_photograph("tuning", 3)
    assert (photo.frame.color != other.frame.color).any()
    assert photo.camera.X_WC is None
    # the object is in view, nearer than the table, and not measured everywhere
    assert 1000 < photo.mask.sum() < 60000
    rim = np.concatenate([photo.mask[[0, -1]].ravel(), photo.mask[:, [0, -1]].ravel()])
    assert not rim.any()
    depth = photo.frame.depth
    assert (depth[photo.mask] == 0).mean() > 0.2, "it is of chrome"
    assert np.median(depth[photo.mask & (depth > 0)]) < np.median(depth[~photo.mask & (depth > 0)])


@pytest.mark.parametrize("kind", [kind for kinds in OUTLINE_KINDS.values() for kind in kinds])
def test_a_generated_outline_is_one_piece(kind):
    for seed in range(5):
        outline = make_outline(kind, np.random.default_rng(seed))
        assert outline.is_valid
        assert 1e-3 < outline.area < 0.03
        assert np.hypot(*outline.centroid.coords[0]) < 0.05


def test_tables():
    rendered = tabulate_rendered_photos(
        [
            RenderedPhotoScore("reporting", [0.95, 0.5], [0.85, 0.8]),
            RenderedPhotoScore("reporting", [np.nan], [np.nan]),
        ]
    )
    assert rendered.rows[0] == pytest.approx(
        ("reporting", 3, 1, 0.725, 100 / 3, 100 / 3, 1.0, 1, 0)
    )
    hidden = tabulate_occlusions(
        [OcclusionScore("plate", True, 5, 1, 2, 0), OcclusionScore("square", True, 3, 0, 0, 1)]
    )
    assert hidden.rows[2] == ("all", "model", 8, 1, 2, 1)
    photos = tabulate_photos([PhotoScore("a", (0.9, 0.8, 0.7)), PhotoScore("b", (1.0, 0.6, 0.5))])
    assert photos.rows[-1][1:] == pytest.approx((0.95, 0.7, 0.6))
    outlines = tabulate_outlines(
        [OutlineScore("a", [1e-3, float("nan"), 3e-3], [0.01, -0.02], [1e-3, 0.0])]
    )
    assert outlines.rows[0] == pytest.approx(("a", 3, 1, 2.0, 3.0, -0.5, 2.0, 1.0))
    sure, errors = (1e-3, 1e-3, 1e-2), [(1e-3, 0.0, 0.0), (-1e-3, 0.0, 0.03)]
    (row, _) = tabulate_tracks([TrackScore("a", 5, 1, errors, [sure, sure])]).rows
    assert row[:4] == ("a", 5, 1, 2)
    assert row[4:] == pytest.approx((1.0, np.degrees(0.03 / np.sqrt(2)), 100 * 5 / 6))
    (row, _) = tabulate_tags([TrackScore("a", 5, 3, errors, [(float("nan"),) * 3] * 2)]).rows
    assert row == pytest.approx(("a", 5, 3, 1.0, np.degrees(0.03 / np.sqrt(2))))


def test_a_folder_without_photographs_is_named(tmp_path):
    (tmp_path / "a_label.pgm").write_bytes(b"P5 1 1 255\n\x01")
    with pytest.raises(GridPushError, match="holds no NAME_color"):
        find_photographs(tmp_path)


def test_a_part_is_measured_by_itself():
    options = perception.PerceptionBenchOptions(part="several", several_pushes=3, counts=(2, 4))
    jobs = perception.make_jobs(options)
    assert [(job.count, job.touching, job.pushes) for job in jobs] == [
        (2, False, 3), (4, False, 3), (2, True, 3), (4, True, 3)
    ]  # fmt: skip
    everything = perception.make_jobs(perception.PerceptionBenchOptions())
    assert {type(job) for job in everything} >= {MultiObjectJob, TrackJob, TagJob, OutlineJob}


def test_several_objects_that_push_each_other_are_tabulated():
    score = MultiObjectScore(
        count=2,
        touching=True,
        pushes=1,
        frames=4,
        unseen=1,
        wrong=1,
        errors=[(1e-4, 0.0, 0.0), (0.0, 1e-4, np.radians(0.1))],
        deviations=[(1e-4, 1e-4, 1e-3), (1e-4, 1e-4, 1e-3)],
    )
    row, total = tabulate_multi_object([score]).rows
    assert row[:6] == ("2", "touching", 1, 4, 1, 1)
    assert row[6] == pytest.approx(0.1)
    assert row[7] == pytest.approx(0.1 / np.sqrt(2))
    assert row[8] == pytest.approx(100.0)
    assert total[2:] == row[2:]


@pytest.mark.slow
@pytest.mark.parametrize("touching", [False, True], ids=["apart", "touching"])
def test_objects_that_push_each_other_are_told_apart(touching):
    _, motion = draw_motion(2, touching, 50)
    ways = np.linalg.norm(motion.poses[-1, :, :2] - motion.poses[0, :, :2], axis=1)
    assert (ways > 0.005).all()
    score = run_multi_object(MultiObjectJob(2, touching, 1, 50))
    assert (score.frames, score.unseen, score.wrong) == (22, 0, 0)
    errors = np.array(score.errors)
    assert np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 3e-4
    assert np.sqrt((errors[:, 2] ** 2).mean()) < np.radians(0.1)
