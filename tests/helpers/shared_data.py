"""Where public data of other people lie, beside the repository; tests that want them are skipped without them."""

from functools import cache
from pathlib import Path

import pytest

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import two_point
from gridpush_drake.pushes.importers.cmu import CmuImporter
from gridpush_drake.pushes.importers.two_point import read_two_point
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

SHARED_DATA = Path(__file__).parents[2].parent / "shared" / "data"


def shared_data(*parts: str) -> Path:
    """The path of a shared file or folder; skips the test where it is absent."""
    path = SHARED_DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there: public data lie outside the repository")
    return path


@cache
def read_cmu(name: str, calibrate: bool = True) -> tuple[PushLog, GridObject]:
    """The real pushes of a surface and shape, and the block; each file is read once."""
    return CmuImporter(calibrate=calibrate).read(shared_data("cmu_pushes", f"{name}.txt"))


def observe_two_point(name: str, part: slice) -> list[tuple[ObservedPush, bool]]:
    """Usable real two-point pushes of a file, and whether the block went with the tool in each."""
    logged = read_two_point(shared_data("cmu_two_point", f"{name}.txt"))[part]
    return [
        (two_point.observe_two_point(push, push.name), push.stable)
        for push in logged
        if push.usable
    ]
