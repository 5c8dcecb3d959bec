"""Whether Drake can render pictures here."""

import pytest

from gridpush_drake.errors import StationError
from gridpush_drake.station.scene.camera import check_renderer


def require_renderer():
    """Skips the test, with the reason, where pictures cannot be rendered."""
    try:
        check_renderer()
    except StationError as error:
        pytest.skip(str(error))
