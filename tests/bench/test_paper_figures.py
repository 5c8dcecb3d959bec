"""The paper's figures: drawn from runs at small size, and beside what the paper says."""

import numpy as np
import pytest
from PIL import Image

from gridpush_drake.bench import paper_figures
from gridpush_drake.bench.paper import choose_budgets
from gridpush_drake.bench.paper_figures import (
    FIGURE_NAMES,
    STUDY,
    Counts,
    MapJob,
    check_folder,
    learn_map,
)
from gridpush_drake.errors import GridPushError, OutputError


def test_a_map_shows_where_it_is_heavy():
    found = learn_map(MapJob(None, "open_book", 0, 0))
    assert len(found.hidden) == len(found.learned) == len(found.std) == 117
    assert np.mean(found.hidden) == pytest.approx(1.0)
    assert np.mean(found.learned) == pytest.approx(1.0)
    assert np.corrcoef(found.hidden, found.learned)[0, 1] > 0.7
    assert min(found.std) > 0


def test_budgets_end_with_the_whole():
    assert choose_budgets(1500) == (25, 50, 100, 250, 500, 1500)
    assert choose_budgets(10)[-1] == 10


def test_nothing_is_run_where_a_figure_may_not_be_written(tmp_path):
    (tmp_path / "pregrasp.svg").write_text("mine")
    with pytest.raises(OutputError, match="--force"):
        STUDY.run(figures=tmp_path)
    with pytest.raises(OutputError, match="missing"):
        check_folder(tmp_path / "missing" / "figures", False)
    with pytest.raises(GridPushError, match="objects: anvil"):
        STUDY.run(figures=tmp_path, objects=("anvil",), force=True)
    assert (tmp_path / "pregrasp.svg").read_text() == "mine"


@pytest.mark.slow
def test_every_figure_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(paper_figures, "REAL_COUNTS", (3,))
    monkeypatch.setattr(paper_figures, "SHIPPED_SUBSTITUTES", ("open_book",))
    monkeypatch.setattr(paper_figures, "SLIDE_METHODS", ("true", "uniform"))
    counts = Counts(sets=1, pairs=1, splits=1, tries=1, budget=30)
    (table,) = STUDY.run(figures=tmp_path / "figures", methods=("paper",), counts=counts)
    assert [row[0] for row in table.rows] == list(FIGURE_NAMES)
    for name in FIGURE_NAMES:
        with Image.open(tmp_path / "figures" / f"{name}.png") as image:
            assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 10
        assert "<svg" in (tmp_path / "figures" / f"{name}.svg").read_text()
