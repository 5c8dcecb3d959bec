"""How far an object still has to go, round obstacles and past edges: a cost-to-go over its planar poses.

Where nothing is in between, the cost of a pose is the mean cell error to the goal. Where something
is, the poses are cut into a lattice (position of the cells' centroid and angle), those that the
rules forbid are left out, and the shortest paths from the goal found by Dijkstra's algorithm. A
step of the lattice is as long as the cells move, about

    sqrt(dx² + dy² + rho² dtheta²),   rho the radius of gyration.

The path is a slid object's, not a pushed one's: it says where to go next, and pushes are then
searched for.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from gridpush_drake.geometry.se2 import Array, rotate, transform, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.push_constraints import PushChecker

LATTICE_STEP = (
    0.03  # m between positions of the lattice; made wider where MAX_POSITIONS would be exceeded
)

MAX_POSITIONS = 2500
TURNS = 24  # angles of the lattice, in a whole turn
ROOM = 0.25  # m about start, goal and obstacles within which paths are searched for, where there is no table
LINE_STEP = 0.01  # m between poses that are checked along a straight path, as their cells move

NEIGHBORS = np.array(
    [
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, 1),
        (1, 1, 0),
        (1, -1, 0),
        (1, 0, 1),
        (1, 0, -1),
        (0, 1, 1),
        (0, 1, -1),
    ]
)
"""Half of a lattice pose's neighbors; the others are their mirror images."""


class CostToGo:
    """The cost-to-go of one object to one goal under the rules.

    Attributes:
        obj: the object.
        goal: (3,) pose.
        checker: the rules.
        direct: whether nothing can be in between: no obstacles, and a table that is convex or none.
    """

    def __init__(self, obj: GridObject, start: Array, goal: Array, checker: PushChecker) -> None:
        """Prepares the lattice, where one is needed."""
        self.obj, self.goal, self.checker = obj, goal, checker
        self._centroid = obj.p_BC.mean(axis=0)
        self.direct = not checker.has_obstacles and checker.table_is_convex
        if not self.direct:
            self._build(start)

    def calc_cost(self, pose: Array) -> float:
        """The cost-to-go of a pose (3,), m; infinite where no path leads to the goal."""
        if self.direct or self.is_clear(pose, self.goal):
            return float(calc_goal_error(self.obj, pose, self.goal))
        return self._enter(pose)[1]

    def find_subgoals(self, pose: Array) -> list[Array]:
        """Poses (3,) to aim for: the goal where nothing is in between, else places along the path; none without one."""
        if self.direct or self.is_clear(pose, self.goal):
            return [self.goal]
        node, cost = self._enter(pose)
        if not np.isfinite(cost):
            return []
        path = [self._poses[node]]
        while self._next[node] >= 0:
            node = int(self._next[node])
            path.append(self._poses[node])
        path.append(self.goal)
        seen = [i for i, at in enumerate(path) if self.is_clear(pose, at)]
        furthest = seen[-1] if seen else 0
        chosen = {furthest, (furthest + 1) // 2, min(furthest + 2, len(path) - 1)}
        return [path[i] for i in sorted(chosen, reverse=True)]

    def is_clear(self, a: Array, b: Array) -> bool:
        """Whether the object can be moved and turned straight from pose a (3,) to pose b (3,)."""
        turn = float(wrap_angle(b[2] - a[2]))
        radius = float(np.linalg.norm(self.obj.p_BC - self._centroid, axis=1).max())
        length = (
            float(np.abs(self.obj.cells_at(a) - self.obj.cells_at(b)).max()) + abs(turn) * radius
        )
        share = np.linspace(0.0, 1.0, 2 + int(length / LINE_STEP))[:, None]
        center = (1 - share) * self._center(a) + share * self._center(b)
        poses = self._from_center(center, a[2] + share[:, 0] * turn)
        return bool(self.checker.allows_geometry(poses).all())

    def _center(self, pose: Array) -> Array:
        return transform(pose, self._centroid[None])[0]

    def _from_center(self, center: Array, theta: Array) -> Array:
        return np.column_stack([center - rotate(theta, self._centroid), theta])

    def _build(self, start: Array) -> None:
        low, high = self.checker.bounds(
            np.array([self._center(start), self._center(self.goal)]), ROOM
        )
        step = max(LATTICE_STEP, float(np.sqrt(np.prod(high - low) / MAX_POSITIONS)))
        counts = np.append(np.ceil((high - low) / step).astype(int) + 1, TURNS)
        index = np.stack(
            np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1
        ).reshape(-1, 3)
        self._low, self._step, self._counts = low, step, counts
        self._poses = self._from_center(low + step * index[:, :2], 2 * np.pi / TURNS * index[:, 2])
        self._free = self.checker.allows_geometry(self._poses)
        nodes = np.arange(len(index)).reshape(counts)
        rho = self.obj.radius_of_gyration
        rows, columns, weights = [], [], []
        for hop in NEIGHBORS:
            other = index + hop
            inside = ((other[:, :2] >= 0) & (other[:, :2] < counts[:2])).all(axis=1)
            a = np.flatnonzero(inside)
            b = nodes[other[a, 0], other[a, 1], other[a, 2] % TURNS]
            free = self._free[a] & self._free[b]
            rows.append(a[free])
            columns.append(b[free])
            length = float(
                np.hypot(step * np.hypot(hop[0], hop[1]), rho * 2 * np.pi / TURNS * hop[2])
            )
            weights.append(np.full(int(free.sum()), length))
        # The goal is one more node, beside the lattice poses that see it.
        last = len(index)
        near = [
            node for node in self._near(self.goal) if self.is_clear(self.goal, self._poses[node])
        ]
        rows.append(np.full(len(near), last))
        columns.append(np.array(near, dtype=np.int64))
        weights.append(
            np.array([calc_goal_error(self.obj, self._poses[node], self.goal) for node in near])
        )
        data = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
        graph = coo_array(data, shape=(last + 1, last + 1)).tocsr()
        cost, before = dijkstra(graph, directed=False, indices=last, return_predecessors=True)
        self._cost = cost[:last]
        self._next = np.where(before[:last] == last, -1, before[:last])

    def _near(self, pose: Array) -> list[int]:
        """The free lattice poses about a pose."""
        at = np.append((self._center(pose) - self._low) / self._step, pose[2] * TURNS / (2 * np.pi))
        nodes = []
        for offset in np.ndindex(4, 4, 4):
            i, j, k = np.floor(at).astype(int) + np.array(offset) - 1
            if 0 <= i < self._counts[0] and 0 <= j < self._counts[1]:
                node = int(np.ravel_multi_index((i, j, k % TURNS), tuple(self._counts)))
                if self._free[node]:
                    nodes.append(node)
        return nodes

    def _enter(self, pose: Array) -> tuple[int, float]:
        """The lattice pose by which the path leads from a pose, and its whole cost, m."""
        nodes = [node for node in self._near(pose) if np.isfinite(self._cost[node])]
        if not nodes:
            return -1, np.inf
        costs = self._cost[nodes] + np.array(
            [calc_goal_error(self.obj, pose, self._poses[node]) for node in nodes]
        )
        for i in np.argsort(costs):
            if self.is_clear(pose, self._poses[nodes[i]]):
                return nodes[i], float(costs[i])
        return -1, np.inf
