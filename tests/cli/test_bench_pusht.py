"""`gridpush bench pusht` as a command."""

import json

import pytest
from PIL import Image

FIRST = 10000
"""Seed of the first episode played here."""


def test_json_has_the_figures_at_its_top(gridpush, tmp_path):
    pytest.importorskip("gym_pusht")
    args = ["bench", "pusht", "--episodes", "2", "--seed", str(FIRST), "--workers", "1", "--json"]
    film = tmp_path / "film.gif"
    args += ["--film", str(film)]
    outcome = gridpush(*args, "--results", str(tmp_path / "kept.jsonl"))
    assert outcome.code == 0
    document = json.loads(outcome.out)
    assert document["episodes"] == 2
    assert document["success"] == 1.0
    assert 0.95 < document["mean_max_coverage"] <= 1.0
    assert 1 <= document["median_steps"] <= 80
    assert 0 < document["decision_ms"] < float("inf")
    assert len(document["tables"]) == 1
    with Image.open(film) as picture:
        assert picture.size == (480, 240)
        assert picture.n_frames > 12
