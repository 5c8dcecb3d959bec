"""What an arm that is told nothing feels while it pushes, beside the contact forces of the plant."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from gridpush_drake.dynamics.physics import GRAVITY, QUASI_STATIC
from gridpush_drake.identification.absolute.force_scale import measure_pushes
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.problem import TimedPush
from gridpush_drake.station.scene.contents import use_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.systems.base.messages import PressCommand, PushCommand

LATEST = 12.0
"""Time by which the push is over, s."""


def make_station():
    """A toolbox of 1.2 kg, with frictions between 0.55 and 0.89."""
    scenario = PreGraspKind().make_scenario()
    scenario.unknown_inertia = True
    scenario.truth.total_mass = [0.1, 3.0]
    scenario.truth.friction = [0.1, 0.9]
    scenario.truth.friction_by_part = True
    told = use_object(scenario, "toolbox")
    scenario.object_pose = [0.534, -0.091, 0.055]
    scenario.seed = 501
    return MakePushStation(resolve(scenario, known_object=told), show_object=False)


@pytest.mark.slow
def test_what_the_finger_lifts_is_felt_and_does_not_count_as_friction():
    """The finger sticks to the object's side, and carries some of its weight all along the push."""
    station = make_station()
    tip = station.plant.GetBodyByName(station.robot.finger.tip_frame).index()
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetStart(context)
    push = PushCommand(1, 0.7472, -0.0908, -3.091, 0.04, 0.03)
    for port, command in (("push_command", push), ("press_command", PressCommand())):
        station.GetInputPort(port).FixValue(context, command.to_vector())
    lifts = []

    def note(root):
        contacts = station.GetOutputPort("contact_results").Eval(root)
        for i in range(contacts.num_point_pair_contacts()):
            info = contacts.point_pair_contact_info(i)
            if tip in (info.bodyA_index(), info.bodyB_index()):
                # The force is that on body B.
                sign = -1.0 if info.bodyB_index() == tip else 1.0
                lifts.append(sign * info.contact_force()[2])
        return EventStatus.DidNothing()

    simulator.set_monitor(note)
    while not len(station.GetOutputPort("estimate.push_log").Eval(context)):
        assert context.get_time() < LATEST
        simulator.AdvanceTo(context.get_time() + 0.2)
    (seen,) = station.GetOutputPort("estimate.push_log").Eval(context)

    # The upward force is that of the contact.
    weight = GRAVITY * station.truth.total_mass
    felt = seen.lift_force[np.linalg.norm(seen.force, axis=1) > 0.5 * np.abs(seen.force).max()]
    assert np.mean(lifts) > 0.05 * weight
    assert abs(felt.mean() - np.mean(lifts)) < 0.02 * weight

    # With it, the friction is right; by the other two components alone it is too low.
    friction = GRAVITY * station.truth.mass @ station.truth.friction

    def tell(one):
        timed = TimedPush.of(one, "quasi_static")
        return (
            measure_pushes(Model(station.obj, station.truth, QUASI_STATIC), [timed]).scales[0]
            / friction
        )

    assert abs(tell(seen) - 1.0) < 0.03
    assert tell(replace(seen, lift_force=None)) < 0.95
