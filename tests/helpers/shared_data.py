"""Where public data of other people lie, beside the repository; tests that want them are skipped without them."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).parents[2].parent / "shared" / "data"


def shared_data(*parts: str) -> Path:
    """The path of a shared file or folder; skips the test where it is absent."""
    path = SHARED_DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there: public data lie outside the repository")
    return path
