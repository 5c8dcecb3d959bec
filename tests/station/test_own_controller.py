"""A newcomer's controller: a LeafSystem of a few lines between the station's ports, by public names alone."""

import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from gridpush_drake import MakePushStation, PushCommand, PushScenario
from gridpush_drake.systems import PushStatus

AWAY, DISTANCE, SPEED = 0.06, 0.07, 0.05  # m, m and m/s
PUSHES = 2

DOCS = Path(__file__).parents[2] / "docs/extending.md"


class Nudger(LeafSystem):
    """Pushes the object along y, through where its center of mass is believed, whenever the executor is ready."""

    def __init__(self):
        super().__init__()
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self._center = self.DeclareVectorInputPort("center_of_mass", 2)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(PushStatus()))
        command = self.DeclareDiscreteState(PushCommand().to_vector())
        self.DeclareStateOutputPort("push_command", command)
        self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.0, self._decide)

    def _decide(self, context, state):
        status, pose = self._status.Eval(context), self._pose.Eval(context)
        last = PushCommand.from_vector(context.get_discrete_state_vector().CopyToVector())
        if not status.ready or status.command_id != last.command_id or not np.isfinite(pose).all():
            return
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x, y = pose[:2] + np.array([[c, -s], [s, c]]) @ self._center.Eval(context)
        command = PushCommand(last.command_id + 1, x, y - AWAY, np.pi / 2, DISTANCE, SPEED)
        state.set_value(command.to_vector())


@pytest.mark.slow
def test_commands_the_station_and_uses_what_it_learned():
    builder = DiagramBuilder()
    station = builder.AddSystem(MakePushStation(PushScenario(object="claw_hammer")))
    controller = builder.AddSystem(Nudger())
    for source, target in (
        ("object.pose", "object_pose"),
        ("estimate.center_of_mass", "center_of_mass"),
        ("executor.status", "status"),
    ):
        builder.Connect(station.GetOutputPort(source), controller.GetInputPort(target))
    builder.Connect(controller.GetOutputPort("push_command"), station.GetInputPort("push_command"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    station.SetStart(context)

    def read(port):
        return station.GetOutputPort(port).Eval(station.GetMyContextFromRoot(context))

    believed = [np.array(read("estimate.center_of_mass"))]
    while read("executor.status").executed < PUSHES:
        simulator.AdvanceTo(context.get_time() + 0.2)
        if len(believed) <= len(read("estimate.push_log")):
            believed.append(np.array(read("estimate.center_of_mass")))
        assert context.get_time() < 60.0
    status, log = read("executor.status"), read("estimate.push_log")
    assert (status.executed, status.refused, len(log)) == (PUSHES, 0, PUSHES)
    assert np.linalg.norm(believed[1] - believed[0]) > 1e-3  # the first push taught something
    for seen, center in zip(log, believed, strict=False):
        c, s = np.cos(seen.pose[2]), np.sin(seen.pose[2])
        through = seen.pose[0] + np.array([c, -s]) @ center
        assert abs(seen.push.start[0] - through) < 2e-3  # and the second was aimed by it


def test_the_documented_example_runs():
    if not DOCS.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    example = re.findall(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)[0]
    names = {}
    exec(compile(example, str(DOCS), "exec"), names)
    station, context = names["station"], names["simulator"].get_context()
    status = station.GetOutputPort("executor.status").Eval(station.GetMyContextFromRoot(context))
    assert (status.command_id, status.refused) == (1, 0)


def test_the_documented_files_are_there():
    if not DOCS.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    named = re.findall(
        r"`((?:gridpush_drake|systems|models|tests)/[\w/.]+)`", DOCS.read_text(encoding="utf-8")
    )
    assert len(named) > 10
    assert [name for name in named if not (DOCS.parents[1] / name).exists()] == []
