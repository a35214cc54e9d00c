"""A shard whose robots are stepped by one kernel call: kinematic physics and a SLAM that matches key scans.

The kernel calls the functions that `KinematicSimulator` and the motion sources call, for one sub-environment after the
other, and tells which of them have more to do: a key scan to process, a position to remember. Their own objects do
that. So everything stays equal to the last bit, which a test holds. Python alone would take as long again as the
kernels: the objects of many environments do not fit the caches.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from gymnasium.vector import AutoresetMode

from envs.fused import FusedRobots, is_fusible
from envs.fused.kernels import KEY_SCAN, REMEMBER, REMEMBER_TRUE, Shapes, step_rows
from envs.geometry import Pose2D
from envs.observations import MapCrop, Motion, Scan
from envs.observations.scan import TIME_RANGE
from envs.simulation.sensors import TOUCHED
from envs.simulation.state import THETA

from .crops import crop_levels, scale_scans
from .memory import Memory
from .shard import Extras, Shard


def is_shard_fusible(env: Any) -> bool:
    """Tell whether `FusedShard` can step a sub-environment: nothing in it is the user's own."""
    return is_fusible(env) and all(type(part) in (Scan, Motion, MapCrop) for part in env.parts.values())


class FusedShard(Shard):
    """A `Shard` of fusible sub-environments; see the module."""

    def __init__(self, envs: list[Any], *arguments: Any) -> None:
        """Take the sub-environments, all of them fusible and alike; the other arguments are those of `Shard`."""
        super().__init__(envs, *arguments)
        env = envs[0]
        self._robots = robots = FusedRobots(envs)
        self._robot_rows, self._setup, self._actions = robots.rows, robots.setup, robots.actions
        self._step_counts = robots.steps

        def zeros(*shape: int, dtype: Any = np.float64) -> np.ndarray:
            return np.zeros((len(envs), *shape), dtype)

        self._resolution = env.robots[0].belief.grid.resolution
        self._limits = np.array([env.robot.max_v, env.robot.max_w])
        self._time_limits, self._origins = zeros(), zeros(2)
        self._fractions, self._areas, self._gained = zeros(), zeros(), zeros()
        self._crops = {name: part for name, part in env.parts.items() if isinstance(part, MapCrop)}
        self._sizes = {name: zeros(2, dtype=np.int64) for name in self._crops}
        self._shapes: Shapes
        self._data: list[Any] = [None] * len(envs)
        self._levels: dict[str, Any] = {}

    def reset(self, seeds: Any, mask: Any, options: Any) -> tuple[np.ndarray, Extras]:
        """Start episodes; see `Shard`."""
        result = super().reset(seeds, mask, options)
        self._load_all()
        return result

    def call(self, name: str, args: Any, kwargs: Any) -> list[Any]:
        """Call a method of every sub-environment, or return an attribute that is none."""
        return self._through_objects(super().call, name, args, kwargs)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of every sub-environment."""
        self._through_objects(super().set_attr, name, values)

    def _through_objects(self, work: Callable[..., Any], *args: Any) -> Any:
        """Call a function that reads and changes the sub-environments' objects, and return its result."""
        if self._records is None:
            return work(*args)
        for i in range(len(self.envs)):
            self._robots.sync(i)
        try:
            return work(*args)
        finally:  # it may have changed some before it failed
            self._load_all()

    def step(self) -> tuple[np.ndarray, Extras]:
        """Step every sub-environment with its row of the actions; see `Shard`."""
        rows, arrays, extras = self._robot_rows, self._arrays, Extras()
        ended = np.array(self._has_ended)
        rows.active[:] = ~ended
        self._actions[:] = np.clip(arrays.actions, -1.0, 1.0)
        np.multiply(self._actions, self._limits, out=rows.commands[:, 0])
        self._step_counts += rows.active
        self._draw()
        step_rows(rows, self._shapes, self._setup)
        self._gained[:] = 0.0
        for i in np.flatnonzero(rows.flags).tolist():
            self._finish(i, int(rows.flags[i]))
        self._observe()
        self._judge(extras)
        for i in np.flatnonzero(ended).tolist():
            info = self._reset(i, None, None)
            arrays.rewards[i], arrays.terminated[i], arrays.truncated[i] = 0.0, False, False
            self._note(i, info, extras)
            self._load(i)
        assert self._records is not None
        return self._records, extras

    def _draw(self) -> None:
        """Draw the noise of active robots, and move what moves in their worlds."""
        rows = self._robot_rows
        for i in np.flatnonzero(rows.active).tolist():
            env = self.envs[i]
            env.simulator.sensors.draw(env.simulator.rngs)
            if env.world.movers:
                time = int(self._step_counts[i]) * self._setup.period
                self._shapes.before[i] = self._shapes.after[i]
                self._shapes.after[i] = env.simulator.circles = env.world.circles_at(time)

    def _finish(self, i: int, flags: int) -> None:
        """Do for a robot what the kernel left."""
        rows, env = self._robot_rows, self.envs[i]
        robot, truth = env.robots[0], env.truths[0]
        if flags & KEY_SCAN:
            update, ranges = self._robots.process_key_scan(i), rows.ranges[i, 0]
            true_pose = Pose2D(*rows.states[i, 0, : THETA + 1].tolist())
            coverage = env.task.coverage
            self._gained[i] = coverage.update(update, self._resolution, ranges, true_pose)
            self._fractions[i], self._areas[i] = coverage.explored_fraction, coverage.explored_area
            if update.redrawn or robot.belief.grid.data is not self._data[i]:
                self._load_map(i)
            for part in self._crops.values():  # `_observe` reads the words of the levels
                robot.pyramid.level(part.resolution)
        if flags & REMEMBER:
            x, y, theta = rows.pose[i].tolist()
            robot.trail.append(Pose2D(x, y, theta))
            robot.pyramid.mark(x, y)
            rows.trail[i] = x, y
        if flags & REMEMBER_TRUE:
            x, y, theta = rows.states[i, 0, : THETA + 1].tolist()
            truth.trail.append(Pose2D(x, y, theta))
            rows.true_trail[i] = x, y

    def _observe(self) -> None:
        """Write the observations of active robots."""
        rows, out, active = self._robot_rows, self._arrays.observations, self._robot_rows.active
        for name, part in self.envs[0].parts.items():
            if isinstance(part, Scan):
                scale_scans(rows.ranges, self.envs[0].robot.lidar.range_max, active, out[name])
            elif isinstance(part, Motion):
                motion = np.empty((len(active), 6))
                motion[:, :2] = np.clip(rows.twist / self._limits, -1.0, 1.0)
                motion[:, 2:4] = self._actions
                motion[:, 4] = rows.others[:, 0, TOUCHED] > 0.0
                motion[:, 5] = np.minimum(self._times / TIME_RANGE, 1.0)
                out[name][active] = motion[active]
            else:
                level = self.envs[0].robots[0].pyramid.level(part.resolution)
                side = level.block * self._resolution
                crop_levels(
                    self._levels[name],
                    self._sizes[name],
                    rows.pose,
                    self._origins,
                    side,
                    part.resolution,
                    active,
                    out[name],
                )

    def _judge(self, extras: Extras) -> None:
        """Write rewards, ends and records of active robots, and start the next episodes where that is due at once."""
        rows, arrays, records = self._robot_rows, self._arrays, self._records
        assert records is not None
        active, env, period = rows.active, self.envs[0], self._setup.period
        touching, times = rows.others[:, 0, TOUCHED] > 0.0, self._times
        covered = self._fractions >= env.task.target_coverage
        terminated = active & covered
        late = (times >= self._time_limits - 1e-6) | (self._step_counts == self._max_steps)
        truncated = active & late & ~terminated
        quantities: dict[str, Any] = {
            "explored": self._gained,
            "time": period,
            "collision": period * touching,
            "completed": covered.astype(np.float64),
        }
        rewards = env.task.weights.terms(quantities)
        total = np.asarray(sum(rewards.values()))
        arrays.rewards[active], arrays.terminated[:], arrays.truncated[:] = total[active], terminated, truncated
        columns = {
            "explored_fraction": self._fractions,
            "explored_area": self._areas,
            "is_success": covered,
            "time": times,
            "pose_error": rows.error,
            "path_length": rows.path_length,
            "collisions": rows.collisions,
        }
        for name, column in columns.items():
            records[name][active] = column[active]
        for name, term in rewards.items():
            records["rewards"][name][active] = np.broadcast_to(term, active.shape)[active]
        for i in np.flatnonzero(terminated | truncated).tolist():
            self._end(i, "covered" if terminated[i] else "time_limit", extras)

    def _end(self, i: int, reason: str, extras: Extras) -> None:
        """Complete the info of an episode that has ended."""
        assert self._records is not None
        self._robots.sync(i)
        env, names = self.envs[i], self._records.dtype["rewards"].names or ()
        info = env.info({name: float(self._records["rewards"][name][i]) for name in names})
        info |= env.task.final_metrics() | {"end_reason": reason}
        self._close_episode(i, info, extras)
        if not self._has_ended[i]:
            self._load(i)

    @property
    def _times(self) -> np.ndarray:
        """Time since the resets, shape (num_envs,) [s]."""
        return self._step_counts * self._setup.period

    def _load_all(self) -> None:
        envs = self.envs
        circles = [np.array(env.simulator.circles) for env in envs]
        self._shapes = Shapes(
            numba.typed.List([np.array(env.world.segments) for env in envs]),
            numba.typed.List(circles),
            numba.typed.List(circles),
        )
        for name, part in self._crops.items():
            levels = [env.robots[0].pyramid.level(part.resolution).words for env in envs]
            self._levels[name] = numba.typed.List(levels)
        for i in range(len(envs)):
            self._load(i)

    def _load(self, i: int) -> None:
        """Take the numbers of a sub-environment from its objects."""
        env = self.envs[i]
        self._robots.load(i)
        self._time_limits[i] = env.time_limit
        shapes = self._shapes
        shapes.segments[i] = np.array(env.world.segments)
        shapes.before[i] = shapes.after[i] = np.array(env.simulator.circles)
        self._load_map(i)

    def _load_map(self, i: int) -> None:
        """Take map, crops and coverage of a sub-environment from its objects."""
        env = self.envs[i]
        robot, coverage = env.robots[0], env.task.coverage
        grid = robot.belief.grid
        self._origins[i], self._data[i] = grid.origin, grid.data
        self._fractions[i], self._areas[i] = coverage.explored_fraction, coverage.explored_area
        for name, part in self._crops.items():
            level = robot.pyramid.level(part.resolution)
            self._levels[name][i] = level.words
            self._sizes[name][i] = level.height, level.width


def make_shard(
    make_env: Callable[[], Any],
    memory: Memory,
    first: int,
    last: int,
    autoreset_mode: AutoresetMode,
    max_episode_steps: int | None,
) -> Shard:
    """Make a shard of sub-environments: fused where nothing in them forbids it.

    Args:
        make_env: makes a sub-environment.
        memory: of all sub-environments' arrays.
        first: row of the shard's first sub-environment.
        last: row after that of its last one.
        autoreset_mode: when a sub-environment whose episode has ended starts the next one.
        max_episode_steps: truncates episodes after so many steps.
    """
    envs = [make_env() for _ in range(last - first)]
    kind: type[Shard] = FusedShard if all(map(is_shard_fusible, envs)) else Shard
    return kind(envs, memory.arrays().rows(first, last), autoreset_mode, max_episode_steps)
