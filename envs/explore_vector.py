"""Many exploration environments in one process, stepped together by compiled kernels."""

import itertools
import math
import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from envs.compilation import announce_compilation
from envs.coverage import map_iou
from envs.explore import ExploreEnv
from envs.lanes import Lanes, Numbers, Scratch, Views, finish_lanes, step_lanes
from envs.map_pyramid import block_size
from envs.rewards import RewardWeights
from envs.simulation import KinematicSimulator
from envs.simulation.sensors import LidarNumbers
from envs.slam import GivenPoseSlam, TinySlam


class ExploreVectorEnv(gymnasium.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """`ExploreEnv` in many lanes, with kinematic physics.

    Lane i does exactly, to the last bit, what a single environment with `physics="kinematic"` does that is seeded with
    seed + i. Observations are fresh arrays each step. Places for coming episodes are prepared in a background thread.

    `info` holds arrays with an entry per lane, each with its mask (`_time` beside `time`); what belongs to the end of
    an episode (`map_iou`, `end_reason`, `episode` with return `r`, length `l` and duration `t`) is masked for the lanes
    that ended. With `AutoresetMode.SAME_STEP` the observation and the info that a lane ended with are in `final_obs`
    and `final_info`.
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
        self._numbers = _numbers_of(self.envs[0], self._simulators[0], self._slams[0])
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

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive every lane for one control period.

        Args:
            actions: shape (num_envs, 2), in [-1, 1].

        Raises:
            ValueError: if the actions have the wrong shape, are not finite, or lie outside [-1, 1].
        """
        actions = self._checked(actions)
        active = self._take_active()
        views = self._new_views()
        for i in np.flatnonzero(~active).tolist():
            self._reset_lane(i, None, views)
        self._move_circles(active)
        self._step_all(actions, active, views)

        self._num_seen[active] += self._lanes.gained[active]
        rewards, terminated, truncated = self._judge(active)
        total = np.asarray(sum(rewards.values()))
        self._returns += total
        self._ended = terminated | truncated
        self._views = views
        info = self._info(rewards)
        if self._ended.any():
            info = self._end(info, rewards, terminated, views)
        return views._asdict(), total, terminated, truncated, info

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

    def _step_all(self, actions: np.ndarray, active: np.ndarray, views: Views) -> None:
        """Step active lanes, a share of them on each core."""
        if len(self._shares) == 1:
            self._step_share(*self._shares[0], actions, active, views)
        else:
            work = [self._workers.submit(self._step_share, *share, actions, active, views) for share in self._shares]
            for done in work:
                done.result()
        if self._waiting.any():
            for i in np.flatnonzero(self._waiting).tolist():
                self._make_room(i)
            finish_lanes(actions, self._waiting, self._lanes, self._numbers, self._directions, self._scratch, views)

    def _step_share(
        self, thread: int, first: int, last: int, actions: np.ndarray, active: np.ndarray, views: Views
    ) -> None:
        """Step lanes `first` to `last` - 1."""
        self._draw_noise(first, last, active)
        shared = (self._lanes, self._numbers, self._directions, self._scratch)
        step_lanes(thread, first, last, actions, active, self._waiting, *shared, views)

    def _new_views(self) -> Any:
        return self._view_type(*(np.empty(space.shape, space.dtype) for space in self._view_spaces))

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != (self.num_envs, 2):
            raise ValueError(f"actions must have shape ({self.num_envs}, 2), got {actions.shape}")
        wrong = ~(np.abs(actions) <= 1.0).all(axis=1)
        if wrong.any():
            lane = int(np.argmax(wrong))
            raise ValueError(f"actions must be finite and lie in [-1, 1], got {actions[lane]} in lane {lane}")
        return actions

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
        lanes.state[i] = simulator.row
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

    def _draw_noise(self, first: int, last: int, active: np.ndarray) -> None:
        """Draw the noise of lanes `first` to `last` - 1 as each one's own simulator and SLAM would."""
        lanes = self._lanes
        for i in range(first, last):
            if not active[i]:
                continue
            simulator, slam = self._simulators[i], self._slams[i]
            simulator.rng.standard_normal(out=lanes.normals[i])
            if self._loses_beams:
                simulator.rng.random(out=lanes.uniforms[i])
            if isinstance(slam, TinySlam):
                slam.rng.standard_normal(out=lanes.candidates[i])

    def _move_circles(self, active: np.ndarray) -> None:
        """Move what moves."""
        for i in self._moving:
            if active[i]:
                self._move_circles_of(i)

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

    def _judge(self, active: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """Return the reward terms, and which lanes terminate and truncate."""
        lanes, env, period = self._lanes, self.envs[0], self._numbers.period
        terminated = active & (self._fractions >= env.target_coverage)
        late = (lanes.steps * period >= lanes.time_limit - 1e-6) | (lanes.steps >= self._max_steps)
        terms = env.weights.terms(lanes.gained * self._cell_area, lanes.bumper, terminated, period)
        rewards = {name: np.where(active, term, 0.0) for name, term in terms.items()}
        return rewards, terminated, active & late & ~terminated

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


def _numbers_of(env: ExploreEnv, simulator: KinematicSimulator, slam: TinySlam | GivenPoseSlam) -> Numbers:
    """Collect the numbers that the kernels need."""
    robot, params = env.robot, slam.params
    if params.odometry != "robot_frame":
        raise ValueError(f"lanes compose odometry in the robot's frame, not in {params.odometry!r}")
    return Numbers(
        drive=simulator.drive,
        lidar=LidarNumbers.of(robot.lidar),
        period=env.control_period,
        substeps=simulator.substeps,
        ticks_per_radian=robot.odometry.ticks_per_rev / (2.0 * math.pi),
        metres_per_tick=env.odometry.metres_per_tick,
        odometry_track=float(robot.odometry.track),
        told_pose=isinstance(slam, GivenPoseSlam),
        told_truth=env.slam_is_told_the_truth,
        resolution=float(params.resolution),
        block=block_size(params.resolution),
        sigma_xy=params.sigma_xy / params.resolution,
        sigma_theta=float(params.sigma_theta),
        max_failed=params.max_failed,
        max_tries=params.max_tries,
        unvisited=slam.map.unvisited,
        cell=slam.map.kind,
        by_area=params.estimator == "area",
        occupied_prob=float(params.occupied_prob),
        empty_prob=float(params.empty_prob),
        quality=float(params.quality),
        raw_quality=float(params.raw_quality),
        hole=params.hole_width / params.resolution,
        add_blur=params.blur == "add",
        skip_exceeding=params.skip_exceeding,
        draw_distance=float(params.draw_distance),
        draw_angle=float(params.draw_angle),
    )
