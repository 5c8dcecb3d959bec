import dataclasses
from typing import get_type_hints

import pytest

from gridpush_drake.errors import PushLogError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import IMPORTER_CLASSES, find_importer

KINDS = (bool, int, float, float | None, str, str | None, GridObject | None)


@pytest.mark.parametrize("name", IMPORTER_CLASSES)
def test_an_importer_is_what_the_command_line_takes_it_for(name):
    importer = find_importer(name)
    types = get_type_hints(importer)
    assert importer.__doc__.partition("\n")[0].endswith(".") and importer.file and importer.source
    for field in dataclasses.fields(importer):
        assert types[field.name] in KINDS
        assert field.metadata["help"].endswith(".")
        assert field.default is not dataclasses.MISSING
    with pytest.raises(dataclasses.FrozenInstanceError):
        importer().file = "other"


@pytest.mark.parametrize("name", IMPORTER_CLASSES)
def test_an_importer_refuses_what_is_no_file(name, tmp_path):
    with pytest.raises(PushLogError, match=r"none\.txt"):
        find_importer(name)().read(tmp_path / "none.txt")
