"""Loads the compiled kernels before a command needs them, or compiles them.

Kernels are the functions in which pushes are simulated. Where they have to be compiled and there is
a second core, a second process compiles half of them. A command that has something else to do
first, such as the demo, which makes its station, does it while other processes compile all of them.
Those of several contacts and of steering are compiled where they are first needed, or beforehand by
`gridpush warm-up`.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import (
    KERNELS_FOLDER,
    Others,
    filled_by,
    find_cache_folder,
)
from gridpush_drake.dynamics.kernels.scene.rollout import rollout_scene
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.warm_up import (
    DISC_RADIUS,
    DISC_SPEED,
    SQUARE_SIDE,
    compile_columns,
    compile_rollouts,
    compile_scenes,
    is_compiled,
    make_square,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.contact import contact_kernels, optimize_contact
from gridpush_drake.planning.feedback import FollowOptions, PushFollower, plan_pose_path
from gridpush_drake.planning.feedback.push_search import search_push
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp import stability
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.support_surface import SupportSurface

SECOND_PROCESS_CODE = "from gridpush_drake.cli.shell.kernels import compile_apart; compile_apart()"
"""Python code that the second process runs."""

SCENES_CODE = "from gridpush_drake.dynamics.warm_up import compile_scenes; compile_scenes()"
"""Python code of the process that compiles the kernels of several contacts meanwhile."""

THIRD_PROCESS_CODE = "from gridpush_drake.cli.shell.kernels import compile_rest; compile_rest()"
"""Python code that a third process runs, while this one does something else."""

RARE_ROOMS = ("scene", "steering")
"""Folders of the kernels that only some commands need."""

KERNEL_SOURCES = frozenset(
    [
        *(path for path in KERNELS_FOLDER.rglob("*.py") if path.parent.name not in RARE_ROOMS),
        *(Path(str(each.__file__)) for each in (contact_kernels, stability)),
    ]
)
"""Files of the kernels that the second and third process compile."""

MIN_CORES = 2
"""Number of cores with which a second process saves time."""

MAX_COMPILE_TIME = 300.0
"""Time after which nobody waits any longer for kernels that other processes compile, s. They take
less than a minute on two idle cores."""

MAX_COMPILE_WAIT = 60.0
"""Time that the second process is waited for once this one is done, s. Then it is ended: whatever
it has not compiled is compiled when it is first needed."""


def compile_all() -> None:
    """Loads the kernels that commands need, and compiles those that are not in the cache."""
    with _working_apart(SECOND_PROCESS_CODE, needed=not is_compiled()) as processes:
        compile_rest()
        _wait_for(processes)
    compile_apart()


def is_rare_compiled() -> bool:
    """Whether what `compile_rare` compiles is in the cache, as it seems by its files' names."""
    return is_compiled(rollout_scene, search_push)


def compile_rare() -> None:
    """Loads or compiles what only some commands need: of several contacts, and of steering."""
    with _working_apart(SCENES_CODE, needed=not is_rare_compiled()) as processes:
        compile_steering()
        _wait_for(processes)
    compile_scenes()
    compile_steering(PusherShape.plate(SQUARE_SIDE, 2 * DISC_RADIUS, DISC_RADIUS / 2))


@contextmanager
def compiling_meanwhile() -> Iterator[None]:
    """Lets other processes compile the kernels while this one does something else.

    The first call of a kernel then waits for it. Where no other process can do it, or nothing needs
    to be compiled, the kernels are compiled or loaded at once, as by `compile_all`.
    """
    needed = not is_compiled() and find_cache_folder(KERNELS_FOLDER / "rollout.py") is not None
    with _working_apart(THIRD_PROCESS_CODE, SECOND_PROCESS_CODE, needed=needed) as processes:
        if not processes:
            compile_all()
        deadline = time.monotonic() + MAX_COMPILE_TIME

        def is_at_work() -> bool:
            running = any(each.poll() is None for each in processes)
            return running and time.monotonic() < deadline

        with filled_by(Others(KERNEL_SOURCES, is_at_work)):
            yield


def compile_apart() -> None:
    """Compiles the second process's part: what a rollout needs last, and what it does not need."""
    compile_columns()
    compile_margins()


def compile_rest() -> None:
    """Compiles all that `compile_apart` leaves: the third process's part, or this one's."""
    compile_rollouts()
    compile_contact_search()


def compile_contact_search() -> None:
    """Loads or compiles the kernels that choose where to push, by choosing one push."""
    obj = make_square()
    goal = [0.02, 0.0, 0.1]
    optimize_contact(Model(obj), [0.0, 0.0, 0.0], goal)


def compile_margins() -> None:
    """Loads or compiles the kernels of planning a grasp, by calculating one stability margin."""
    obj = make_square()
    masses = PlausibleMassSet.of_masses(Model(obj))
    calc_stability_margin(masses, [0.0, 0.0, 0.0], SupportSurface.round([0.0, 0.0], 1.0))


def compile_steering(shape: PusherShape | None = None) -> None:
    """Loads or compiles the kernels of steering, by deciding on the way to a goal, and on a path.

    Args:
        shape: of a finger that is no disc.
    """
    model = Model(make_square())
    finger = FeedbackFinger(radius=DISC_RADIUS if shape is None else shape.radius, shape=shape)
    goal = np.array([2 * SQUARE_SIDE, 0.0, 0.0])
    path = plan_pose_path(model, np.zeros(3), goal, finger, speed=DISC_SPEED).path
    options = FollowOptions(strokes=1, changes=1, refinements=1, draws=0)
    tip = np.array([-2 * SQUARE_SIDE, 0.0, 0.0])[: finger.coordinates]
    assert path is not None
    for aim in (goal, path):
        follower = PushFollower(model.obj, model.params, aim, finger, options=options)
        follower.add_tip(0.0, tip)
        follower.add_pose(0.0, np.zeros(3))
        follower.decide(0.0, tip)


def _wait_for(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    """Waits until other processes are done, but not longer than `MAX_COMPILE_WAIT` each."""
    with suppress(subprocess.TimeoutExpired):
        for process in processes:
            process.wait(MAX_COMPILE_WAIT)


@contextmanager
def _working_apart(*codes: str, needed: bool) -> Iterator[Sequence[subprocess.Popen[bytes]]]:
    """Lets other processes compile meanwhile, if there is a second core for them.

    If anything goes wrong in one of them, only time is lost: this process compiles whatever it does
    not find in the cache. They are ended with the body.

    Args:
        codes: the Python code of each process.
        needed: whether there is anything to compile.

    Returns:
        The processes; none where they are not needed, or cannot be started.
    """
    processes: list[subprocess.Popen[bytes]] = []
    try:
        if needed and len(os.sched_getaffinity(0)) >= MIN_CORES and sys.executable:
            quiet = subprocess.DEVNULL
            with suppress(OSError):
                for code in codes:
                    processes.append(
                        subprocess.Popen(
                            [sys.executable, "-c", code], stdin=quiet, stdout=quiet, stderr=quiet
                        )
                    )
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
