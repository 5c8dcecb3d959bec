"""Exact gradients of scenes against central differences."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.friction.laws import FRICTION_LAWS
from gridpush_drake.dynamics.kernels.scene.records import FINGER_BODY
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.push_cases import GEOMETRY, PARAMETERS, ROUND_OFF
from tests.helpers.scene_cases import PLATE, TIPS, SceneCase, make_row
from tests.helpers.shapes import SHAPES

STEPS = 25

PLACES = ("start", "pose", "turn", "stretch", "yaw", "twist", "center")
"""Blocks that are varied by what is added to them."""


def check_scene(case, seed):
    """Checks every block; where contacts or their modes differ within the stencil, there is no derivative."""
    skipped = 0
    for name, value, jacobian in case.blocks():
        if not np.any(np.abs(jacobian) > 1e-9):
            continue
        case.switched = False
        failures = []
        for step in GEOMETRY if name in PLACES else PARAMETERS:
            size = np.abs(value).max() if np.any(value) else 1.0
            floor = ROUND_OFF / (step * size) + 1e-6 * np.abs(jacobian).max()
            try:
                check_jacobian(
                    lambda x, name=name: case.run(**{name: x}).poses,
                    value,
                    jacobian,
                    step=step,
                    order=4,
                    rtol=1e-5,
                    atol=floor,
                )
                break
            except AssertionError as error:
                failures.append(str(error))
        else:
            assert case.switched, f"seed {seed}, {name}: {failures}"
            skipped += 1
    return skipped


SLOW_LAWS = [
    name
    for name, law in FRICTION_LAWS.items()
    if "quasi_static" in law.regimes and True in law.gradients
]
"""The laws by which several objects can be pushed: all that are registered, such as with -p."""


@pytest.mark.parametrize("law", SLOW_LAWS)
@pytest.mark.parametrize(
    ("count", "pusher"), [(2, None), (3, None), (1, TIPS), (1, PLATE), (2, PLATE)]
)
def test_exact_gradients(count, pusher, law):
    skipped = 0
    blocks = 0
    together = 0
    for seed in range(4):
        shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:count]
        scene, push = make_row(seed, shapes, cells=8, pusher=pusher)
        case = SceneCase(scene, push, STEPS, ["coupled", "separate"][seed % 2], law)
        assert case.result.status == "ok"
        skipped += check_scene(case, seed)
        blocks += len(case.blocks())
        bodies = case.result.contact_bodies[:, :, 1]
        touching = case.result.modes != 0
        if count > 1:
            together += bool(touching[bodies >= 0].any())
        else:
            together += bool(((touching & (bodies == FINGER_BODY)).sum(axis=1) > 1).any())
    print(f"{count} objects: {skipped} of {blocks} blocks cross a switch, {together} touch")
    assert together >= (3 if count > 1 else 1)
    assert skipped <= blocks // 3
