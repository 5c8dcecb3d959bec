"""Pushes of a hidden body in MuJoCo that are chosen one after another by what tells most.

After each push the body is learned from all pushes so far. The next one is the push that is then
expected to tell most of the center of friction, as a robot chooses its pokes
(`planning.exploration`). To compare the choices alone, all else is as it is for the random
pushes of `bench.truth.sets`: the body is put back in the middle of the table before each push, and
pushes are as long, begin as near to the body, and are seen as often.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.truth.mujoco_world import MujocoWorld
from gridpush_drake.bench.truth.sets import (
    DESIGNED_PUSHES,
    PUSH_LENGTH,
    PUSHER_CLEARANCE,
    SPEED_RANGE,
    TruthSet,
    draw_world,
)
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration.designed_pokes import DesignedPokes, PokeOptions
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

BODY_POSE = np.zeros(3)
"""Pose in which the body is put down before each push, m and rad: the middle of the table."""

PUSH_SEPARATIONS = (PokeOptions().min_separation, PokeOptions().min_separation / 2, 0.0)
"""Fractions of the outline's length by which a push begins away from all pushes before it. The
first one is asked for; where no such place is left, the next one."""

SAME_LOADS = 1e-3
"""Greatest difference of the loads of a body that is made anew from those that were written of it,
as a fraction of its weight."""


def choose_pushes(made: TruthSet, world: MujocoWorld, count: int) -> PushLog:
    """Pushes a body several times, each time where it is expected to tell most.

    The first pushes are the same however many are made.

    Args:
        made: the set of the body; only what whoever learns sees of it is used.
        world: the world of that body.
        count: number of pushes.

    Returns:
        The pushes in the order in which they were chosen.

    Raises:
        GridPushError: no push touches the body.
    """
    model = Belief.of_prior(made.obj)
    found = None
    seen = list[ObservedPush]()
    while len(seen) < count:
        push = _choose_push(model, world.radius)
        world.put(BODY_POSE)
        seen.append(replace(world.execute(push), name=f"push_{len(seen) + 1}"))
        if len(seen) < count:
            log = PushLog(tuple(seen))
            found = identify(Model(made.obj), log, start=found)
            model = Belief.of_identification(found, log=log)
    return PushLog(tuple(seen))


def _choose_push(model: Belief, radius: float) -> Push:
    """Chooses the push that is expected to tell most, by a disc of a radius, m."""
    for separation in PUSH_SEPARATIONS:
        options = PokeOptions(
            Pusher(radius, float(np.mean(SPEED_RANGE)), PUSHER_CLEARANCE),
            distance=PUSH_LENGTH,
            min_separation=separation,
        )
        push = DesignedPokes(options).propose(model, BODY_POSE, PushConstraints()).push
        if push is not None:
            return push
    raise GridPushError(f"{model.obj.name}: no push is predicted to move it; expected some")


def find_designed_pushes(
    made: TruthSet, count: int, folder: Path | None = None, anew: bool = False
) -> PushLog:
    """Reads the pushes of a set that were chosen by design, or makes them.

    Args:
        made: the set.
        count: number of pushes.
        folder: folder of the set, where they are looked up, and left if they have to be made; None
            keeps none.
        anew: whether to make them even if they are there.

    Raises:
        GridPushError: a file is not of its form, the body cannot be made anew, or MuJoCo is not
            installed.
        OutputError: the file cannot be written.
    """
    path = None if folder is None else folder / DESIGNED_PUSHES
    if path is not None and path.exists() and not anew:
        log = PushLog.read_csv(path, made.obj.prior.pusher_radius)
        if len(log) >= count:
            return log[:count]
    _, world, _ = draw_world(made.kind, made.name, made.seed)
    weight = float(made.loads.sum())
    if len(world.loads) != made.obj.n or not np.allclose(
        world.loads, made.loads, rtol=0.0, atol=SAME_LOADS * weight
    ):
        raise GridPushError(
            f"{folder}: holds another body than seed {made.seed} draws; expected one that this "
            "version made (pass --force to make it anew)"
        )
    log = choose_pushes(made, world, count)
    if path is not None:
        log.write_csv(path, force=True)
    return log
