"""How far an object still has to go, round obstacles and past edges: a cost-to-go over its poses.

Where nothing is in between, the cost of a pose is C, the mean distance of the cells' centers from
where they are at the goal. Where something is in between, the poses are cut into a lattice
(position of the cells' centroid and angle), and those that the rules forbid are left out.
Dijkstra's algorithm finds the shortest paths to the goal over the others. A step of the lattice is
as long as the cells move, about

    sqrt(dx² + dy² + rho² dtheta²),   rho the radius of gyration.

The path is that of an object that is slid freely, not of a pushed one. It says where to go next;
pushes that lead there are then searched for (`docs/theory/planning.md`, section 2).
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from gridpush_drake.geometry.se2 import Array, rotate, transform, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.push_constraints import PushChecker

LATTICE_STEP = 0.03
"""Distance between neighboring positions of the lattice, m. It is made larger where there would be
more positions than `MAX_POSITIONS`."""

MAX_POSITIONS = 2500
"""Greatest number of positions of the lattice."""

TURN_COUNT = 24
"""Number of angles of the lattice, in a whole turn."""

SEARCH_MARGIN = 0.25
"""Where there is no table, paths are searched for as far as this about start, goal and obstacles,
m."""

LINE_STEP = 0.01
"""Greatest way of a cell between two poses that are checked along a straight path, m."""

NEIGHBOR_STEPS = np.array(
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
"""Half of a lattice pose's neighbors, as steps in x, y and angle; the others are their mirror
images."""


class CostToGo:
    """The cost-to-go of one object to one goal under the rules.

    Attributes:
        obj: the object.
        goal: (3,) the goal pose, X_WB, m and rad.
        checker: the rules.
        direct: whether nothing can be in between: there are no obstacles, and the table is convex,
            or there is none.
    """

    def __init__(self, obj: GridObject, start: Array, goal: Array, checker: PushChecker) -> None:
        """Prepares the lattice, where one is needed, so that it reaches as far as `start` (3,)."""
        self.obj = obj
        self.goal = goal
        self.checker = checker
        self._centroid = obj.p_BC.mean(axis=0)
        self.direct = not checker.has_obstacles and checker.table_is_convex
        if not self.direct:
            self._make_lattice(start)
            self._find_paths()

    def calc_cost(self, pose: Array) -> float:
        """The cost-to-go of a pose (3,), m; infinite where no path leads to the goal."""
        if self.direct or self.is_clear(pose, self.goal):
            return float(calc_goal_error(self.obj, pose, self.goal))
        return self._enter(pose)[1]

    def estimate_costs(self, poses: Array) -> Array:
        """Estimates the cost-to-go of many poses at once, by the nearest poses of the lattice.

        Args:
            poses: (K, 3), m and rad.

        Returns:
            (K,) m; infinite where no path leads from the nearest pose of the lattice to the goal,
            or the lattice does not reach so far.
        """
        if self.direct:
            return calc_goal_error(self.obj, poses, self.goal)
        center = transform(poses, self._centroid[None])[:, 0]
        place = np.rint((center - self._low) / self._step).astype(int)
        turn = np.rint(poses[:, 2] * TURN_COUNT / (2 * np.pi)).astype(int) % TURN_COUNT
        inside = ((place >= 0) & (place < self._counts[:2])).all(axis=1)
        place = np.clip(place, 0, self._counts[:2] - 1)
        nodes = np.ravel_multi_index((place[:, 0], place[:, 1], turn), tuple(self._counts))
        return np.where(inside, self._cost[nodes], np.inf)

    def find_subgoals(self, pose: Array) -> list[Array]:
        """Finds poses (3,) to aim for from a pose (3,).

        They are the goal alone where nothing is in between, else a few places along the path, and
        none where no path leads to the goal.
        """
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
        # The farthest place on the path that can be reached straight, one halfway there, and one a
        # little beyond it, which a push may still come near to.
        seen = [i for i, at in enumerate(path) if self.is_clear(pose, at)]
        farthest = seen[-1] if seen else 0
        chosen = {farthest, (farthest + 1) // 2, min(farthest + 2, len(path) - 1)}
        return [path[i] for i in sorted(chosen, reverse=True)]

    def is_clear(self, a: Array, b: Array) -> bool:
        """Whether the object can be moved and turned straight from pose a (3,) to pose b (3,)."""
        turn = float(wrap_angle(b[2] - a[2]))
        radius = float(np.linalg.norm(self.obj.p_BC - self._centroid, axis=1).max())
        way = float(np.abs(self.obj.cells_at(a) - self.obj.cells_at(b)).max())
        length = way + abs(turn) * radius
        fraction = np.linspace(0.0, 1.0, 2 + int(length / LINE_STEP))[:, None]
        center = (1 - fraction) * self._center(a) + fraction * self._center(b)
        poses = self._from_center(center, a[2] + fraction[:, 0] * turn)
        return bool(self.checker.allows_geometry(poses).all())

    def _center(self, pose: Array) -> Array:
        """The cells' centroid (2,) in W at a pose (3,), m."""
        return transform(pose, self._centroid[None])[0]

    def _from_center(self, center: Array, theta: Array) -> Array:
        """Poses (k, 3) with the cells' centroid at (k, 2), m, and angles (k,), rad."""
        return np.column_stack([center - rotate(theta, self._centroid), theta])

    def _make_lattice(self, start: Array) -> None:
        """Makes the lattice's poses, and finds out which of them the rules allow."""
        ends = np.array([self._center(start), self._center(self.goal)])
        low, high = self.checker.bounds(ends, SEARCH_MARGIN)
        step = max(LATTICE_STEP, float(np.sqrt(np.prod(high - low) / MAX_POSITIONS)))
        counts = np.append(np.ceil((high - low) / step).astype(int) + 1, TURN_COUNT)
        axes = [np.arange(count) for count in counts]
        self._index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self._low = low
        self._step = step
        self._counts = counts
        self._poses = self._from_center(
            low + step * self._index[:, :2], 2 * np.pi / TURN_COUNT * self._index[:, 2]
        )
        self._free = self.checker.allows_geometry(self._poses)

    def _find_paths(self) -> None:
        """Finds the cost of every lattice pose, and the next one on the way to the goal."""
        counts = self._counts
        index = self._index
        nodes = np.arange(len(index)).reshape(counts)
        rho = self.obj.radius_of_gyration
        rows = []
        columns = []
        weights = []
        # Edges between neighbors that are both allowed.
        for hop in NEIGHBOR_STEPS:
            other = index + hop
            inside = ((other[:, :2] >= 0) & (other[:, :2] < counts[:2])).all(axis=1)
            a = np.flatnonzero(inside)
            b = nodes[other[a, 0], other[a, 1], other[a, 2] % TURN_COUNT]
            free = self._free[a] & self._free[b]
            shift = self._step * np.hypot(hop[0], hop[1])
            turn = rho * 2 * np.pi / TURN_COUNT * hop[2]
            rows.append(a[free])
            columns.append(b[free])
            weights.append(np.full(int(free.sum()), float(np.hypot(shift, turn))))
        # The goal is one more node, beside the lattice poses that see it.
        last = len(index)
        near = [
            node for node in self._near(self.goal) if self.is_clear(self.goal, self._poses[node])
        ]
        errors = [calc_goal_error(self.obj, self._poses[node], self.goal) for node in near]
        rows.append(np.full(len(near), last))
        columns.append(np.array(near, dtype=np.int64))
        weights.append(np.array(errors))
        # All shortest paths from the goal, by Dijkstra's algorithm. On the path to a node, the
        # node before it is where to go next from there.
        data = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
        graph = coo_array(data, shape=(last + 1, last + 1)).tocsr()
        cost, before = dijkstra(graph, directed=False, indices=last, return_predecessors=True)
        self._cost = cost[:last]
        self._next = np.where(before[:last] == last, -1, before[:last])

    def _near(self, pose: Array) -> list[int]:
        """Finds the allowed lattice poses about a pose (3,): two on either side in x, y, angle."""
        at = np.append(
            (self._center(pose) - self._low) / self._step, pose[2] * TURN_COUNT / (2 * np.pi)
        )
        nodes = []
        for offset in np.ndindex(4, 4, 4):
            i, j, k = np.floor(at).astype(int) + np.array(offset) - 1
            if 0 <= i < self._counts[0] and 0 <= j < self._counts[1]:
                node = int(np.ravel_multi_index((i, j, k % TURN_COUNT), tuple(self._counts)))
                if self._free[node]:
                    nodes.append(node)
        return nodes

    def _enter(self, pose: Array) -> tuple[int, float]:
        """Finds the lattice pose by which the path leads from a pose (3,).

        Returns:
            Its index, and the cost of the whole path, m; -1 and inf where there is no path.
        """
        nodes = [node for node in self._near(pose) if np.isfinite(self._cost[node])]
        if not nodes:
            return -1, np.inf
        first_steps = [calc_goal_error(self.obj, pose, self._poses[node]) for node in nodes]
        costs = self._cost[nodes] + np.array(first_steps)
        for i in np.argsort(costs):
            if self.is_clear(pose, self._poses[nodes[i]]):
                return nodes[i], float(costs[i])
        return -1, np.inf
