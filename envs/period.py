"""The control period: from commands to rewards and ends, for one environment or many.

Single environments, vector environments, frontier environments, and the driver of a real robot run these stages. They
differ in the mover of the robots (`envs.simulation.mover`). The stages:

1. `command`: store the commands, slowed down by the collision monitor.
2. `move`: people, robots, contacts, measurements, odometry; then statistics, predicted poses, and which scans are due.
3. `measure`: sensors of users.
4. `locate`: poses and maps, from scans that are due or from odometry.
5. `update_task`: task.
6. `record`: recorders.

`LidarEnv.outcome`, and by columns `Batch`, then compute rewards, ends and `info`.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from lidarnaut.envs.columns import SCALARS, Arrays, Records
from lidarnaut.envs.estimation import DeadReckoning
from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.observations import writes_rows
from lidarnaut.envs.overrides import overridden, shadowed
from lidarnaut.envs.robot import REMEMBER_TRUE, SCAN
from lidarnaut.envs.robot_rows import RobotRows, put, repeat
from lidarnaut.envs.sensor import measure_all
from lidarnaut.envs.simulation import KinematicSimulator, Twist
from lidarnaut.envs.simulation.records import ROW
from lidarnaut.envs.simulation.rows import BLOCK
from lidarnaut.envs.task import total
from lidarnaut.envs.transition import (
    costs,
    drive,
    pose_errors,
    record_positions,
    step_rows,
    store_actions,
    update_robots,
)

TIME_TOLERANCE = 1e-6
"""An episode ends if its time limit comes within this time [s]."""
OWN_INFO = {"time", "rewards", "pose_error", "path_length", "collisions", "cost"}
"""Keys of `info` that are common to all tasks."""
MOST_POSITIONS = 256
"""Maximum number of positions buffered per robot before they are appended to recorded paths."""


class Period:
    """Control periods of one environment."""

    def __init__(self, env: Any, monitor: CollisionMonitor | None, has_costs: bool) -> None:
        self.envs: Sequence[Any] = [env]
        self.monitor, self.has_costs = monitor, has_costs
        self.quantities: Mapping[str, Any] = {}
        """Quantities of the last control period, as rewarded."""
        self._limits = np.array([env.robot_params.max_v, env.robot_params.max_w])
        self._noted = np.empty((len(env.robots), BLOCK, 4)), np.zeros((len(env.robots), 2), dtype=np.int64)

    def begin(self) -> None:
        """Refer to the arrays of an episode, or to other arrays after `Rows.share`."""
        (env,) = self.envs
        rows = env.simulator.rows
        rows.numbers["map_pose"] = env.map_pose
        self.rows = RobotRows(env.robots, rows.numbers, rows.ranges, rows.memory, env.truths)

    @property
    def numbers(self) -> np.ndarray:
        """Records of the robots, shape (n,), dtype `ROW`."""
        return self.rows.numbers

    def run(self, commands: np.ndarray, active: Any = None) -> None:
        """Run a control period.

        `commands`: twist of each robot, shape (n, 2), float64 [m/s, rad/s]. `active`: mask of the environments to
        simulate, shape (num_envs,), bool; None for all.
        """
        self.command(commands)
        self.advance(active)

    def advance(self, active: Any = None) -> None:
        """Run the stages after `command`; a robot on the ground has driven in between."""
        self.move(active)
        for i in self.due(active):
            self.finish(i)

    def finish(self, i: int) -> None:
        """Run the stages of environment `i` that follow the motion."""
        env = self.envs[i]
        if env.sensors:
            self.measure(i)
        self.locate(i)
        self.update_task(i)
        if env.on_period is not None:
            self.record(i)

    def act(self, actions: np.ndarray) -> np.ndarray:
        """Store actions, shape (n, 2), float32: fractions of limits; return twists, shape (n, 2) [m/s, rad/s]."""
        return store_actions(self.rows.numbers, actions, self._limits)

    def follow(self, commands: np.ndarray) -> np.ndarray:
        """Store the actions of twists, shape (n, 2), float64 [m/s, rad/s], and return the twists."""
        self.numbers["action_v"], self.numbers["action_w"] = (commands / self._limits).T
        return commands

    def command(self, commands: np.ndarray) -> None:
        rows = self.rows
        rows.numbers["command"] = commands
        if self.monitor is not None:
            self.monitor.slow_down(rows.numbers["command"], rows.ranges, rows.active)

    def move(self, active: Any) -> None:
        simulator = self.envs[0].simulator
        simulator.move()
        update_robots(self.rows.numbers, simulator.crowd.rows)

    def due(self, active: Any) -> Iterable[int]:
        """Return the indices of environments whose Python objects are updated in this period."""
        return (0,)

    def measure(self, i: int) -> None:
        env = self.envs[i]
        for k, robot in enumerate(env.robots):
            robot.reading = robot.reading._replace(extra=measure_all(env.sensors, env.simulator, k))

    def locate(self, i: int) -> None:
        env = self.envs[i]
        flags = env.period.rows.numbers["pending"].tolist()
        for robot, truth, flag in zip(env.robots, env.truths, flags, strict=True):
            robot.locate(int(flag))
            if int(flag) & REMEMBER_TRUE:
                truth.remember()

    def update_task(self, i: int) -> None:
        env = self.envs[i]
        env.task.update(env.simulator, env.robots, env.control_period)
        env.period.quantities = _quantities(env)

    def record(self, i: int) -> None:
        env = self.envs[i]
        env.on_period([Twist(*twist) for twist in env.rows.numbers["command"].tolist()])

    def reward_terms(self, count: int = 1, contacts: int = 0) -> Mapping[str, float]:
        """Return the reward terms of the last `count` control periods, by name.

        Before the last period, only time and contact count. `contacts`: number of earlier periods with contact.
        """
        env, quantities, period = self.envs[0], self.quantities, self.envs[0].control_period
        if count > 1:
            time, contact = period * (count - 1), period * contacts
            earlier = {"time": quantities["time"] + time, "collision": quantities["collision"] + contact}
            quantities = {**quantities, **earlier}
        terms: Mapping[str, float] = env.reward_terms(quantities)
        return terms

    def drive(self, navigator: Any, check_from: float) -> tuple[int, int, int]:
        """Run periods of one robot that follows its navigator, in one kernel call.

        `navigator`: `Navigator`. `check_from`: first control period of the drive with a check in Python.

        Returns:
            As `drive`.
        """
        (env,) = self.envs
        simulator, robot, truth, rows, world = env.simulator, env.robots[0], env.truths[0], env.rows, env.world
        left = math.ceil(min((env.time_limit - TIME_TOLERANCE) / env.control_period, 1e12)) - rows.steps  # may be inf
        rows.draw_ahead(simulator.rngs)
        world_arrays = world.segments, world.circles, world.magnets, simulator.crowd.arrays
        arrays = rows.numbers, rows.draws, rows.ranges, world_arrays, navigator.arrays, self._noted
        result: tuple[int, int, int] = drive(*arrays, max(left, 1), min(check_from, 1 << 40))
        ((v, w),) = rows.numbers["command"].tolist()
        robot.action = v / robot.params.max_v, w / robot.params.max_w
        navigator.velocity = robot.twist
        for x, y in extend_trail(robot, truth, self._noted[0][0], self._noted[1][0]).tolist():
            robot.pyramid.mark(x, y)
        self.finish(0)
        return result


def why_not_fused(env: Any) -> str:
    """Return why one kernel call cannot step many copies of an environment; empty if it can."""
    owned = env, env.period, env.simulator, *env.robots
    used = env.task, env.task.rewards, *env.parts.values()
    for one, own in [*zip(owned, map(overridden, owned)), *zip(used, map(shadowed, used))]:
        if own:
            return f"{type(one).__name__} overrides {own[0]}"
    if env.fixed_info:
        return "fixed_info adds entries of the last step to every info"
    if env.robot_params.lidar.scan_time:
        return "scans of a lidar that spins are deskewed in Python"
    physics = type(env.simulator)
    return "" if physics is KinematicSimulator else f"{physics.__name__} steps in Python"


def _quantities(env: Any) -> dict[str, Any]:
    quantities = {"time": env.control_period, **env.task.quantities()}
    if "collision" not in quantities:
        quantities["collision"] = env.control_period * sum(robot.bumper for robot in env.robots)
    return quantities


def extend_trail(robot: Any, truth: Any, positions: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Append positions of `record_positions` to the paths of a robot; return the estimated ones, shape (n, 2)."""
    estimated, true = count.tolist()
    own = positions[:estimated, :2]
    robot.trail.extend(own)
    truth.trail.extend(positions[:true, 2:])
    count[:] = 0
    return own


def robots_info(numbers: np.ndarray, *, is_team: bool, has_costs: bool) -> dict[str, Any]:
    """Return the entries of `info` on robots that all tasks have: arrays for a team, else numbers; and their cost."""
    errors, lengths, collisions = pose_errors(numbers), numbers["path_length"], numbers["collisions"]
    cost = {"cost": float(costs(numbers, len(numbers))[0])} if has_costs else {}
    if is_team:
        return {"pose_error": errors, "path_length": lengths.copy(), "collisions": collisions.astype(np.int64)} | cost
    return {"pose_error": errors[0], "path_length": float(lengths[0]), "collisions": int(collisions[0])} | cost


class Batch(Period):
    """Control periods of many environments, whose robots are stepped together by Numba functions."""

    def __init__(self, envs: Sequence[Any], arrays: Arrays) -> None:
        super().__init__(envs[0], envs[0].period.monitor, envs[0].period.has_costs)
        self.envs, self._arrays = envs, arrays
        robots, rows = [robot for each in envs for robot in each.robots], [each.rows for each in envs]
        numbers, ranges, self._draws = (
            np.concatenate([getattr(each, name) for each in rows]) for name in ("numbers", "ranges", "draws")
        )
        memory = {name: np.concatenate([each.memory[name] for each in rows]) for name in rows[0].memory}
        self.rows = RobotRows(robots, numbers.view(ROW), ranges, memory)
        self._is_new = np.ones(len(robots), dtype=np.bool_)
        self._has_scanned, self._is_behind, self._rests = (np.zeros(len(envs), dtype=np.bool_) for _ in range(3))
        self._is_over, self._time_limits = np.zeros(len(envs), dtype=np.bool_), np.zeros(len(envs))
        self._part_writes_rows = {name: writes_rows(part) for name, part in envs[0].parts.items()}
        self._are_alike = np.zeros((len(envs), 3), dtype=np.bool_)
        """Whether the rewards have the weights of the first sub-environment, the task has `update_rows`, and the
        estimators are dead reckoning without a map. A batch has these properties if all sub-environments do."""
        counts = np.zeros((len(robots), 2), dtype=np.int64)  # of buffered estimated and true positions
        self._noted = np.empty((len(robots), MOST_POSITIONS, 4)), counts
        self._names: Iterable[str] = ()  # names of reward quantities
        self.updates_rows = False

    @property
    def _num_robots(self) -> int:
        return len(self.envs[0].robots)

    @property
    def _times(self) -> np.ndarray:
        return self.numbers["time"][:: self._num_robots]

    def bind(self, indices: Sequence[int]) -> None:
        """Connect sub-environments to the shared arrays after a reset: robot states, worlds, task data, time limits."""
        envs, num_robots = self.envs, self._num_robots
        rows = self.rows
        if rows.surroundings is None:
            rows.surroundings = repeat(_surroundings(envs[0]), len(envs))
            rows.task_arrays = [repeat(each, len(envs)) for each in envs[0].task.arrays]
        for i in indices:
            env, robots = envs[i], slice(i * num_robots, (i + 1) * num_robots)
            memory = {name: kept[robots] for name, kept in rows.memory.items()}
            env.rows.share(self.numbers[robots], rows.ranges[robots], self._draws[robots], memory)
            env.period.begin()
            put(rows.surroundings, i, _surroundings(env))
            for arrays, array in zip(rows.task_arrays or (), env.task.arrays, strict=True):
                put(arrays, i, array)
            self._is_new[robots] = True
            self._noted[1][robots] = 0
            rewards, weights = env.task.rewards, envs[0].task.rewards.weights
            is_unobserved = not env.sensors and env.on_period is None
            self._are_alike[i] = (
                not (rewards.reads_shared or overridden(rewards)) and rewards.weights == weights,
                is_unobserved and _has_own(env.task, "update_rows", "update", "quantities", "metrics", "end_reason"),
                all(type(robot.estimator) is DeadReckoning for robot in env.robots) and not env.robots[0].has_known_map,
            )
            self._time_limits[i] = env.time_limit
            follows = all(robot.estimator.follows_odometry and robot.tracker is None for robot in env.robots)
            self._rests[i] = follows and is_unobserved and (env.task.rests_between_scans or self._are_alike[i, 1])
        self._has_columns, self.updates_rows, self._has_no_maps = np.all(self._are_alike, axis=0).tolist()

    def step(self, active: np.ndarray, is_last: np.ndarray, records: Records) -> np.ndarray:
        """Step the active sub-environments by one control period, and return a mask of ended episodes.

        `is_last`: mask of sub-environments to truncate. Masks have shape (num_envs,), bool. Rewards and `info` of ended
        episodes are left to the caller.
        """
        self._is_last = is_last
        self.run(self.act(np.clip(self._arrays.actions, -1.0, 1.0).reshape(-1, 2)), active)
        self._observe(np.flatnonzero(active).tolist())
        if not self.updates_rows:
            for i in self._busy:
                self._is_over[i] |= self.envs[i].task.end_reason is not None
        going = active & ~self._is_over
        if going.any():
            self._write_outcomes(going, [i for i in self._busy if going[i]], records)
        return self._is_over

    def move(self, active: np.ndarray) -> None:
        rows, numbers, envs = self.rows, self.numbers, self.envs
        rows.active[:] = np.repeat(active, self._num_robots)
        for i in np.flatnonzero(active & (numbers["draw"][:: self._num_robots] == BLOCK - 1)).tolist():
            envs[i].rows.draw_ahead(envs[i].simulator.rngs)
        step_rows(numbers, self._draws, rows.ranges, active, self._num_robots, rows.surroundings)
        if self._has_no_maps and record_positions(numbers, rows.active, *self._noted):
            self._extend_trails(range(len(active)))

    def advance(self, active: Any = None) -> None:
        super().advance(active)
        self._columns: Any = ()
        if self.updates_rows:
            *self._columns, has_ended = self.envs[0].task.update_rows(self.rows)
            late = np.flatnonzero(active & has_ended & ~self._is_over).tolist()
            self._is_over[late], self._is_behind[late] = True, False
            self._finish(late)
            for i in np.flatnonzero(self._is_over).tolist():
                self.envs[i].period.quantities = _quantities(self.envs[i])

    def due(self, active: np.ndarray) -> Iterable[int]:
        """Locate robots of resting environments; return the indices of the others."""
        flags = self.numbers["pending"].reshape(len(active), -1)
        self._has_scanned = (flags % 2.0 == SCAN).any(axis=1)
        has_no_time = self._times >= self._time_limits - TIME_TOLERANCE
        self._is_over = active & (self._is_last | has_no_time)
        busy = active & (~self._rests | self._has_scanned | self._is_new[:: self._num_robots] | self._is_over)
        idle = active & ~busy
        has_own_parts = not all(self._part_writes_rows.values())
        for i in np.flatnonzero(idle if has_own_parts else idle & flags.any(axis=1)).tolist():
            self.locate(i)
        self._is_behind = (self._is_behind | idle) & ~busy
        self._busy = np.flatnonzero(busy).tolist()
        if self._has_no_maps:
            self._extend_trails(self._busy)
        return self._busy

    def update_task(self, i: int) -> None:
        if not self.updates_rows:  # by `advance`, for all environments at once
            super().update_task(i)

    def catch_up(self) -> None:
        """Update the Python objects of sub-environments after steps that changed only the state arrays."""
        self._finish(np.flatnonzero(self._is_behind).tolist())
        self._is_behind[:] = False

    def _finish(self, indices: Sequence[int]) -> None:
        if self._has_no_maps:
            self._extend_trails(indices)
        for i in indices:
            self.finish(i)

    def _extend_trails(self, indices: Iterable[int]) -> None:
        positions, counts = self._noted
        for i in indices:
            for k, (robot, truth) in enumerate(zip(self.envs[i].robots, self.envs[i].truths, strict=True)):
                extend_trail(robot, truth, positions[i * self._num_robots + k], counts[i * self._num_robots + k])

    def _observe(self, indices: Sequence[int]) -> None:
        for name, part in self.envs[0].parts.items():
            out = self._arrays.observations[name]
            if self._part_writes_rows[name]:
                part.write(self.rows, out.reshape(len(self.rows.robots), *out.shape[1 + self.envs[0].task.is_team :]))
            else:
                for i in indices:
                    self.envs[i].write_part(name, out[i])
        self._is_new[:] = False

    def _write_outcomes(self, going: np.ndarray, chosen: list[int], records: Records) -> None:
        """Write rewards and `info` of the environments that go on. `chosen`: those that are not at rest."""
        tasks, numbers, where = [env.task for env in self.envs], self.numbers, slice(None) if going.all() else going
        rows = {} if self._columns else {i: self.envs[i].period.quantities for i in chosen}
        self._names = next(iter(rows.values()), self._names)
        touching = (numbers["touched"] > 0.0).reshape(len(tasks), -1).sum(axis=1)
        time = np.full(len(tasks), self.envs[0].control_period)
        passed = {**{name: 0.0 * time for name in self._names}, "time": time, "collision": time * touching}
        metrics: dict[str, np.ndarray] = {}
        quantities, metrics = self._columns or (passed, metrics)
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
                terms = self.envs[i].reward_terms(row)
                self._arrays.rewards[i] = tasks[i].rewards.checked_total(terms)
                records.note(i, {"rewards": terms}, ("rewards",))
        info: dict[str, np.ndarray] = {"time": self._times, "pose_error": pose_errors(numbers), **metrics}
        info |= {"path_length": numbers["path_length"], "collisions": numbers["collisions"]}
        if self.has_costs:
            info["cost"] = costs(numbers, self._num_robots)
        for name, column in info.items():
            records.rows[name][where] = column.reshape(len(going), *records.rows.dtype[name].shape)[where]
        if not self.updates_rows:
            self._note_metrics(chosen, records)

    def _note_metrics(self, chosen: list[int], records: Records) -> None:
        rows = [self.envs[i].task.metrics() for i in chosen]
        own_info = OWN_INFO | ({"randomized"} if self.envs[0].randomization else set())
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


def _has_own(thing: Any, by_rows: str, *one_by_one: str) -> bool:
    names = {by_rows, *one_by_one}
    return by_rows in vars(next((kind for kind in type(thing).__mro__ if names & vars(kind).keys()), object))
