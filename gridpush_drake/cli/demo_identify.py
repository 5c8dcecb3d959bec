"""The demo's first task: a robot pokes an object it knows nothing about, and comes to know it."""

from pydrake.geometry import Meshcat

from gridpush_drake.cli.console import count_progress
from gridpush_drake.cli.demo_files import FILES, write_demo
from gridpush_drake.cli.demo_task import FRAMES_A_SECOND, DemoTask, describe_time
from gridpush_drake.cli.demo_verdict import judge, print_verdict
from gridpush_drake.station.identify_task import IdentifyTask, IdentifyTaskRecord
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.systems.messages import PushStatus


def run(scenario: PushScenario, meshcat: Meshcat, realtime_rate: float) -> IdentifyTaskRecord:
    """Runs the experiment."""
    experiment = IdentifyTask(scenario, meshcat)
    experiment.AimCamera(meshcat)
    training, total = scenario.pokes.count, scenario.pokes.count + scenario.pokes.test_count
    with count_progress("the robot", total) as report:

        def show(status: PushStatus, logged: int) -> None:
            kind = "push" if status.executed < training else "held-out push"
            at = min(status.executed + 1, total)
            refused = f" (refused {status.refused}: {status.reason})" if status.reason else ""
            doing = f"{kind} {at} of {total}, {status.phase}{refused}"
            report(doing, describe_time(experiment.simulator), status.executed)

        meshcat.StartRecording(FRAMES_A_SECOND)
        return experiment.run(progress=show, realtime_rate=realtime_rate)


TASK = DemoTask(FILES, PushScenario, run, write_demo, judge, print_verdict)
"""As the demo uses it."""
