"""`gridpush twin`: simulates a robot in a process of its own.

It speaks over LCM or ROS 2 as a real robot's drivers do, so that `gridpush robot` can
be tried without one.
"""

from pathlib import Path
from time import monotonic
from typing import Annotated

import typer
from pydrake.systems.analysis import Simulator

from gridpush_drake.cli.run.open_link import (
    ByRos2,
    LcmUrl,
    check_robot,
    make_camera_opener,
    open_link,
)
from gridpush_drake.cli.shell.console import print_notice
from gridpush_drake.errors import StationError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.station.hardware.twin import MakeTwin, Twin
from gridpush_drake.station.hardware.twin_camera import PictureProcess
from gridpush_drake.station.hardware.twin_link import TwinLink
from gridpush_drake.station.links.lcm.lcm_address import DEFAULT_URL
from gridpush_drake.station.links.link import LinkRole
from gridpush_drake.station.scene.contents import use_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.systems.safety.guard_status import GuardMode

DEFAULT_SCENARIO = "grasp"
"""Name of the shipped scenario that robot, twin and tracker use by default."""

EXCHANGE_PERIOD = 0.001
"""How long the twin simulates before it looks at its commands again, s."""

LARGEST_DELAY = 0.05
"""If the twin's time is further behind the clock than this, it does not try to catch up, s."""

LOST_TIME = (
    "The twin is slower than the clock; start robot and twin again with a smaller --realtime-rate."
)
"""What is printed the first time that the twin falls behind the clock."""

Scenario = Annotated[
    Path | None,
    typer.Option(
        "--scenario",
        metavar="NAME|FILE",
        help="What stands where: a shipped scenario's name, or a YAML file. Give robot, twin and "
        "tracker the same one.",
        show_default=DEFAULT_SCENARIO,
    ),
]

ObjectFile = Annotated[
    str | None,
    typer.Option(
        "--object",
        metavar="NAME|FILE",
        help="The object on the table: a shipped object's name, or an object file.",
        show_default="the scenario's",
    ),
]

RealtimeRate = Annotated[
    float,
    typer.Option(
        min=0.001,
        metavar="R",
        help="How many seconds the twin simulates in one second. A computer that is too slow for 1 "
        "needs less. Give twin and robot the same; with a real robot leave it at 1.",
    ),
]


def twin(
    scenario_file: Scenario = None,
    object_file: ObjectFile = None,
    lcm: LcmUrl = DEFAULT_URL,
    ros2: ByRos2 = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of everything random.", show_default="the scenario's"),
    ] = None,
    realtime_rate: RealtimeRate = 1.0,
) -> None:
    """Simulate a robot that `gridpush robot` can move as if it were a real one.

    The twin sends and receives the messages of the robot's driver, over LCM or ROS 2. It tells
    where the objects are, or sends a camera's pictures if the scenario has camera.kind rgbd. It
    runs until Ctrl-C ends it.

    Example: gridpush twin --scenario grasp
    """
    scenario, obj = read_robot_scenario(scenario_file, object_file, seed)
    source = scenario_file or DEFAULT_SCENARIO
    resolved = resolve(scenario, source, known_object=obj)
    try:
        check_robot(resolved.robot, ros2)
    except StationError as error:
        raise StationError(f"{source}: {error}") from error
    network = open_link(LinkRole.ROBOT, resolved, ros2, lcm)
    link = TwinLink(network, resolved.robot)
    diagram = MakeTwin(resolved, network.send)
    simulator = Simulator(diagram)
    diagram.SetStart(simulator.get_mutable_context())
    simulator.set_target_realtime_rate(realtime_rate)
    simulator.Initialize()
    print_notice(
        f"The twin speaks on {network.where} as the arm {diagram.world.setting.robot.arm_model}; "
        "Ctrl-C ends it."
    )
    camera = None
    if scenario.camera.kind == "rgbd":
        camera = PictureProcess(scenario, make_camera_opener(scenario, ros2, lcm))
    picture_period = 1 / scenario.camera.rate
    try:
        _run(diagram, simulator, link, camera, picture_period, realtime_rate)
    except KeyboardInterrupt:
        left_out = link.describe_left_out()
        ending = f"; {left_out}" if left_out else ""
        time = simulator.get_context().get_time()
        print_notice(f"The twin ends after {time:.1f} s of its time{ending}.")
    finally:
        if camera is not None:
            camera.close()
        network.close()


def _run(
    diagram: Twin,
    simulator: Simulator,
    link: TwinLink,
    camera: PictureProcess | None,
    picture_period: float,
    realtime_rate: float,
) -> None:
    """Simulates the twin, keeping step with the clock, until KeyboardInterrupt ends it.

    Args:
        diagram: the twin.
        simulator: the simulator of `diagram`.
        link: gives the twin its commands.
        camera: renders and sends pictures; None if the scenario has no such camera.
        picture_period: time between two pictures, s.
        realtime_rate: how many seconds are simulated in one second.
    """
    context = simulator.get_context()
    port = diagram.GetOutputPort("driver.status")
    begin = monotonic()
    next_picture = 0.0
    last_reason = ""
    unusable = 0
    reported_lost_time = False
    while True:
        if camera is not None and context.get_time() >= next_picture:
            camera.ask(context.get_time(), diagram.GetPositions(context))
            next_picture += picture_period
        link.exchange(diagram, simulator.get_mutable_context())
        time = context.get_time() + EXCHANGE_PERIOD
        simulator.AdvanceTo(time)

        # Say why the arm was brought to rest, and which commands could not be used
        status = port.Eval(context)
        if status.reason != last_reason and status.mode == GuardMode.HOLDING:
            print_notice(
                f"{status.since:.2f} s: {status.reason}. The arm came to rest; a command moves it "
                "again."
            )
        last_reason = status.reason
        if len(link.left_out) != unusable:
            unusable = len(link.left_out)
            why = list(link.left_out)[-1]
            print_notice(f"{time:.2f} s: a command was left out: {why}.")

        # A twin that fell behind goes on from its present time. If it caught up instead, it would
        # run faster than the clock, and the robot that is tried with it would see it move too fast.
        behind = (monotonic() - begin) * realtime_rate - time
        if behind > LARGEST_DELAY:
            begin += behind / realtime_rate
            simulator.ResetStatistics()
            if not reported_lost_time:
                print_notice(LOST_TIME)
            reported_lost_time = True


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
        ScenarioError: the scenario's or the object's file cannot be read, or holds what will not
            do.
    """
    scenario = read_scenario(scenario_file or DEFAULT_SCENARIO)
    obj = None if object_file is None else use_object(scenario, object_file, "--object")
    if seed is not None:
        scenario.seed = seed
    return scenario, obj
