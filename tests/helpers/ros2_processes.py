"""Twin and controller as processes of their own over ROS 2, in the network namespace that this is run in.

Whatever is said on the topics is watched, spoiled or sent by a node that is written here with rclpy
alone: a stranger to this package. `run_in_namespace` runs a story of this file and returns what it
came to; see `two_processes`.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import yaml

from tests.helpers import two_processes
from tests.helpers.two_processes import PATIENCE, SCENARIO, TwinWatcher, end

RATE = 0.25
"""The twin's seconds in one second: all processes share what computer there is."""

RAW = "raw/joint_states"
"""Where the twin publishes when a stranger stands between it and the controller."""


def find_obstacle() -> str | None:
    """Why there is no ROS 2 on a network of our own here; None where there is."""
    for package in ("rclpy", "sensor_msgs", "trajectory_msgs", "geometry_msgs", "std_msgs"):
        if find_spec(package) is None:
            return f"{package} is not installed, which ROS 2 has"
    return two_processes.find_obstacle()


def run_in_namespace(story: str, folder: Path, *more: str) -> dict:
    """Runs a story; returns what it came to."""
    entering = ["unshare", "-rn", "sh", "-c", two_processes.ENTER, "sh"]
    done = subprocess.run(
        [
            *entering,
            sys.executable,
            "-m",
            "tests.helpers.ros2_processes",
            story,
            str(folder),
            *more,
        ],
        capture_output=True,
        text=True,
        timeout=3 * PATIENCE,
        check=False,
        cwd=Path(__file__).parents[2],
        env=make_environment(),
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def make_environment() -> dict[str, str]:
    """What processes of ours are started with."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}


class Stranger(TwinWatcher):
    """A node that knows of the topics and of ROS's messages, and of nothing else.

    Attributes:
        trajectories: when each command came, s, by this computer's clock, and its positions, rad.
        spoil: of the twin's time, s, and a `JointState`: what is published instead; None to
            publish nothing.
    """

    def __init__(self, joints: list[str], topic: str = "joint_states") -> None:
        import rclpy
        from geometry_msgs.msg import PoseStamped
        from rclpy.node import Node
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        super().__init__()
        self._rclpy, self._joints = rclpy, joints
        self.node = Node("stranger")
        self.trajectories: list[tuple[float, list[float]]] = []
        self.seen_topics: set[str] = set()
        self.spoil: Callable | None = None
        self.node.create_subscription(JointState, topic, self._take, qos_profile_sensor_data)
        self.node.create_subscription(
            PoseStamped,
            "object_pose",
            lambda m: self.poses.append((m.pose.position.x, m.pose.position.y)),
            10,
        )
        self.node.create_subscription(
            JointTrajectory, "joint_trajectory_controller/joint_trajectory", self._take_command, 10
        )
        self.relay = self.node.create_publisher(JointState, "joint_states", 10)
        self.commander = self.node.create_publisher(
            Float64MultiArray, "forward_position_controller/commands", 10
        )
        self.command_type = Float64MultiArray

    def watch(self, topic: str, kind: type) -> list:
        """All messages of a topic from now on, as they come."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        came: list = []
        profile = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(kind, topic, came.append, profile)
        return came

    def look(self) -> None:
        """Takes what has come, for at most 10 ms."""
        self._rclpy.spin_once(self.node, timeout_sec=0.01)

    def _take(self, message) -> None:
        if not set(self._joints) <= set(message.name):
            return
        now = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        places = [message.name.index(name) for name in self._joints]
        position = [message.position[place] for place in places]
        self.statuses.append((now, position, [message.velocity[place] for place in places]))
        if self.spoil is not None:
            for each in self.spoil(now, message):
                self.relay.publish(each)

    def _take_command(self, message) -> None:
        self.trajectories.append((time.monotonic(), list(message.points[0].positions)))


IIWA = [f"iiwa_joint_{k}" for k in range(1, 8)]
UR5E = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]


def start(command: str, folder: Path, *more: str, rate: float = RATE, ros: tuple[str, ...] = ()):
    """Starts a command of `gridpush` with a scenario, over ROS 2."""
    arguments = ["--ros2", "--scenario", str(folder / "scenario.yaml")]
    arguments += [*more] if command == "tracker" else ["--realtime-rate", str(rate), *more]
    ros_arguments = ["--ros-args", *ros] if ros else []
    return subprocess.Popen(
        [sys.executable, "-m", "gridpush_drake.cli.main", command, *arguments, *ros_arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=make_environment(),
    )


def start_robot(folder: Path, name: str, *more: str, **options) -> subprocess.Popen:
    out = ["--go", "--json", "--out", str(folder / name)]
    return start("robot", folder, "--task", "identify", *out, *more, **options)


def finish(twin: subprocess.Popen) -> dict:
    """Ends a twin by Ctrl-C; returns how that went."""
    twin.send_signal(signal.SIGINT)
    _, err = twin.communicate(timeout=PATIENCE)
    return {"twin_code": twin.returncode, "twin_err": err}


def do_task(folder: Path, robot: str = "iiwa14", command: str = "trajectory") -> dict:
    """A task from its beginning to its end, while somebody looks on; by either kind of controller."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseWithCovarianceStamped
    from nav_msgs.msg import Path as PathMessage
    from visualization_msgs.msg import MarkerArray

    (folder / "scenario.yaml").write_text(f"robot: {robot}\n{SCENARIO}")
    stranger = Stranger(UR5E if robot == "ur5e" else IIWA)
    own = "/gridpush_robot"
    shown = {
        "push": stranger.watch(f"{own}/push", PathMessage),
        "center": stranger.watch(f"{own}/center_of_mass", PoseWithCovarianceStamped),
        "cells": stranger.watch(f"{own}/cells", MarkerArray),
    }
    # latched topics only are watched so; diagnostics are not
    diagnostics: list = []
    stranger.node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, 10)
    twin = start("twin", folder)
    stranger.until_there()
    process = start_robot(folder, "robot", ros=("-p", f"command:={command}"))
    stranger.until(lambda: process.poll() is not None, "the end")
    told = {"robot": end(process, "robot", folder), "trajectories": len(stranger.trajectories)}
    told["shown"] = {name: len(messages) for name, messages in shown.items()}
    told["levels"] = sorted({each.status[0].level[0] for each in diagnostics})
    center = shown["center"][-1].pose if shown["center"] else None
    if center is not None:
        told["center"] = [center.pose.position.x, center.pose.position.y]
        told["variance"] = [center.covariance[0], center.covariance[7]]
    told["last_pose"] = stranger.poses[-1]
    return told | finish(twin)


def lose_controller(folder: Path) -> dict:
    """The controller is killed in the middle of a push; begun again it is interrupted, and then finishes."""
    stranger, twin, told = Stranger(IIWA), start("twin", folder), {}
    stranger.until_there()
    killed = start_robot(folder, "killed")
    stranger.until_pushing()
    killed.kill()
    fault = stranger.statuses[-1][0]
    stranger.for_seconds(1.0)
    killed.communicate()
    told["killed"] = stranger.describe_stop(fault)

    interrupted = start_robot(folder, "interrupted")
    stranger.until_pushing()
    interrupted.send_signal(signal.SIGINT)
    fault = stranger.statuses[-1][0]
    stranger.for_seconds(1.0)
    told["interrupted"] = stranger.describe_stop(fault) | end(interrupted, "interrupted", folder)

    finished = start_robot(folder, "finished")
    stranger.until(lambda: finished.poll() is not None, "the end")
    told["finished"] = end(finished, "finished", folder)
    return told | finish(twin)


def lose_twin(folder: Path) -> dict:
    """Nobody is there; then the twin is killed in the middle of a push."""
    alone = start("robot", folder, "--task", "identify")
    told = {"alone": end(alone, "alone", folder)}
    stranger, twin = Stranger(IIWA), start("twin", folder)
    stranger.until_there()
    robot = start_robot(folder, "robot")
    stranger.until_pushing()
    twin.kill()
    killed = time.monotonic()
    twin.communicate()
    stranger.until(lambda: robot.poll() is not None, "the end")
    told["robot"] = end(robot, "robot", folder)
    q = np.array([position for _, position in stranger.trajectories])
    told["commands_for"] = RATE * (stranger.trajectories[-1][0] - killed)
    told["largest_step"] = float(np.abs(np.diff(q, axis=0)).max())
    return told


def spoil_statuses(folder: Path, fault: str) -> dict:
    """A stranger hands the twin's statuses on, and spoils them while the arm pushes: for good, or one in ten."""
    from copy import deepcopy

    stranger = Stranger(IIWA, RAW)
    begun: list[float] = []
    kept: list = []
    count = [0]

    def spoil(now: float, message):
        kept.append(message)
        if not begun:
            return [message]
        count[0] += 1
        tenth, last = count[0] % 10 == 0, kept[-2]
        if fault == "doubled":
            return [message, message]
        if fault == "reordered":
            return [message, last] if tenth else [message]
        if fault == "late":
            return [kept[-6]]
        changed = deepcopy(message)
        if fault == "not_finite":
            changed.velocity[3] = float("nan")
            return [changed] if tenth else [message]
        if fault == "incomplete":
            changed.position = changed.position[:3]
            return [changed] if tenth else [message]
        if fault == "future":
            changed.header.stamp.sec += 3600
            return [changed] if tenth else [message]
        if fault == "frozen":
            changed.position, changed.velocity = begun_at[0].position, begun_at[0].velocity
            return [changed]
        assert fault == "lost"
        return []

    begun_at: list = []
    stranger.spoil = spoil
    twin = start("twin", folder, ros=("-r", f"joint_states:={RAW}"))
    stranger.until_there()
    robot = start_robot(folder, "robot")
    stranger.until_pushing()
    begun_at.append(kept[-1])
    begun.append(stranger.statuses[-1][0])
    stranger.until(lambda: robot.poll() is not None, "the end")
    stranger.for_seconds(0.5)
    told = stranger.describe_stop(begun[0]) | {"robot": end(robot, "robot", folder)}
    return told | finish(twin)


def command_twin(folder: Path) -> dict:
    """A stranger moves the twin's arm through its own topic, in a namespace, and then sends what is no command."""
    stranger_node = Stranger(IIWA)
    twin = start("twin", folder)
    stranger_node.until_there()
    begin = list(stranger_node.statuses[-1][1])
    goal = np.array(begin) + [0.1, 0, 0, 0, 0, 0, 0]
    steps = 400
    for step in range(1, steps + 1):
        q = np.array(begin) + (goal - begin) * min(1.0, step / 300)
        stranger_node.commander.publish(stranger_node.command_type(data=q.tolist()))
        seen = len(stranger_node.statuses)
        stranger_node.until(lambda seen=seen: len(stranger_node.statuses) > seen, "a status")
    told = {"moved": (np.array(stranger_node.statuses[-1][1]) - begin).tolist()}
    for data in ([0.0] * 3, [float("nan")] * 7, [1e9] * 7):
        stranger_node.commander.publish(stranger_node.command_type(data=data))
    stranger_node.for_seconds(0.5)
    told["after"] = (np.array(stranger_node.statuses[-1][1]) - begin).tolist()
    return told | finish(twin)


def see_by_pictures(folder: Path) -> dict:
    """The object is found in the twin's pictures, followed in them and pushed, all over ROS 2."""
    (folder / "scenario.yaml").write_text(two_processes.SEEN_SCENARIO)
    stranger, rate = Stranger(IIWA), two_processes.SEEING_RATE
    twin, found = start("twin", folder, rate=rate), folder / "object.yaml"
    tracker = start("tracker", folder, "--out", str(found))
    stranger.until(lambda: bool(stranger.poses) and found.exists(), "the tracker")
    robot = start_robot(folder, "robot", "--object", str(found), rate=rate)
    stranger.until(lambda: robot.poll() is not None, "the end")
    told = {"robot": end(robot, "robot", folder), "poses": len(stranger.poses)}
    tracker.send_signal(signal.SIGINT)
    _, err = tracker.communicate(timeout=PATIENCE)
    return told | {"tracker_code": tracker.returncode, "tracker_err": err} | finish(twin)


def whole_story(folder: Path, robot: str, rate: str, *seeds: str) -> list[dict]:
    """Poked, learned, slid, grasped and lifted, for each of some seeds; minutes each, so no test."""
    shipped = Path(__file__).parents[2] / "models/scenarios/grasp.yaml"
    scenario = yaml.safe_load(shipped.read_text())
    if robot != "iiwa14":
        del scenario["directives"]
        scenario["robot"] = robot
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    told = []
    for seed in seeds:
        stranger = Stranger(UR5E if robot == "ur5e" else IIWA)
        twin = start("twin", folder, "--seed", seed, rate=float(rate))
        stranger.until_there()
        stranger.node.destroy_node()
        more = ["--task", "pregrasp", "--go", "--json", "--seed", seed, "--out", str(folder / seed)]
        process = start("robot", folder, *more, rate=float(rate))
        out, err = process.communicate()
        told.append(
            {"seed": seed, "code": process.returncode, **json.loads(out or "{}"), "err": err}
        )
        told[-1] |= finish(twin)
    return told


STORIES = {
    story.__name__: story
    for story in (
        do_task,
        lose_controller,
        lose_twin,
        spoil_statuses,
        command_twin,
        see_by_pictures,
        whole_story,
    )
}


def main(story: str, folder: str, *more: str) -> None:
    """Tells a story."""
    import rclpy

    (Path(folder) / "scenario.yaml").write_text(SCENARIO)
    rclpy.init(args=["stranger"])
    print(json.dumps(STORIES[story](Path(folder), *more)))


if __name__ == "__main__":
    main(*sys.argv[1:])
