"""A few grasps that differ, of many that are near copies: what an arm is asked about, which takes time."""

from collections.abc import Sequence

import numpy as np

from gridpush_drake.planning.side_grasp import SideGrasp

APART = 0.01
"""m between grasp points, from which on two grasps differ."""

TURNED = np.radians(12)
"""Likewise between headings."""


def choose_varied(
    grasps: Sequence[SideGrasp], count: int, *, apart: float = APART, turned: float = TURNED
) -> list[SideGrasp]:
    """Chooses the first grasps, each unlike all chosen before it.

    Args:
        grasps: the best first.
        count: how many to choose, at most.
        apart: grasp points at this distance differ, m.
        turned: headings with this angle between them differ, rad.

    Returns:
        The chosen ones, in their order.
    """
    p_WG = np.array([grasp.p_WG for grasp in grasps]).reshape(-1, 2)
    approach = np.array([grasp.approach for grasp in grasps])
    left, chosen = np.arange(len(grasps)), list[SideGrasp]()
    while len(left) and len(chosen) < count:
        best, left = left[0], left[1:]
        chosen.append(grasps[best])
        off = np.linalg.norm(p_WG[left] - p_WG[best], axis=1)
        angle = np.abs((approach[left] - approach[best] + np.pi) % (2 * np.pi) - np.pi)
        left = left[(off >= apart) | (angle >= turned)]
    return chosen
