"""The compiled kernels, made ready before work that is timed or shown."""

from threading import Timer

from gridpush_drake.apps.console import print_notice

NOTICE = "compiling kernels (once a machine) ..."

NOTICE_AFTER = 1.5
"""s of waiting, after which the notice is printed; loading kernels that are compiled already takes less."""

SIDE, RADIUS, SPEED, DURATION = 0.02, 0.005, 0.1, 0.02
"""A small square and a short push of it: m, m, m/s, s."""


def compile_kernels() -> None:
    """Runs one tiny simulation of each kind, and says so on standard error where that takes long."""
    timer = Timer(NOTICE_AFTER, print_notice, [NOTICE])
    timer.daemon = True
    timer.start()
    try:
        from gridpush_drake.dynamics.push import Push
        from gridpush_drake.dynamics.simulate import Regime, simulate
        from gridpush_drake.grid.object import GridObject
        from gridpush_drake.grid.parameters import CellParameters

        obj = GridObject.from_outline([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]], max_cells=1)
        params = CellParameters.uniform(obj)
        push = Push((-RADIUS, SIDE / 3), (SPEED, 0.0), DURATION, RADIUS)  # type: ignore[arg-type]
        regimes: tuple[Regime, ...] = ("inertial", "quasi_static")
        for regime in regimes:
            simulate(obj, params, push, gradients=True, regime=regime)
    finally:
        timer.cancel()
