"""Twin, tracker and controller as processes of their own on LCM's UDP, in the network namespace that this is run in.

`run_in_namespace` makes such a namespace and runs this file in it, with the name of a story and a
folder; what the story came to is one JSON document on standard output.
"""

import fcntl
import json
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

URL = "udpm://239.255.76.67:7667?ttl=0"

RATE = 0.2
"""The twin's seconds in one second: all processes share what computer there is."""

SEEING_RATE = 0.1
"""Likewise where pictures are rendered, too."""

ENTER = 'ip link set lo up multicast on && ip route add 239.0.0.0/8 dev lo && exec "$@"'

SCENARIO = """
object: open_book
object_pose: [0.55, 0.0, 0.0]
base: planar
pokes: {count: 1, test_count: 0, speed: 0.06}
"""

SEEN_SCENARIO = """
object: claw_hammer
object_pose: [0.6, -0.15, 0.5]
base: planar
pokes: {count: 1, test_count: 0, speed: 0.06}
camera: {kind: rgbd, rate: 10}
"""

NEAR = 1e-3
"""rad, of a joint that is where it is held."""

MOVED = 0.008
"""m, that the object has been pushed by in the middle of a push."""

PATIENCE = 240.0
"""s, wall, for anything."""

STEERING_WAITS = 3
"""How many times PATIENCE a whole slalom may take."""


def find_obstacle() -> str | None:
    """Why there can be no such namespace here; None where there can."""
    probe = ["unshare", "-rn", "sh", "-c", ENTER, "sh", "true"]
    try:
        done = subprocess.run(probe, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"no network namespace can be made here: {error}"
    return (
        None
        if done.returncode == 0
        else f"no network namespace can be made here: {done.stderr.strip()}"
    )


def run_in_namespace(story: str, folder: Path) -> dict:
    """Runs a story; returns what it came to."""
    command = [
        "unshare",
        "-rn",
        "sh",
        "-c",
        ENTER,
        "sh",
        sys.executable,
        __file__,
        story,
        str(folder),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=5 * PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class TwinWatcher:
    """Somebody who watches a twin, and waits for what happens to it; how it is heard is a child's `look`.

    Attributes:
        statuses: (time, positions, velocities) of the arm, s, rad and rad/s.
        poses: of the object; the first two numbers of each are x and y, m.
    """

    def __init__(self) -> None:
        self.statuses: list[tuple[float, list[float], list[float]]] = []
        self.poses: list = []

    def look(self) -> None:
        """Takes what has come, for at most 10 ms."""
        raise NotImplementedError

    def until(self, done: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not done():
            self.look()
            if time.monotonic() > end:
                raise TimeoutError(what)

    def until_there(self) -> None:
        """Until the twin is heard of."""
        self.until(lambda: bool(self.statuses and self.poses), "the twin")

    def until_pushing(self) -> None:
        """Until the object has begun to be pushed."""
        begin = np.array(self.poses[-1][:2])
        self.until(
            lambda: bool(np.linalg.norm(np.array(self.poses[-1][:2]) - begin) > MOVED), "a push"
        )

    def for_seconds(self, seconds: float) -> None:
        """Through so many of the twin's seconds."""
        end = self.statuses[-1][0] + seconds
        self.until(lambda: self.statuses[-1][0] > end, "the twin's time")

    def describe_stop(self, fault: float) -> dict:
        """How the arm came to rest after a fault, and stayed there; the twin's seconds."""
        held = np.array(self.statuses[-1][1])
        away = [
            row[0] for row in self.statuses if row[0] > fault and np.abs(held - row[1]).max() > NEAR
        ]
        rest = max(away, default=fault)
        before = [row[2] for row in self.statuses if row[0] <= fault][-1]
        return {
            "speed_before": float(np.abs(before).max()),
            "stopped_within": rest - fault,
            "held_for": self.statuses[-1][0] - rest,
        }


class Watch(TwinWatcher):
    """What is said on the network, by LCM."""

    def __init__(self) -> None:
        from drake import lcmt_iiwa_command, lcmt_iiwa_status, lcmt_planar_manipuland_status
        from pydrake.lcm import DrakeLcm

        super().__init__()
        self.lcm = DrakeLcm(URL)
        self.commands: list[list[float]] = []
        self.commands_since_status = 0

        def take_status(data: bytes) -> None:
            message = lcmt_iiwa_status.decode(data)
            row = (
                1e-6 * message.utime,
                message.joint_position_measured,
                message.joint_velocity_estimated,
            )
            self.statuses.append(row)
            self.commands_since_status = 0

        def take_command(data: bytes) -> None:
            self.commands_since_status += 1
            self.commands.append(lcmt_iiwa_command.decode(data).joint_position)

        self.lcm.Subscribe("IIWA_STATUS", take_status)
        self.lcm.Subscribe("IIWA_COMMAND", take_command)
        self.lcm.Subscribe(
            "PLANAR_MANIPULAND_STATUS",
            lambda data: self.poses.append(lcmt_planar_manipuland_status.decode(data).position),
        )

    def look(self) -> None:
        """Takes what has come, for at most 10 ms."""
        self.lcm.HandleSubscriptions(10)


def start(command: str, folder: Path, *more: str, rate: float | None = RATE) -> subprocess.Popen:
    speed = [] if rate is None else ["--realtime-rate", str(rate)]
    arguments = ["--scenario", str(folder / "scenario.yaml"), "--lcm", URL, *speed, *more]
    return subprocess.Popen(
        [sys.executable, "-m", "gridpush_drake.cli.main", command, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )


def start_robot(folder: Path, name: str) -> subprocess.Popen:
    return start(
        "robot", folder, "--task", "identify", "--go", "--json", "--out", str(folder / name)
    )


def end(process: subprocess.Popen, name: str, folder: Path) -> dict:
    """What a process of the controller ended with."""
    out, err = process.communicate(timeout=PATIENCE)
    log = folder / name / "robot.log"
    return {
        "code": process.returncode,
        "summary": json.loads(out) if out.strip() else None,
        "err": err,
        "log": log.read_text() if log.exists() else "",
    }


def lose_controller(folder: Path) -> dict:
    """The controller is killed in the middle of a push; begun again it goes on, is interrupted, and then finishes."""
    told = {}
    watch, twin = Watch(), start("twin", folder)
    watch.until_there()
    killed = start_robot(folder, "killed")
    watch.until_pushing()
    killed.kill()
    fault = watch.statuses[-1][0]
    watch.for_seconds(1.0)
    killed.communicate()
    told["killed"] = watch.describe_stop(fault)

    interrupted = start_robot(folder, "interrupted")
    watch.until_pushing()
    interrupted.send_signal(signal.SIGINT)
    fault = watch.statuses[-1][0]
    watch.for_seconds(1.0)
    told["interrupted"] = watch.describe_stop(fault) | end(interrupted, "interrupted", folder)

    finished = start_robot(folder, "finished")
    watch.until(lambda: finished.poll() is not None, "the end")
    told["finished"] = end(finished, "finished", folder)
    twin.send_signal(signal.SIGINT)
    told["twin_code"] = twin.wait(PATIENCE)
    return told


def lose_terminal(folder: Path) -> dict:
    """The controller's terminal is lost in the middle of a push, as by an ssh connection that breaks."""
    watch, twin = Watch(), start("twin", folder)
    watch.until_there()
    ours, its = pty.openpty()
    arguments = ["--scenario", str(folder / "scenario.yaml"), "--lcm", URL]
    more = [
        "--realtime-rate",
        str(RATE),
        "--task",
        "identify",
        "--go",
        "--out",
        str(folder / "lost"),
    ]
    robot = subprocess.Popen(
        [sys.executable, "-m", "gridpush_drake.cli.main", "robot", *arguments, *more],
        stdin=its,
        stdout=its,
        stderr=its,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    os.close(its)
    watch.until_pushing()
    os.close(ours)  # the kernel sends SIGHUP, and every write fails from now on
    fault = watch.statuses[-1][0]
    watch.for_seconds(1.0)
    told = watch.describe_stop(fault)
    watch.until(lambda: robot.poll() is not None, "the end")
    files = sorted(path.name for path in (folder / "lost").iterdir())
    log = (folder / "lost/robot.log").read_text()
    twin.send_signal(signal.SIGHUP)
    _, err = twin.communicate(timeout=PATIENCE)
    return {
        **told,
        "code": robot.returncode,
        "files": files,
        "log": log,
        "twin_code": twin.returncode,
        "twin_err": err,
    }


def lose_twin(folder: Path) -> dict:
    """The twin is killed in the middle of a push; with another one the controller begins anew."""
    alone = start("robot", folder, "--task", "identify")
    told = {"alone": end(alone, "alone", folder)}
    watch, twin = Watch(), start("twin", folder)
    watch.until_there()
    robot = start_robot(folder, "robot")
    watch.until_pushing()
    twin.kill()
    twin.communicate()
    watch.until(lambda: robot.poll() is not None, "the end")
    told["robot"] = end(robot, "robot", folder)
    told["commands_after_last_status"] = watch.commands_since_status
    told["largest_step"] = float(np.abs(np.diff(watch.commands, axis=0)).max())

    again = start("twin", folder)
    seen = len(watch.statuses)
    watch.until(lambda: len(watch.statuses) > seen, "the second twin")
    told["looked"] = end(start("robot", folder, "--task", "identify", "--json"), "looked", folder)
    again.kill()
    again.communicate()
    return told


def record_a_run(folder: Path) -> dict:
    """The controller records a whole run, for Rerun, too, where that is installed."""
    has_rerun = find_spec("rerun") is not None
    watch, twin = Watch(), start("twin", folder)
    watch.until_there()
    more = ["--task", "identify", "--go", "--json", "--out", str(folder / "robot")]
    more += ["--record", str(folder / "run.mcap")]
    more += ["--rerun", str(folder / "run.rrd")] if has_rerun else []
    robot = start("robot", folder, *more)
    watch.until(lambda: robot.poll() is not None, "the end")
    twin.send_signal(signal.SIGINT)
    twin.communicate(timeout=PATIENCE)
    return {"robot": end(robot, "robot", folder), "rerun": has_rerun}


def see_by_pictures(folder: Path, rate: str = str(SEEING_RATE)) -> dict:
    """The object is found in the pictures of the twin's camera, followed in them, and pushed; then nobody looks."""
    (folder / "scenario.yaml").write_text(SEEN_SCENARIO)
    watch, twin = Watch(), start("twin", folder, rate=float(rate))
    found = folder / "object.yaml"
    tracker = start("tracker", folder, "--out", str(found), rate=None)
    watch.until(lambda: bool(watch.poses) and found.exists(), "the tracker")
    more = [
        "--task",
        "identify",
        "--go",
        "--json",
        "--object",
        str(found),
        "--out",
        str(folder / "robot"),
    ]
    robot = start("robot", folder, *more, rate=float(rate))
    watch.until(lambda: robot.poll() is not None, "the end")
    told = {"robot": end(robot, "robot", folder), "poses": len(watch.poses)}
    tracker.send_signal(signal.SIGINT)
    out, err = tracker.communicate(timeout=PATIENCE)
    told["tracker"] = {"code": tracker.returncode, "out": out, "err": err}
    more = ["--task", "identify", "--object", str(found), "--out", str(folder / "blind")]
    told["blind"] = end(start("robot", folder, *more, rate=float(rate)), "blind", folder)
    twin.send_signal(signal.SIGINT)
    told["twin_code"] = twin.wait(PATIENCE)
    return told


def steer_through_the_slalom(folder: Path, rate: str = str(SEEING_RATE)) -> dict:
    """A finger is steered, and pushes a learned object through the shipped slalom; minutes, so no test."""
    (folder / "scenario.yaml").write_text(
        (Path(__file__).parents[2] / "models/scenarios/slalom.yaml").read_text()
    )
    watch, twin = Watch(), start("twin", folder, rate=float(rate))
    watch.until_there()
    more = ["--task", "follow", "--go", "--json", "--seed", "1", "--out", str(folder / "robot")]
    robot = start("robot", folder, *more, rate=float(rate))
    # each of the pokes, the way there and the slalom itself may take as long as anything else
    watch.until_pushing()
    begin = watch.statuses[-1][0]
    for _ in range(STEERING_WAITS):
        try:
            watch.until(lambda: robot.poll() is not None, "the end")
            break
        except TimeoutError:
            continue
    told = {"robot": end(robot, "robot", folder), "twin_seconds": watch.statuses[-1][0] - begin}
    twin.send_signal(signal.SIGINT)
    told["twin_code"] = twin.wait(PATIENCE)
    told["last_pose"] = list(watch.poses[-1])
    return told


def whole_story(folder: Path, *seeds: str) -> list[dict]:
    """Poked, learned, slid, grasped and lifted in real time, for each of some seeds; minutes each, so no test."""
    (folder / "scenario.yaml").write_text(
        (Path(__file__).parents[2] / "models/scenarios/grasp.yaml").read_text()
    )
    told = []
    for seed in seeds:
        watch, twin = Watch(), start("twin", folder, "--seed", seed, rate=1.0)
        watch.until(lambda watch=watch: bool(watch.statuses and watch.poses), "the twin")
        more = ["--task", "pregrasp", "--go", "--json", "--seed", seed, "--out", str(folder / seed)]
        robot = start("robot", folder, *more, rate=1.0)
        out, err = robot.communicate()
        told.append({"seed": seed, "code": robot.returncode, **json.loads(out or "{}"), "err": err})
        twin.send_signal(signal.SIGINT)
        twin.communicate()
    return told


STORIES = {
    story.__name__: story
    for story in (
        lose_controller,
        lose_terminal,
        lose_twin,
        record_a_run,
        see_by_pictures,
        steer_through_the_slalom,
        whole_story,
    )
}


def main(story: str, folder: str, *more: str) -> None:
    """Tells a story."""
    (Path(folder) / "scenario.yaml").write_text(SCENARIO)
    print(json.dumps(STORIES[story](Path(folder), *more)))


if __name__ == "__main__":
    main(*sys.argv[1:])
