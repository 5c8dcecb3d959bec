import pytest

from gridpush_drake.planning.pregrasp import planner as pregrasp_planner


@pytest.fixture(scope="module")
def without_forecasts():
    """Of no poke it is imagined what it would leave unknown: that takes a second each time.

    No poke is chosen by it; the planner's own tests have it.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pregrasp_planner, "forecast_std", lambda *_: None)
        yield
