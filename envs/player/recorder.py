"""Recording of episodes for the player."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import NO_POINTS, Candidates, FrontierNavigator, Markers
from lidarnaut.envs.navigation.policy import Policy, wrap
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.simulation.crowd.person_row import KIND

from .recording import BODY_KINDS, CANDIDATE_COLUMNS, FREE, NO_RETURN, OCCUPIED, RANGE_STEPS, Recording, ends_of

PERIOD = 0.5
"""Time between recorded samples of an episode [s]."""
MAX_BEAMS = 90
PLAN_TOLERANCE = 0.03
"""Maximum deviation of a recorded path, simplified to corners, from the planned path [m]."""


class EpisodeRecorder:
    """Context manager that records one episode; for teams, of the first robot.

    Other robots are recorded as people. Recording does not affect the episode.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], explorer: Policy | None = None) -> None:
        """Prepare to record an environment, beginning with its next `reset`.

        `explorer`: policy; frontier candidates of its `navigator` and their `scores` are recorded, if any. TypeError if
        `env` is not an environment of this package.
        """
        inner = lidar_env_of(env)
        self._env, self._explorer = inner, wrap(explorer or Policy(), Policy)
        self._outer = env.unwrapped
        self._beams = np.unique(np.linspace(0, len(inner.robot_params.lidar.angles) - 1, MAX_BEAMS).astype(int))

    def __enter__(self) -> "EpisodeRecorder":
        self._before = self._env.on_period
        self._env.on_period = self._record
        return self

    def __exit__(self, *_: object) -> None:
        self._env.on_period = self._before

    def _record(self, commands: Sequence[Twist] | None) -> None:
        if self._before is not None:
            self._before(commands)
        if commands is None:
            self._begin()
        else:
            self._note_decision()
        if commands is None or self._env.time - self._samples[-1]["time"] >= PERIOD - 1e-6:
            self._sample()
        self._previous = self._env.time

    def _begin(self) -> None:
        self._samples: list[dict[str, Any]] = []
        self._plans: list[np.ndarray] = []
        self._tracks: list[np.ndarray] = []
        self._map = MapHistory(self._env.belief.grid)
        self._markers, self._shown = list[np.ndarray](), set[bytes]()
        self._decisions: list[tuple[float, int, np.ndarray]] = []
        self._candidates = self._offered()

    @property
    def _navigator(self) -> FrontierNavigator | None:
        return (self._outer if isinstance(self._outer, ExploreFrontiersEnv) else self._explorer).navigator

    def _offered(self) -> Candidates | None:
        return None if self._navigator is None else self._navigator.candidates

    def _note_decision(self) -> None:
        navigator, scores = self._navigator, self._explorer.scores
        if navigator is None or navigator.candidates is self._candidates:
            return
        candidates, target = navigator.candidates, navigator.target
        self._candidates = candidates
        rows = np.full((len(candidates), len(CANDIDATE_COLUMNS)), np.nan)
        rows[:, :5] = np.column_stack([candidates[name] for name in ("frontier", "cost", "visible", "failures")])
        if scores is not None and len(scores) <= len(rows):  # some may lack scores
            rows[: len(scores), 5] = np.where(scores > -1e5, scores, np.nan)
        gaps = np.abs(candidates["frontier"] - (target or (math.inf, math.inf))).sum(axis=1)
        chosen = int(gaps.argmin()) if len(gaps) and gaps.min() < 1e-9 else -1
        self._decisions.append((self._previous, chosen, rows))

    def _sample(self) -> None:
        env, robot = self._env, self._env.robots[0]
        truth, pose = env.truths[0], robot.belief.pose
        ranges = robot.reading.ranges[self._beams] * (RANGE_STEPS / robot.params.lidar.range_max)
        people = env.simulator.people[:, :4].ravel().tolist()
        for x, y, theta, v, _ in (np.concatenate(peer.state).tolist() for peer in env.truths[1:]):
            people += [x, y, v * math.cos(theta), v * math.sin(theta)]
        self._samples.append(
            {
                "time": env.time,
                "true_poses": truth.state.pose,
                "poses": pose,
                "goals": tuple(env.task.goal[:2]) if env.task.goal is not None else (math.nan, math.nan),
                "progress": float(env.task.metrics()[env.task.progress]),
                "path_length": truth.path_length,
                "contacts": robot.collisions,
                "scans": np.rint(np.nan_to_num(ranges, nan=0.0, posinf=NO_RETURN).clip(0, NO_RETURN)),
                "people": people,
            }
        )
        self._plans.append(np.empty((0, 2)) if env.overlay.plan is None else corners(env.overlay.plan, PLAN_TOLERANCE))
        self._tracks.append(env.overlay.tracks)
        # Decisions contain the frontiers of a navigator.
        markers = env.overlay.markers() if env.overlay.markers else None
        if markers is not None and self._offered() is not None:
            markers = markers._replace(clusters=NO_POINTS, chosen=NO_POINTS)
        before, self._shown = self._shown, {row.tobytes() for row in marker_rows(markers or Markers())}
        changes = np.frombuffer(b"".join(sorted(before ^ self._shown)), dtype=np.float32).reshape(-1, 5)
        self._markers.append(np.insert(changes, 0, len(self._markers), axis=1))
        self._map.append(robot.belief.grid)

    def recording(self, about: Mapping[str, Any] | None = None) -> Recording:
        """Return the recording since the last reset. `about`: additional metadata, such as `explorer` and `seed`."""
        env = self._env
        if env.time > self._samples[-1]["time"]:
            self._sample()
        lidar, area = env.robot_params.lidar, getattr(env.task, "area", None)
        floor = np.zeros((1, 1)) if area is None else area.explorable
        frame = (1.0, (0.0, 0.0)) if area is None else (area.walls.resolution, tuple(map(float, area.walls.origin)))
        kinds = [BODY_KINDS[int(kind)] for kind in env.simulator.crowd.rows[:, KIND]]
        radii = env.simulator.people[:, 4].tolist() + [env.robot_params.radius] * (len(env.robots) - 1)
        map_shape, map_origin, cells, changes, map_ends = self._map.arrays()
        facts = {
            "explorer": "" if type(self._explorer) is Policy else type(self._explorer).__name__,
            "world": env.world.name,
            "robot": env.robot_params.name,
            "radius": env.robot_params.radius,
            "lidar": {
                "range_max": lidar.range_max,
                "mount": [lidar.mount.x, lidar.mount.y, lidar.mount.yaw],
                "angles": np.round(lidar.angles[self._beams], 6).tolist(),
                "is_full_turn": lidar.fov > 2 * math.pi - 1e-6,
            },
            "progress": env.task.progress.replace("_", " "),
            "start": list(env.map_pose),
            "map": {"shape": map_shape, "resolution": env.belief.grid.resolution, "origin": map_origin},
            "floor": {"resolution": frame[0], "origin": list(frame[1])},
            "bodies": kinds + ["robot"] * (len(env.robots) - 1),
            "figures": {},
        }
        times, chosen, rows = zip(*self._decisions) if self._decisions else ((), (), ())
        return Recording.of(
            facts | dict(about or {}),
            **{name: [sample[name] for sample in self._samples] for name in self._samples[0]},
            map_cells=cells,
            map_changes=changes,
            map_ends=map_ends,
            plans=np.concatenate(self._plans),
            plan_ends=ends_of(self._plans),
            tracks=np.concatenate(self._tracks),
            track_ends=ends_of(self._tracks),
            decision_times=times,
            decision_chosen=chosen,
            candidates=np.concatenate([np.empty((0, len(CANDIDATE_COLUMNS))), *rows]),
            candidate_ends=ends_of(rows),
            markers=np.concatenate(self._markers),
            segments=env.world.segments,
            circles=env.world.circles,
            route=NO_POINTS if env.task.route is None else env.task.route.points,
            people_radii=radii,
            floor=floor,
        )


def marker_rows(markers: Markers) -> np.ndarray:
    """Return markers as rows of `Recording.markers` without sample, shape (n, 5), float32, rounded to millimetres."""
    parts = [np.column_stack([points, points]) for points in markers[:3]]
    parts += [edges.reshape(-1, 4) for edges in markers.trees]
    cells = np.column_stack([markers.predicted[:, :2], markers.predicted[:, 2].round(1)])
    last = [np.insert(cells, 3, markers.side, axis=1), np.column_stack([markers.tour[:-1], markers.tour[1:]])]
    kinds = [min(kind, 4) for kind in range(len(parts))] + [5, 6]
    rows = np.concatenate([np.insert(part, 0, kind, axis=1) for kind, part in zip(kinds, parts + last, strict=True)])
    # Positions in a growing map differ by rounding errors, and zeros by their signs.
    return (rows.round(3) + 0.0).astype(np.float32)


class MapHistory:
    """History of a map: the cells that changed between successive samples."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._resolution, self._first = grid.resolution, grid.origin
        # Cell kinds over the union of all maps, and its corner relative to the first map's.
        self._kinds = np.zeros((0, 0), dtype=np.uint8)
        self._corner = np.zeros(2, dtype=np.int64)
        self._cells: list[np.ndarray] = []
        self._changes: list[np.ndarray] = []

    def append(self, grid: OccupancyGrid) -> None:
        corner = np.rint(np.subtract(grid.origin, self._first)[::-1] / self._resolution).astype(np.int64)
        if not self._kinds.size:
            self._corner = corner
        before = np.maximum(self._corner - corner, 0)
        after = np.maximum(corner + grid.data.shape - self._corner - self._kinds.shape, 0)
        self._kinds, self._corner = np.pad(self._kinds, list(zip(before, after))), self._corner - before
        now = np.zeros_like(self._kinds)
        (top, left), (height, width) = corner - self._corner, grid.data.shape
        kinds = np.where(grid.occupied, np.uint8(OCCUPIED), np.uint8(FREE))
        now[top : top + height, left : left + width] = np.where(grid.data >= 0, kinds, 0)
        changes = self._kinds ^ now
        cells = np.argwhere(changes)
        self._cells.append(cells + self._corner)
        self._changes.append(changes[tuple(cells.T)])
        self._kinds = now

    def arrays(self) -> tuple[list[int], list[float], np.ndarray, np.ndarray, np.ndarray]:
        cells = np.concatenate(self._cells)
        low, high = (cells.min(axis=0), cells.max(axis=0) + 1) if len(cells) else (np.zeros(2, int), np.ones(2, int))
        rows, columns = (high - low).tolist()
        flat = (cells - low) @ (columns, 1)
        origin = (np.array(self._first) + low[::-1] * self._resolution).tolist()
        return [rows, columns], origin, flat, np.concatenate(self._changes), ends_of(self._cells)


def corners(path: np.ndarray, tolerance: float) -> np.ndarray:
    """Simplify a polyline, shape (n, 2), to corners within `tolerance`, shape (m, 2) (Douglas and Peucker, 1973)."""
    if len(path) < 3:
        return np.array(path, dtype=np.float64).reshape(-1, 2)
    keep = {0, len(path) - 1}
    pending = [(0, len(path) - 1)]
    while pending:
        first, last = pending.pop()
        (x, y), points = path[last] - path[first], path[first + 1 : last] - path[first]
        length = math.hypot(x, y)
        away = np.abs(points @ (-y, x)) / length if length > 0.0 else np.hypot(*points.T)
        if len(away) and away.max() > tolerance:
            middle = first + 1 + int(away.argmax())
            keep.add(middle)
            pending += [(first, middle), (middle, last)]
    return np.array(path[sorted(keep)], dtype=np.float64)
