"""`gridpush twin`: a simulated robot in a process of its own, which speaks what a real one's drivers speak."""

from pathlib import Path
from time import monotonic
from typing import Annotated

import typer
from pydrake.systems.analysis import Simulator

from gridpush_drake.cli.console import print_notice
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.station.lcm.hardware_link import open_lcm
from gridpush_drake.station.lcm.twin import MakeTwin
from gridpush_drake.station.lcm.twin_camera import PictureProcess
from gridpush_drake.station.lcm.twin_link import TwinLink
from gridpush_drake.station.resolve import resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scenario_file import read_scenario
from gridpush_drake.station.scene import use_object
from gridpush_drake.systems.arm_guard import GuardMode

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"

DEFAULT_SCENARIO = "grasp"
"""Name of the shipped scenario that robot and twin take where none is given."""

EXCHANGE_PERIOD = 0.001
"""Time that is simulated between two looks at what came in, s."""

LARGEST_DELAY = 0.05
"""If the twin's time is further behind the clock than this, it goes on from where it is and says so, s."""

Scenario = Annotated[
    Path | None,
    typer.Option(
        "--scenario",
        metavar="NAME|FILE",
        help="What stands where: a shipped scenario's name, or a YAML file; twin and robot need "
        "the same.  [default: grasp]",
    ),
]

ObjectFile = Annotated[
    str | None,
    typer.Option(
        "--object", metavar="NAME|FILE", help="A shipped object's name, or an object file."
    ),
]

LcmUrl = Annotated[
    str, typer.Option("--lcm", metavar="URL", help="The LCM network that robot and twin are on.")
]

RealtimeRate = Annotated[
    float,
    typer.Option(
        min=0.001,
        metavar="R",
        help="Speed of the twin's time: below 1 for a slow computer. Give twin and robot the same; with a real robot "
        "leave it at 1.",
    ),
]


def twin(
    scenario_file: Scenario = None,
    object_file: ObjectFile = None,
    lcm: LcmUrl = DEFAULT_URL,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of everything random.  [default: the scenario's]"),
    ] = None,
    realtime_rate: RealtimeRate = 1.0,
) -> None:
    """Simulate a robot that speaks its driver's LCM messages, for `gridpush robot` to move; Ctrl-C ends it."""
    scenario, obj = read_robot_scenario(scenario_file, object_file, seed)
    resolved = resolve(scenario, scenario_file, told=obj)
    link = TwinLink(open_lcm(lcm), resolved.robot)
    diagram = MakeTwin(resolved, link.bus, listens=False)
    simulator = Simulator(diagram)
    diagram.SetStart(simulator.get_mutable_context())
    simulator.set_target_realtime_rate(realtime_rate)
    simulator.Initialize()
    print_notice(
        f"The twin speaks on {lcm} as an {diagram.world.setting.robot.arm_model}; Ctrl-C ends it."
    )
    camera = PictureProcess(scenario, lcm) if scenario.camera.kind == "rgbd" else None
    begin, told, said, next_picture, unusable = monotonic(), False, "", 0.0, 0
    context, port = simulator.get_context(), diagram.GetOutputPort("driver.status")
    try:
        while True:
            if camera is not None and context.get_time() >= next_picture:
                camera.ask(context.get_time(), diagram.GetPositions(context))
                next_picture += 1 / scenario.camera.rate
            link.exchange()
            time = context.get_time() + EXCHANGE_PERIOD
            simulator.AdvanceTo(time)
            status = port.Eval(context)
            if status.reason != said and status.mode == GuardMode.HOLDING:
                print_notice(
                    f"{status.since:.2f} s: {status.reason}. The arm came to rest; a command moves it again."
                )
            said = status.reason
            if len(link.left_out) != unusable:
                unusable = len(link.left_out)
                print_notice(f"{time:.2f} s: a command was left out: {list(link.left_out)[-1]}.")
            behind = (monotonic() - begin) * realtime_rate - time
            if behind > LARGEST_DELAY:
                begin += behind / realtime_rate
                simulator.ResetStatistics()  # else it would run faster than the clock once it can
                if not told:
                    print_notice(
                        "The twin is slower than the clock; give both sides a smaller --realtime-rate."
                    )
                told = True
    except KeyboardInterrupt:
        left_out = link.describe_left_out()
        print_notice(
            f"The twin ends after {context.get_time():.1f} s of its time{left_out and f'; {left_out}'}."
        )
    finally:
        if camera is not None:
            camera.close()


def read_robot_scenario(
    scenario_file: Path | None, object_file: str | None, seed: int | None
) -> tuple[PushScenario, GridObject | None]:
    """Reads the scenario that twin, tracker and robot agree on.

    Args:
        scenario_file: the scenario's file or name; None for `DEFAULT_SCENARIO`.
        object_file: the object's file or name, instead of the scenario's object. If the file says
            how high the object is, the object in the scene is that high.
        seed: instead of the scenario's; None to keep that.

    Returns:
        The scenario, and the object for `resolve` if `object_file` names one, else None.

    Raises:
        ScenarioError: the scenario's or the object's file cannot be read, or holds what will not do.
    """
    scenario = read_scenario(scenario_file or DEFAULT_SCENARIO)
    obj = None if object_file is None else use_object(scenario, object_file)
    if seed is not None:
        scenario.seed = seed
    return scenario, obj
