"""Which cells are on the table.

The same as `SupportSurface.contains` of the cells' centres, but quicker: of a convex table only those edges are looked
at that the object reaches, at any of the poses.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.grid.object import GridObject
from gridpush_drake.planning.surface import SupportSurface

ROUND_OFF = 1e-9
"""m."""


def find_held(obj: GridObject, poses: ArrayLike, surface: SupportSurface, inset: float = 0.0) -> NDArray[np.bool_]:
    """Whether cells' centres are on the table.

    Args:
        obj: the object.
        poses: (..., 3) X_WB, m and rad.
        surface: the table.
        inset: m inside the rim that a centre must be.

    Returns:
        (..., n).
    """
    q = np.asarray(poses, dtype=np.float64)
    if not surface.is_convex:
        return surface.contains(obj.cells_at(q), inset)
    normals, offsets = surface.edge_normals, surface.edge_offsets
    reach = float(np.linalg.norm(obj.p_BC, axis=1).max()) + inset + ROUND_OFF
    gaps = (offsets - q[..., :2] @ normals.T).reshape(-1, len(normals))
    near = gaps.min(axis=0) < reach
    if not near.any():
        return np.ones((*q.shape[:-1], obj.n), dtype=bool)
    return np.asarray((offsets[near] - obj.cells_at(q) @ normals[near].T).min(axis=-1) >= inset)
