"""A small learned player of the environments: a linear rating of places and directions.

Each place of the outline and each direction of a push there has features f: how far along the way
to the goal it pushes, how it turns the object, how near it is to the last push. The push of the
greatest weights . f is made, and its length is tanh(other weights . what is left to do).
`bench.games.environments` trains the weights.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.gym.known_shape import FINGER_OPTIONS, PLACE_COUNT

DIRECTION_ACTIONS = (-0.5, 0.0, 0.5)
"""Directions that the learned player chooses from, as actions."""

RATING_WEIGHTS = 8
"""Number of the learned player's weights that rate a place and a direction."""

WEIGHT_COUNT = RATING_WEIGHTS + 3
"""Number of all its weights; the other three are for the distance."""


def choose_by_weights(weights: Array, seen: dict[str, NDArray[Any]]) -> Array:
    """Chooses the learned player's actions (N, 3) for N observations."""
    count = len(seen["pose"])
    directions = np.array(DIRECTION_ACTIONS)

    # What is wanted of the object's middle, and the outline's size, in the body frame.
    outline = seen["outline"].reshape(count, PLACE_COUNT, 4).astype(np.float64)
    middle = outline[..., :2].mean(axis=1, keepdims=True)
    arm = outline[..., :2] - middle
    size = np.sqrt((arm**2).sum(axis=-1).mean(axis=1))[:, None, None]
    wanted, turn = _find_wanted(seen, middle[:, 0])

    # Direction of each push (N, places, directions), and how it would turn the object.
    low, high = FINGER_OPTIONS.angle_range
    angle = low + (high - low) * (directions + 1) / 2
    c = np.cos(angle)
    s = np.sin(angle)
    nx = outline[..., 2, None]
    ny = outline[..., 3, None]
    ux = c * nx - s * ny
    uy = s * nx + c * ny
    lever = (arm[..., 0, None] * uy - arm[..., 1, None] * ux) / size
    far = np.linalg.norm(wanted, axis=1)[:, None, None]
    along = (ux * wanted[:, 0, None, None] + uy * wanted[:, 1, None, None]) / (
        far + np.finfo(float).tiny
    )

    # How near it is to the last one.
    last = (seen["last_action"][:, :1] + 1) / 2 - np.arange(PLACE_COUNT) / PLACE_COUNT
    pushed = np.abs(seen["last_action"]).max(axis=1) > 0
    near = np.cos(2 * np.pi * last)[..., None] * pushed[:, None, None]
    spin = turn[:, None, None]
    terms = [
        along,
        along * far / size,
        lever * spin,
        np.abs(lever),
        np.abs(lever) * np.abs(spin),
        np.abs(lever) * far / size,
        near,
        np.abs(angle),
    ]
    features = np.stack(np.broadcast_arrays(*terms))

    # The best rated place and direction, and how far to push there.
    rated = np.tensordot(weights[:RATING_WEIGHTS], features, axes=1).reshape(count, -1)
    best = rated.argmax(axis=1)
    place = best // len(directions)
    direction = directions[best % len(directions)]
    reach = np.stack([np.ones(count), far[:, 0, 0] / size[:, 0, 0], np.abs(turn)])
    distance = np.tanh(weights[RATING_WEIGHTS:] @ reach)
    return np.column_stack([2 * place / PLACE_COUNT - 1, direction, distance])


def _find_wanted(seen: dict[str, NDArray[Any]], middle: Array) -> tuple[Array, Array]:
    """Finds by how much each object is to move and to turn, by what is seen.

    Args:
        seen: N observations.
        middle: (N, 2) the object's middle, body frame, m.

    Returns:
        (N, 2) by how much the middle is to move, body frame, m, and (N,) how far to turn, rad.
    """
    pose = seen["pose"].astype(np.float64)
    x, y, c, s = pose.T
    here = np.column_stack(
        [x + c * middle[:, 0] - s * middle[:, 1], y + s * middle[:, 0] + c * middle[:, 1]]
    )
    turn = np.zeros(len(pose))
    if "goal" in seen:
        gx, gy, gc, gs = seen["goal"].astype(np.float64).T
        there = np.column_stack(
            [gx + gc * middle[:, 0] - gs * middle[:, 1], gy + gs * middle[:, 0] + gc * middle[:, 1]]
        )
        turn = np.arctan2(gs * c - gc * s, gc * c + gs * s)
        move = there - here
    elif "estimate" in seen:
        # pushes are made to learn only, wherever they take the object
        move = np.zeros_like(here)
    else:
        # to the nearest edge
        room = seen["table"] - np.abs(here)
        nearest = room.argmin(axis=1)
        move = np.zeros_like(here)
        rows = np.arange(len(here))
        move[rows, nearest] = np.sign(here[rows, nearest]) * room[rows, nearest]
    return np.column_stack([c * move[:, 0] + s * move[:, 1], c * move[:, 1] - s * move[:, 0]]), turn
