"""What vector environments in lanes share: lanes, their resets, and how their episodes end."""

import itertools
import math
import os
from abc import ABC
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from envs.compilation import announce_compilation
from envs.coverage import map_iou
from envs.explore import ExploreEnv
from envs.lanes import Lanes, Scratch, Views, step_lanes
from envs.lanes.numbers import numbers_of
from envs.rewards import RewardWeights
from envs.simulation import KinematicSimulator
from envs.slam import GivenPoseSlam, TinySlam


class LaneVectorEnv(gymnasium.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray], ABC):
    """Explorations in lanes, with kinematic physics; subclasses step them.

    Each lane's own `ExploreEnv` does its resets. Its numbers are rows of arrays that all lanes share, its walls and
    maps stay where the environment put them, and kernels reach them by address.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        num_threads: int | None = None,
        physics: str = "kinematic",
        render_mode: None = None,
        **arguments: Any,
    ) -> None:
        """Build the lanes.

        Args:
            num_envs: number of lanes.
            autoreset_mode: when a lane whose episode has ended starts the next one: with the step after
                (`NEXT_STEP`), at once (`SAME_STEP`), or when `reset` is called with a `reset_mask` (`DISABLED`).
            max_episode_steps: truncates episodes after so many steps, besides the time limit.
            num_threads: how many cores step lanes; `None` takes those that the process may use.
            physics: "kinematic" is the only one that runs in lanes.
            render_mode: None; pictures are made by the single environment.
            **arguments: the other arguments of `ExploreEnv`.

        Raises:
            ValueError: if an argument is not among the allowed values.
        """
        self.closed = True  # until there is something to close
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {num_envs}")
        if physics != "kinematic":
            raise ValueError(
                f"physics must be 'kinematic' in lanes, got {physics!r}; for others use "
                "gymnasium.make_vec(..., vectorization_mode='async')"
            )
        if render_mode is not None:
            raise ValueError(f"render_mode must be None in lanes, got {render_mode!r}; gymnasium.make draws pictures")
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps must be at least 1 or None, got {max_episode_steps}")
        num_threads = len(os.sched_getaffinity(0)) if num_threads is None else num_threads
        if num_threads < 1:
            raise ValueError(f"num_threads must be at least 1 or None, got {num_threads}")
        announce_compilation(step_lanes)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**ExploreEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = None
        self.envs = [ExploreEnv(physics=physics, **arguments) for _ in range(num_envs)]
        self._simulators = [cast(KinematicSimulator, env.simulator) for env in self.envs]
        self._slams = [cast(TinySlam | GivenPoseSlam, env.slam) for env in self.envs]
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        for env in self.envs:  # each would hold bounds of its own for every pixel
            env.observation_space = self.single_observation_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        spaces = cast(gymnasium.spaces.Dict, self.observation_space)
        self._view_type: type = Views
        self._view_spaces = [cast(gymnasium.spaces.Box, spaces[name]) for name in Views._fields]
        self._views = self._new_views()
        self._max_steps = max_episode_steps or np.iinfo(np.int64).max
        self._numbers = numbers_of(self.envs[0], self._simulators[0], self._slams[0])
        self._loses_beams = self.envs[0].robot.lidar.dropout > 0.0
        lidar = self.envs[0].robot.lidar
        max_tries = 0 if self._numbers.told_pose else self._numbers.max_tries
        self._lanes = Lanes.of(num_envs, lidar.num_beams, self._loses_beams, max_tries)
        reach = math.ceil(lidar.range_max / self._numbers.resolution) + 2
        bounds = np.linspace(0, num_envs, min(num_threads, num_envs) + 1).round().astype(int).tolist()
        self._shares = [(k, *share) for k, share in enumerate(itertools.pairwise(bounds))]
        self._scratch = Scratch.of(len(self._shares), lidar.num_beams, reach)
        self._workers = ThreadPoolExecutor(max_workers=len(self._shares), thread_name_prefix="lanes")
        self._directions = self._slams[0].map.directions
        self._circles = [(np.empty((0, 3)),) * 2] * num_envs
        self._moving: set[int] = set()
        self._num_seen = np.zeros(num_envs, dtype=np.int64)
        self._num_explorable = np.ones(num_envs, dtype=np.int64)
        self._returns = np.zeros(num_envs)
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._waiting = np.zeros(num_envs, dtype=np.bool_)
        self._preparer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="places")
        self._preparations: list[Future[None] | None] = [None] * num_envs
        self.closed = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in every lane, or in those that `options["reset_mask"]` (shape (num_envs,), bool) selects.

        Args:
            seed: of lane 0, lane i gets `seed + i`; or one per lane.
            options: see above.
        """
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        else:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed must be one number or {self.num_envs} of them, got {len(seeds)}")
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
                raise ValueError(f"reset_mask must have shape ({self.num_envs},), dtype bool and select a lane")
        views = self._new_views()
        rewards = {name: np.zeros(self.num_envs) for name in RewardWeights.names()}
        for i in np.flatnonzero(mask).tolist():
            self._reset_lane(i, seeds[i], views)
        for i in np.flatnonzero(~mask).tolist():
            for view, last in zip(views, self._views, strict=True):
                view[i] = last[i]
        self._views = views
        return views._asdict(), self._info(rewards)

    def close_extras(self, **kwargs: Any) -> None:
        """Stop preparing places."""
        self._preparer.shutdown(wait=True, cancel_futures=True)
        self._workers.shutdown()
        for env in self.envs:
            env.close()

    @property
    def state_bytes(self) -> int:
        """Memory that the lanes hold beside their observations [bytes], all lanes together."""
        rows = sum(rows.nbytes for rows in self._lanes)
        maps = sum(slam.map.words.nbytes + slam.map.grid.data.nbytes for slam in self._slams)
        maps += sum(env.pyramid.near.nbytes + env.pyramid.far.nbytes for env in self.envs)
        return rows + maps + sum(env.coverage.seen.nbytes + env.trail.buffer.nbytes for env in self.envs)

    def _take_active(self) -> np.ndarray:
        """Return the lanes that have not ended, shape (num_envs,), bool.

        Raises:
            ValueError: if a lane has, and no step resets it.
        """
        active = ~self._ended
        if self.autoreset_mode == AutoresetMode.DISABLED and not active.all():
            raise ValueError(f"lanes {np.flatnonzero(~active).tolist()} have ended; reset them with a reset_mask")
        return active

    def _finish(
        self, rewards: dict[str, np.ndarray], terminated: np.ndarray, truncated: np.ndarray, views: Any
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take note of a step's outcome, and return what `step` returns.

        Args:
            rewards: terms, shape (num_envs,) each.
            terminated: shape (num_envs,), bool.
            truncated: shape (num_envs,), bool.
            views: observations; those of lanes that start anew are replaced.
        """
        total = np.asarray(sum(rewards.values()))
        self._returns += total
        self._ended = terminated | truncated
        self._views = views
        info = self._info(rewards)
        if self._ended.any():
            info = self._end(info, rewards, terminated, views)
        return views._asdict(), total, terminated, truncated, info

    def _in_threads(self, work: Callable[..., None], tasks: Sequence[tuple[Any, ...]]) -> None:
        """Call `work` with each tuple of arguments, side by side, and return once the last call is over.

        Raises:
            Exception: the first call's that failed; also then nothing runs any more that reaches lanes by address.
        """
        if len(tasks) == 1:
            work(*tasks[0])
            return
        calls = [self._workers.submit(work, *task) for task in tasks]
        try:
            for call in calls:
                call.result()
        finally:
            wait(calls)

    def _new_views(self) -> Any:
        return self._view_type(*(np.empty(space.shape, space.dtype) for space in self._view_spaces))

    def _reset_lane(self, i: int, seed: int | None, views: Views) -> None:
        """Start an episode in lane `i` as the single environment does, and copy what it begins with."""
        env = self.envs[i]
        preparation = self._preparations[i]
        if preparation is not None:
            preparation.result()
        observation, info = env.reset(seed=seed)
        for name, view in zip(Views._fields, views, strict=True):
            view[i] = observation[name]
        lanes, simulator, area = self._lanes, self._simulators[i], env.coverage.area
        lanes.state[i] = simulator.rows[0]
        lanes.belief[i] = env.belief.pose
        lanes.drawn[i] = env.belief.drawn_at
        lanes.start[i] = env.start
        lanes.ticks[i] = env.reading.ticks
        lanes.bumper[i] = env.reading.bumper
        lanes.pose_error[i] = info["pose_error"]
        for row in (lanes.collisions, lanes.path_length, lanes.gained, lanes.steps, self._returns):
            row[i] = 0
        lanes.time_limit[i] = env.time_limit
        lanes.segments[i] = env.world.segments.ctypes.data, len(env.world.segments)
        circles = simulator.circles
        self._circles[i] = (circles.copy(), circles.copy()) if env.world.movers else (circles, circles)
        lanes.circles[i] = *(array.ctypes.data for array in self._circles[i]), len(circles)
        (self._moving.add if env.world.movers else self._moving.discard)(i)
        lanes.area[i] = area.explorable.ctypes.data, env.coverage.seen.ctypes.data, *area.explorable.shape
        lanes.area_frame[i] = *area.walls.origin, area.walls.resolution
        lanes.trail[i] = env.trail.buffer.ctypes.data, len(env.trail.positions), len(env.trail.buffer)
        self._point_to_map(i)
        self._num_explorable[i] = np.count_nonzero(area.explorable)
        self._num_seen[i] = np.count_nonzero(env.coverage.seen)
        env.belief.new_cells = env.belief.new_cells[:0].copy()
        self._ended[i] = False
        self._preparations[i] = self._preparer.submit(env.prepare)

    def _point_to_map(self, i: int) -> None:
        grid_map = self._slams[i].map
        words, occupancy = grid_map.words, grid_map.grid.data
        self._lanes.map[i] = words.ctypes.data, occupancy.ctypes.data, *words.shape
        self._lanes.corner[i] = grid_map.corner
        near, far = self.envs[i].pyramid.near, self.envs[i].pyramid.far
        self._lanes.pyramid[i] = near.ctypes.data, len(near), far.ctypes.data, len(far)

    def _move_circles_of(self, i: int) -> None:
        """Move what moves in lane `i`."""
        before, after = self._circles[i]
        before[:] = after
        after[:] = self.envs[i].world.circles_at((self._lanes.steps[i] + 1) * self._numbers.period)

    def _make_room(self, i: int) -> None:
        """Enlarge lane `i`'s map or trail, which its step would overrun."""
        lanes, env, slam = self._lanes, self.envs[i], self._slams[i]
        if lanes.trail[i, 1] == lanes.trail[i, 2]:
            env.trail.enlarge()
            lanes.trail[i] = env.trail.buffer.ctypes.data, lanes.trail[i, 1], len(env.trail.buffer)
        if slam.map.grow_to_hold(*lanes.touched[i].tolist()):
            env.pyramid.rebuild(env.belief.grid, env.trail.buffer[: lanes.trail[i, 1]])
            self._point_to_map(i)

    @property
    def _lengths(self) -> np.ndarray:
        """Steps that the environment has taken since the reset, shape (num_envs,)."""
        return self._lanes.steps

    def _reason(self, i: int, terminated: bool) -> str:
        """Return why lane `i`'s episode has ended."""
        return "covered" if terminated else "time_limit"

    @property
    def _cell_area(self) -> float:
        return self._numbers.resolution**2

    @property
    def _fractions(self) -> np.ndarray:
        return self._num_seen / self._num_explorable

    def _info(self, rewards: dict[str, np.ndarray]) -> dict[str, Any]:
        lanes, everyone = self._lanes, np.ones(self.num_envs, dtype=np.bool_)
        fractions = self._fractions
        info: dict[str, Any] = {
            "explored_fraction": fractions,
            "explored_area": self._num_seen * self._cell_area,
            "pose_error": lanes.pose_error.copy(),
            "path_length": lanes.path_length.copy(),
            "collisions": lanes.collisions.copy(),
            "time": lanes.steps * self._numbers.period,
            "rewards": {**rewards, **{f"_{name}": everyone for name in rewards}},
            "is_success": fractions >= self.envs[0].target_coverage,
        }
        return info | {f"_{name}": everyone for name in info}

    def _end(
        self, info: dict[str, Any], rewards: dict[str, np.ndarray], terminated: np.ndarray, views: Views
    ) -> dict[str, Any]:
        """Complete the info of a step in which episodes ended; start the next ones where that is due."""
        lanes, ended = self._lanes, self._ended.copy()
        where = np.flatnonzero(ended).tolist()
        episode = {
            "r": np.where(ended, self._returns, 0.0),
            "l": np.where(ended, self._lengths, 0),
            "t": np.where(ended, lanes.steps * self._numbers.period, 0.0),
        }
        iou = np.zeros(self.num_envs)
        reasons = np.full(self.num_envs, None, dtype=object)
        for i in where:
            env = self.envs[i]
            iou[i] = map_iou(self._slams[i].map.grid, env.coverage.area, env.start)
            reasons[i] = self._reason(i, bool(terminated[i]))
        final = {"map_iou": iou, "end_reason": reasons, "_map_iou": ended, "_end_reason": ended}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            final_obs = np.full(self.num_envs, None, dtype=object)
            for i in where:
                final_obs[i] = {name: view[i].copy() for name, view in views._asdict().items()}
            final_info = info | final
            for i in where:
                self._reset_lane(i, None, views)
            zeroed = {name: np.where(ended, 0.0, term) for name, term in rewards.items()}
            info = self._info(zeroed) | {"final_obs": final_obs, "_final_obs": ended}
            info |= {"final_info": _masked(final_info, ended), "_final_info": ended}
        else:
            info |= final
        masks = dict.fromkeys(("_r", "_l", "_t"), ended)
        return info | {"episode": episode | masks, "_episode": ended}


def _masked(info: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Return the same info with every mask replaced."""
    return {
        name: _masked(value, mask) if isinstance(value, dict) else mask if name.startswith("_") else value
        for name, value in info.items()
    }
