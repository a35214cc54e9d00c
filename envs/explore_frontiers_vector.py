"""Many explorations at the level of decisions in one process; each lane's whole drive is one compiled kernel."""

from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from envs.explore_frontiers import candidates_space, make_choice
from envs.frontier_choice import OUTCOMES, RESET
from envs.geometry import OccupancyGrid, Pose2D
from envs.lane_vector import LaneVectorEnv
from envs.lanes.decisions import ROOM, STEPPED, Pilots, Tallies, drive_on
from envs.observation import fill_motion
from envs.slam import TinySlam


class FrontierViews(NamedTuple):
    """Observations of all lanes; see `ExploreFrontiersEnv`."""

    candidates: np.ndarray
    action_mask: np.ndarray
    map: np.ndarray
    motion: np.ndarray


class ExploreFrontiersVectorEnv(LaneVectorEnv):
    """`ExploreFrontiersEnv` in many lanes, with kinematic physics.

    Lane i does exactly, to the last bit, what a single environment with `physics="kinematic"` does that is seeded with
    seed + i. Lanes take their decisions side by side, however long each one's drive is. `info` is that of
    `ExploreVectorEnv` with what `ExploreFrontiersEnv` adds; `l` of `episode` counts decisions, and so does
    `max_episode_steps`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_candidates: int = 24,
        max_decision_time: float = 4.0,
        control_hz: float = 5.0,
        **arguments: Any,
    ) -> None:
        """Build the lanes.

        Args:
            num_envs: number of lanes.
            max_candidates: see `ExploreFrontiersEnv`.
            max_decision_time: see `ExploreFrontiersEnv`.
            control_hz: see `ExploreFrontiersEnv`.
            **arguments: the other arguments of `ExploreVectorEnv`.

        Raises:
            ValueError: if an argument is not among the allowed values.
        """
        super().__init__(num_envs, control_hz=control_hz, **arguments)
        self._choices = [make_choice(env, max_candidates, max_decision_time) for env in self.envs]
        self._pilots = [LanePilot(self, i) for i in range(num_envs)]
        self.single_action_space = spaces.Discrete(max_candidates)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.single_observation_space = candidates_space(max_candidates)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._starts = self._new_views()
        self._view_type = FrontierViews
        batch = cast(spaces.Dict, self.observation_space)
        self._view_spaces = [cast(spaces.Box, batch[name]) for name in FrontierViews._fields]
        self._views = self._new_views()
        self._tallies = Tallies.of(self._num_seen, self._num_explorable)
        self._decisions = np.zeros(num_envs, dtype=np.int64)
        self._taken = np.full(num_envs, -1)
        self._outcomes = np.full(num_envs, RESET)
        self._length_before = np.zeros(num_envs)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive in every lane until its next decision is due.

        Args:
            actions: shape (num_envs,), int.

        Raises:
            ValueError: if the actions have the wrong shape or type, or do not lie in 0 to `max_candidates` - 1.
        """
        actions = self._checked(actions)
        active = self._take_active()
        views = self._new_views()
        for i in np.flatnonzero(~active).tolist():
            self._reset_lane(i, None, views)
        area, tallies = self._num_seen * self._cell_area, self._tallies
        self._length_before[:] = self._lanes.path_length
        for row in (tallies.steps, tallies.touches):
            row[:] = 0
        lanes = iter(np.flatnonzero(active).tolist())
        self._in_threads(self._decide, [(share[0], lanes, actions, views) for share in self._shares])

        self._decisions[active] += 1
        covered, late = active & tallies.covered, active & tallies.late
        terminated = covered | (active & ~late & ~views.action_mask.any(axis=1))
        truncated = active & ~terminated & (late | (self._decisions >= self._max_steps))
        gained = self._num_seen * self._cell_area - area
        touching = tallies.touches / np.maximum(tallies.steps, 1)
        terms = self.envs[0].weights.terms(gained, touching, covered, tallies.steps * self._numbers.period)
        rewards = {name: np.where(active, term, 0.0) for name, term in terms.items()}
        return self._finish(rewards, terminated, truncated, views)

    def action_masks(self) -> np.ndarray:
        """Return which actions have a candidate in each lane, shape (num_envs, max_candidates), bool."""
        return self._views.action_mask.astype(np.bool_)

    def pose_of(self, i: int) -> Pose2D:
        """Return where lane `i`'s robot believes to be, map frame."""
        return Pose2D(*self._lanes.belief[i].tolist())

    def time_of(self, i: int) -> float:
        """Return the time since lane `i`'s reset [s]."""
        return float(self._lanes.steps[i] * self._numbers.period)

    def drive(self, thread: int, i: int) -> int:
        """Drive lane `i` until its pilot has something to say; see `drive_on`."""
        choice, simulator, slam = self._choices[i], self._simulators[i], self._slams[i]
        pilots = Pilots(choice.pilot, choice.path, choice.obstacles, choice.given_up)
        slam_rng = slam.rng if isinstance(slam, TinySlam) else simulator.rngs[0]
        moves, target = i in self._moving, self.envs[i].target_coverage
        shared = (self._tallies, self._lanes, self._numbers, choice.numbers, self._directions, self._scratch)
        code = STEPPED
        while code in (STEPPED, ROOM):
            if code == ROOM:
                self._make_room(i)
            elif moves:
                self._move_circles_of(i)
            lane = (i, code == ROOM, moves, pilots, choice.block, simulator.rngs[0], slam_rng, target)
            code = drive_on(thread, *lane, *shared)
        return code

    def _decide(self, thread: int, lanes: Iterator[int], actions: np.ndarray, views: FrontierViews) -> None:
        """Take the decisions of lanes, as long as the iterator that all threads share has one left."""
        for i in lanes:
            choice, pilot = self._choices[i], self._pilots[i]
            pilot.thread = thread
            self._taken[i] = choice.valid(int(actions[i]))
            self._outcomes[i] = choice.decide(int(self._taken[i]), pilot)
            self._look(i, views)

    def _look(self, i: int, views: FrontierViews) -> None:
        """Compose lane `i`'s observation."""
        choice, env, rows, numbers = self._choices[i], self.envs[i], self._lanes, self._numbers
        command = self._tallies.command[i]
        views.candidates[i], views.action_mask[i] = choice.features, choice.mask
        env.pyramid.crop(*self._pilots[i].pose, np.empty_like(views.map[i]), views.map[i])
        fill_motion(
            rows.twist[i, 0],
            rows.twist[i, 1],
            numbers.drive.max_v,
            numbers.drive.max_w,
            command[0],
            command[1],
            rows.bumper[i],
            rows.steps[i] * numbers.period / rows.time_limit[i],
            views.motion[i],
        )

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        actions, last = np.asarray(actions), len(self._choices[0].features) - 1
        if actions.shape != (self.num_envs,) or not np.issubdtype(actions.dtype, np.integer):
            raise ValueError(
                f"actions must be integers of shape ({self.num_envs},), got {actions.dtype} of shape {actions.shape}"
            )
        wrong = (actions < 0) | (actions > last)
        if wrong.any():
            lane = int(np.argmax(wrong))
            raise ValueError(f"actions must lie in 0 to {last}, got {actions[lane]} in lane {lane}")
        return actions

    def _reset_lane(self, i: int, seed: int | None, views: Any) -> None:
        """Start an episode in lane `i`, and look for what there is to choose from."""
        super()._reset_lane(i, seed, self._starts)
        choice, env, tallies = self._choices[i], self.envs[i], self._tallies
        self._lanes.twist[i] = 0.0
        for row in (tallies.steps, tallies.touches, tallies.covered, tallies.late, tallies.command):
            row[i] = 0
        self._decisions[i], self._taken[i], self._outcomes[i], self._length_before[i] = 0, -1, RESET, 0.0
        choice.reset()
        choice.sense(env.reading.ranges, 0.0, 0.0, env.reading.bumper)
        choice.survey(self._pilots[i])
        self._look(i, views)

    @property
    def _lengths(self) -> np.ndarray:
        """Decisions since the reset, shape (num_envs,)."""
        return self._decisions

    def _reason(self, i: int, terminated: bool) -> str:
        """Return why lane `i`'s episode has ended."""
        reason = super()._reason(i, terminated)
        return self._choices[i].end_reason if terminated and not self._tallies.covered[i] else reason

    def _info(self, rewards: dict[str, np.ndarray]) -> dict[str, Any]:
        everyone, tallies = np.ones(self.num_envs, dtype=np.bool_), self._tallies
        own = {
            "action_mask": np.array([choice.mask for choice in self._choices]),
            "action": self._taken.copy(),
            "outcome": np.array([OUTCOMES[code] for code in self._outcomes.tolist()], dtype=object),
            "decision_time": tallies.steps * self._numbers.period,
            "decision_length": self._lanes.path_length - self._length_before,
            "decision_steps": tallies.steps.copy(),
            "area_left": self._num_explorable * self._cell_area - self._num_seen * self._cell_area,
        }
        return super()._info(rewards) | own | {f"_{name}": everyone for name in own}


class LanePilot:
    """A lane as its `FrontierChoice` sees it: a `Body`."""

    def __init__(self, env: ExploreFrontiersVectorEnv, lane: int) -> None:
        """Stand for a lane."""
        self._env = env
        self._lane = lane
        self.thread = 0
        """Which thread drives."""

    @property
    def grid(self) -> OccupancyGrid:
        """The map that the robot believes in."""
        return self._env.envs[self._lane].belief.grid

    @property
    def pose(self) -> Pose2D:
        """Where it believes to be, map frame."""
        return self._env.pose_of(self._lane)

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return self._env.time_of(self._lane)

    def drive(self) -> int:
        """Drive until the pilot has something to say."""
        return self._env.drive(self.thread, self._lane)
