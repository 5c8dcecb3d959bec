"""How fast `GridLcpSystem` runs in a Drake Simulator."""

from time import perf_counter

import numpy as np

from gridpush_drake.bench.speed import DT, DURATION, RADIUS, make_bench_push
from gridpush_drake.bench.table import Table, Value
from gridpush_drake.bench.workers import Report, count_steps
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters

OBJECTS = ("claw_hammer", "toolbox")
REGIMES = ("inertial", "quasi_static")

MS = 1e3


def run(repetitions: int = 10, report: Report | None = None) -> list[Table]:
    """Times the push of the speed benchmark in a Simulator.

    Args:
        repetitions: of each push.
        report: called with what begins, as of jobs.

    Returns:
        One table, a row an object and regime.
    """
    rows: list[list[Value]] = []
    tell = count_steps(report, len(OBJECTS) * len(REGIMES))
    for name in OBJECTS:
        for regime in REGIMES:
            tell(f"{name}, {regime}")
            obj = GridObject.from_yaml(find_shipped_object(name))
            times = np.sort(_time_pushes(obj, regime, repetitions))
            median = float(np.median(times))
            rows.append([f"{name}, {regime}", obj.n, median * MS, float(times[0]) * MS, DURATION / median])
    notes = [
        f"A push of {DURATION:g} s in steps of {DT * MS:g} ms, {repetitions} runs, with Drake's Simulator and logging."
    ]
    columns = ("object, regime", "cells", "median, ms", "least, ms", "times real time")
    return [Table("GridLcpSystem in a Simulator", columns, rows, notes)]


def _time_pushes(obj: GridObject, regime: str, repetitions: int) -> list[float]:
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import TrajectorySource
    from pydrake.trajectories import PiecewisePolynomial

    from gridpush_drake.systems.grid_lcp_system import GridLcpSystem

    push = make_bench_push(obj)
    builder = DiagramBuilder()
    lcp = builder.AddSystem(
        GridLcpSystem(obj, CellParameters.random(obj, seed=0), DT, regime, RADIUS)  # type: ignore[arg-type]
    )
    states = np.column_stack([push.xy, np.tile(push.velocity, (len(push.xy), 1))])
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold(push.t, states.T)))
    builder.Connect(source.get_output_port(), lcp.GetInputPort("pusher_state"))
    diagram = builder.Build()
    times = []
    for _ in range(repetitions + 1):
        simulator = Simulator(diagram)
        simulator.Initialize()
        begin = perf_counter()
        simulator.AdvanceTo(DURATION)
        times.append(perf_counter() - begin)
    return times[1:]
