"""The step of a scene against cone programs in maximal coordinates."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.contact.contact_modes import SEPARATE
from gridpush_drake.dynamics.kernels.scene.contact_rows import PAIR_COMPLIANCE, PUSHER_COMPLIANCE
from gridpush_drake.dynamics.kernels.scene.records import (
    FRICTION,
    OTHER_CX,
    OTHER_CY,
    OTHER_NX,
    OTHER_NY,
    ROW_CX,
    ROW_CY,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    TIP_VX,
    TIP_VY,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.reference.scene_socp import (
    ContactSide,
    SceneContact,
    solve_scene_socp,
)
from gridpush_drake.dynamics.scene.kernel_call import (
    make_bodies,
    make_pusher_path,
    make_scene_contacts,
    make_scene_state,
    run_scene_kernel,
)
from gridpush_drake.geometry.se2 import rotate
from tests.helpers.scene_cases import PLATE, TIPS, make_row
from tests.helpers.shapes import SHAPES

DT = 0.02
SHAPED_SEEDS = (2, 3)
"""Seeds of the pushes by shaped pushers, which touch with more than one contact."""

AGREEMENT = 1e-6
"""Greatest difference of the cells' velocities, as a fraction of the pusher's speed."""


def read_contacts(contacts, scale, disc):
    """Reads the contacts of the kernel's last step as those of the reference."""
    found = []
    count = contacts.counts[0]
    for ids, numbers in zip(contacts.ids[:count], contacts.numbers[:count], strict=True):
        first = ContactSide(int(ids[0]), numbers[[ROW_NX, ROW_NY]], numbers[[ROW_CX, ROW_CY]])
        second = None
        fraction = PUSHER_COMPLIANCE if disc else PAIR_COMPLIANCE
        if ids[1] >= 0:
            fraction = PAIR_COMPLIANCE
            second = ContactSide(
                int(ids[1]), numbers[[OTHER_NX, OTHER_NY]], numbers[[OTHER_CX, OTHER_CY]]
            )
        found.append(
            SceneContact(
                first,
                second,
                numbers[[TIP_VX, TIP_VY]],
                float(numbers[ROW_GAP]),
                float(numbers[FRICTION]),
                fraction * scale,
            )
        )
    return found


def find_speed(push, time):
    """The speed of the pusher's fastest vertex in a step that begins at a time, m/s."""
    core = np.zeros((1, 2)) if push.shape is None else push.shape.core
    before, after = (
        tip + rotate(yaw, core)
        for tip, yaw in zip(
            push.tip_at([time, time + DT]), push.yaw_at([time, time + DT]), strict=True
        )
    )
    return float(np.linalg.norm(after - before, axis=1).max()) / DT


@pytest.mark.parametrize("spin", ["coupled", "separate"])
@pytest.mark.parametrize(
    ("count", "pusher"), [(1, None), (2, None), (3, None), (1, TIPS), (1, PLATE), (2, PLATE)]
)
def test_steps_agree_with_cone_programs(count, pusher, spin):
    compared = 0
    several = 0
    for seed in range(2) if pusher is None else SHAPED_SEEDS:
        shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:count]
        scene, push = make_row(seed, shapes, cells=8, pusher=pusher)
        physics = Physics(regime="quasi_static", spin=spin)
        bodies = make_bodies(scene.bodies.with_physics(physics))
        state = make_scene_state(scene.poses)
        contacts = make_scene_contacts(count)
        times = np.arange(0, push.duration, DT)
        for step, time in enumerate(times[:-1]):
            record = run_scene_kernel(
                bodies,
                physics,
                pusher=make_pusher_path(push, np.array([time, time + DT])),
                state=state,
                contacts=contacts,
                dts=np.array([DT]),
                row_of_step=np.full(2, -1),
                J=np.empty((0, count, 3, 0)),
            )
            if step % 8 or not contacts.modes[: contacts.counts[0]].any():
                continue
            speed = find_speed(push, time)
            rows = read_contacts(contacts, speed / float(bodies.load.sum()), pusher is None)
            expected = solve_scene_socp(scene.objects, scene.params, rows, DT, speed, spin=spin)
            awake = state.moved > 0
            for b, obj in enumerate(scene.objects):
                if not awake[b]:
                    continue
                off = (record.twists[0, b] - expected.twists[b]) * (1, 1, obj.radius_of_gyration)
                assert np.abs(off).max() < AGREEMENT * speed, (seed, step, b, off / speed)
            compared += 1
            touching = contacts.modes[: contacts.counts[0]] != SEPARATE
            between = contacts.ids[: contacts.counts[0], 1] >= 0
            several += bool((touching & between).any() if count > 1 else touching.sum() > 1)
    print(f"{count} objects, {spin}: {compared} steps, in {several} of them objects touch")
    assert compared >= 8
    assert several >= (4 if count > 1 else int(pusher is not None))
