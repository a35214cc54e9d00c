"""Steps of many sub-environments in one call of a Numba function."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numba import njit
from numba.typed import List

from lidarnaut.envs.estimation.dead_reckoning import DeadReckoning
from lidarnaut.envs.overrides import overridden
from lidarnaut.envs.robot import SCAN
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.simulation.rows import BLOCK
from lidarnaut.envs.task import total
from lidarnaut.envs.transition import pose_errors, record_positions, step_rows

from .memory import SCALARS, Arrays, Records

OWN_INFO = {"time", "rewards", "pose_error", "path_length", "collisions"}
"""Keys of `info` that are common to all tasks."""
MOST_POSITIONS = 256
"""Maximum number of positions buffered per robot before they are appended to recorded paths."""


@njit(cache=True)
def repeat(item, count):
    """Return a Numba list that contains `item` `count` times."""
    items = List()
    for _ in range(count):
        items.append(item)
    return items


@njit(cache=True)
def put(items, i, item):
    """Set element `i` of a Numba list. Cached by Numba, unlike list methods."""
    items[i] = item


class Batch:
    """Sub-environments that are stepped together by Numba functions."""

    def __init__(self, envs: Sequence[Any], arrays: Arrays) -> None:
        self._envs, self._arrays = envs, arrays
        env = envs[0]
        self.robots = [robot for each in envs for robot in each.robots]
        rows = [each.rows for each in envs]
        self.numbers, self.ranges, self._draws = (
            np.concatenate([getattr(each, name) for each in rows]) for name in ("numbers", "ranges", "draws")
        )
        self.memory = {name: np.concatenate([each.memory[name] for each in rows]) for name in rows[0].memory}
        self.active = np.ones(len(self.robots), dtype=np.bool_)
        """Mask of robots whose sub-environments take part in the current step, shape (n,), bool."""
        self._is_new = np.ones(len(self.robots), dtype=np.bool_)
        self._has_scanned = np.zeros(len(envs), dtype=np.bool_)
        self._is_behind, self._rests = np.zeros(len(envs), dtype=np.bool_), np.zeros(len(envs), dtype=np.bool_)
        self._time_limits = np.zeros(len(envs))
        self._part_writes_rows = {
            name: _has_own(part, "write_rows", "write", of="lidarnaut.") for name, part in env.parts.items()
        }
        self._are_alike = np.zeros((len(envs), 3), dtype=np.bool_)
        """Whether the rewards have the weights of the first sub-environment, the task has `update_rows`, and the
        estimators are dead reckoning without a map. A batch has these properties if all sub-environments do."""
        self._positions = np.empty((len(self.robots), MOST_POSITIONS, 4))
        self._counts = np.zeros((len(self.robots), 2), dtype=np.int64)  # of buffered estimated and true positions
        self._names: Iterable[str] = ()  # names of reward quantities
        self._levels: dict[float, Any] = {}
        self.surroundings: Any = None
        """Numba list of the wall segments, circular obstacles, magnets and people of each sub-environment."""

    def bind(self, indices: Sequence[int]) -> None:
        """Connect sub-environments to the shared arrays after a reset: robot states, worlds, task data, time limits."""
        envs, num_robots = self._envs, self._num_robots
        if self.surroundings is None:
            self.surroundings = repeat(_surroundings(envs[0]), len(envs))
            self.task_arrays = [repeat(each, len(envs)) for each in envs[0].task.arrays]
        for i in indices:
            env, robots = envs[i], slice(i * num_robots, (i + 1) * num_robots)
            memory = {name: kept[robots] for name, kept in self.memory.items()}
            env.rows.share(self.numbers[robots], self.ranges[robots], self._draws[robots], memory)
            put(self.surroundings, i, _surroundings(env))
            for arrays, array in zip(self.task_arrays, env.task.arrays, strict=True):
                put(arrays, i, array)
            self._is_new[robots] = True
            self._counts[robots] = 0
            rewards, weights = env.task.rewards, envs[0].task.rewards.weights
            is_unobserved = not env.sensors and env.on_period is None
            self._are_alike[i] = (
                not (rewards.reads_shared or overridden(rewards)) and rewards.weights == weights,
                is_unobserved and _has_own(env.task, "update_rows", "update", "quantities", "metrics", "end_reason"),
                all(type(robot.estimator) is DeadReckoning for robot in env.robots) and env.priors[0].map is None,
            )
            self._time_limits[i] = env.time_limit
            follows = all(robot.estimator.follows_odometry and robot.tracker is None for robot in env.robots)
            self._rests[i] = follows and is_unobserved and (env.task.rests_between_scans or self._are_alike[i, 1])
        self._has_columns, self._updates_rows, self._has_no_maps = np.all(self._are_alike, axis=0).tolist()

    @property
    def _num_robots(self) -> int:
        return len(self._envs[0].robots)

    def step(self, active: np.ndarray, is_last: np.ndarray, records: Records) -> np.ndarray:
        """Step the active sub-environments by one control period, and return a mask of ended episodes.

        `is_last`: mask of sub-environments to truncate. Masks have shape (num_envs,), bool. Rewards and `info` of ended
        episodes are left to the caller.
        """
        self.active[:] = np.repeat(active, self._num_robots)
        self._drive(active)
        if self._has_no_maps and record_positions(self.numbers, self.active, self._positions, self._counts):
            self._extend_trails(range(len(active)))
        flags = self.numbers[:, at.FLAGS].reshape(len(active), -1)
        self._has_scanned = (flags % 2.0 == SCAN).any(axis=1)
        is_over = active & (is_last | (self._times >= self._time_limits - 1e-6))
        columns: Any = None
        if self._updates_rows:
            *columns, has_ended = self._envs[0].task.update_rows(self)
            is_over |= active & has_ended
        busy = active & (~self._rests | self._has_scanned | self._is_new[:: self._num_robots] | is_over)
        idle = active & ~busy
        has_own_parts = not all(self._part_writes_rows.values())
        for i in np.flatnonzero(idle if has_own_parts else idle & flags.any(axis=1)).tolist():
            self._envs[i].locate()
        chosen = np.flatnonzero(busy).tolist()
        self._finish(chosen)
        self._is_behind = (self._is_behind | idle) & ~busy
        self._observe(np.flatnonzero(active).tolist())
        if not self._updates_rows:
            for i in chosen:
                is_over[i] |= self._envs[i].task.end_reason is not None
        going = active & ~is_over
        if going.any():
            chosen = np.flatnonzero(busy & going).tolist()
            self._judge(going, chosen, columns, records)
            if not self._updates_rows:
                self._note_metrics(chosen, records)
        return is_over

    def catch_up(self) -> None:
        """Update the Python objects of sub-environments after steps that changed only the state arrays."""
        self._finish(np.flatnonzero(self._is_behind).tolist())
        self._is_behind[:] = False

    def _finish(self, indices: Sequence[int]) -> None:
        if self._has_no_maps:
            self._extend_trails(indices)
        for env in (self._envs[i] for i in indices):
            if self._updates_rows:
                env.locate()
                env.quantities = env.task.quantities()
            else:
                env.finish()

    def _extend_trails(self, indices: Iterable[int]) -> None:
        for i in indices:
            env, first = self._envs[i], i * self._num_robots
            for k, (robot, truth) in enumerate(zip(env.robots, env.truths, strict=True), first):
                robot.trail.extend(self._positions[k, : self._counts[k, 0], :2])
                truth.trail.extend(self._positions[k, : self._counts[k, 1], 2:])
                self._counts[k] = 0

    def _drive(self, active: np.ndarray) -> None:
        numbers, envs = self.numbers, self._envs
        limits = envs[0].robot.max_v, envs[0].robot.max_w
        numbers[:, at.ACTION_V : at.ACTION_W + 1] = np.clip(self._arrays.actions, -1.0, 1.0).reshape(-1, 2)
        numbers[:, at.COMMAND_V : at.COMMAND_W + 1] = numbers[:, at.ACTION_V : at.ACTION_W + 1] * limits
        if (monitor := envs[0].collision_monitor) is not None:
            monitor.slow_down(numbers[:, at.COMMAND_V : at.COMMAND_W + 1], self.ranges, self.active)
        for i in np.flatnonzero(active & (numbers[:: self._num_robots, at.DRAW] == BLOCK - 1)).tolist():
            envs[i].rows.draw_ahead(envs[i].simulator.rngs)
        step_rows(numbers, self._draws, self.ranges, active, self._num_robots, self.surroundings)

    @property
    def _times(self) -> np.ndarray:
        return self.numbers[:: self._num_robots, at.TIME]

    def _observe(self, indices: Sequence[int]) -> None:
        for name, part in self._envs[0].parts.items():
            out = self._arrays.observations[name]
            if self._part_writes_rows[name]:
                part.write_rows(self, out.reshape(len(self.robots), *out.shape[1 + self._envs[0].task.is_team :]))
            else:
                for i in indices:
                    self._envs[i].write_part(name, out[i])
        self._is_new[:] = False

    def levels(self, resolution: float) -> tuple[Any, np.ndarray, np.ndarray, float]:
        """Return the maps of all robots, reduced to cells of about `resolution` [m], for cropping map images.

        Returns:
            Bit-packed maps (Numba list); map heights and widths [cells], shape (n, 2), int64; map origins (x, y), shape
            (n, 2), float64 [m]; cell size [m].
        """
        side = 0.0
        if resolution not in self._levels:
            pyramids = [robot.pyramid.level(resolution) for robot in self.robots]
            side = pyramids[0].block * self.robots[0].belief.grid.resolution
            count = len(pyramids)
            known: list[Any] = [None] * count
            words = repeat(pyramids[0].words, count)
            self._levels[resolution] = words, np.zeros((count, 2), np.int64), np.zeros((count, 2)), side, known
            self._is_new[:] = True
        words, sizes, origins, side, known = self._levels[resolution]
        for k in np.flatnonzero(self._is_new | np.repeat(self._has_scanned, self._num_robots)).tolist():
            robot = self.robots[k]
            level = robot.pyramid.level(resolution)
            if level.words is not known[k]:
                known[k] = level.words
                put(words, k, level.words)
                sizes[k], origins[k] = (level.height, level.width), robot.belief.grid.origin
        return words, sizes, origins, side

    def _judge(self, going: np.ndarray, chosen: list[int], columns: Any, records: Records) -> None:
        tasks, numbers, where = [env.task for env in self._envs], self.numbers, slice(None) if going.all() else going
        rows = {} if columns else {i: self._envs[i].quantities for i in chosen}
        self._names = next(iter(rows.values()), self._names)
        quantities, metrics = columns or (self._at_rest(), {})
        weights = tasks[0].rewards.weights if self._has_columns else ()
        if weights and {type(row[name]) for row in rows.values() for name in weights} <= {float, np.float64}:
            for name in weights if rows else ():
                quantities[name][chosen] = [row[name] for row in rows.values()]
            terms = tasks[0].rewards.terms(quantities)
            self._arrays.rewards[where] = total(terms)[where]
            for name, term in terms.items():
                records.rows["rewards"][name][where] = term[where]
        else:
            for i in np.flatnonzero(going).tolist():
                row = rows.get(i) or {name: float(column[i]) for name, column in quantities.items()}
                terms = self._envs[i].reward_terms(row)
                self._arrays.rewards[i] = tasks[i].rewards.checked_total(terms)
                records.note(i, {"rewards": terms}, ("rewards",))
        info_columns = {"time": self._times, "path_length": numbers[:, at.PATH_LENGTH]} | metrics
        info_columns |= {"pose_error": pose_errors(numbers), "collisions": numbers[:, at.COLLISIONS]}
        for name, column in info_columns.items():
            records.rows[name][where] = column.reshape(len(going), *records.rows.dtype[name].shape)[where]

    def _at_rest(self) -> dict[str, np.ndarray]:
        touching = (self.numbers[:, at.TOUCHED] > 0.0).reshape(len(self._envs), -1).sum(axis=1)
        period = self._envs[0].control_period
        passed = {"time": np.full(len(touching), period), "collision": period * touching}
        return {name: passed.get(name, np.zeros(len(touching))) for name in self._names}

    def _note_metrics(self, chosen: list[int], records: Records) -> None:
        rows = [self._envs[i].task.metrics() for i in chosen]
        own_info = OWN_INFO | ({"randomized"} if hasattr(self._envs[0], "randomized") else set())
        for name in dict.fromkeys(itertools.chain(records.kinds, *rows)) if rows else ():
            if name in own_info:
                continue
            values, kind = [row.get(name) for row in rows], records.kinds.get(name)
            if kind in (SCALARS[float], SCALARS[bool]) and {SCALARS.get(one) for one in {*map(type, values)}} == {kind}:
                records.rows[name][chosen] = values
            else:
                for i, row in zip(chosen, rows, strict=True):
                    records.note(i, row, (name,))


def _surroundings(env: Any) -> tuple[Any, ...]:
    world = env.world
    return *(np.array(rows) for rows in (world.segments, world.circles, world.magnets)), env.simulator.crowd.arrays


def _has_own(thing: Any, by_rows: str, *one_by_one: str, of: str = "") -> bool:
    names = {by_rows, *one_by_one}
    kind = next((kind for kind in type(thing).__mro__ if names & vars(kind).keys()), object)
    return by_rows in vars(kind) and kind.__module__.startswith(of)
