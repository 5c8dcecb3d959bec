"""Several files are written all or none."""

from pathlib import Path

import pytest

from gridpush_drake.errors import OutputError
from gridpush_drake.files import write_together, write_whole


def read_all(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_all_appear_at_the_end(tmp_path):
    write_whole(tmp_path / "old", "before")
    with write_together():
        write_whole(tmp_path / "new", "one")
        write_whole(tmp_path / "old", "after", force=True)
        assert not (tmp_path / "new").exists()
        assert (tmp_path / "old").read_text() == "before"
    assert read_all(tmp_path) == {"new": "one", "old": "after"}


@pytest.mark.parametrize("links", [True, False])
def test_a_name_that_cannot_be_given_undoes_the_others(tmp_path, monkeypatch, links):
    write_whole(tmp_path / "old", "before")
    replace = Path.replace

    def refuse_last(self, target):
        if target.name == "last":
            raise OSError(28, "No space left on device")
        return replace(self, target)

    def link(source, target):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "replace", refuse_last)
    if not links:
        monkeypatch.setattr("os.link", link)
    with (
        pytest.raises(OutputError, match=r"last: cannot be written: No space left"),
        write_together(),
    ):
        write_whole(tmp_path / "new", "one")
        write_whole(tmp_path / "old", "after", force=True)
        write_whole(tmp_path / "last", "three")
    assert read_all(tmp_path) == {"old": "before"}


def test_what_goes_wrong_inside_writes_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), write_together():
        write_whole(tmp_path / "new", "one")
        raise ZeroDivisionError
    assert read_all(tmp_path) == {}
