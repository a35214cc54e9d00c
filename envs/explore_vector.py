"""Many exploration environments in one process, stepped together by compiled kernels."""

from typing import Any

import numpy as np

from envs.lane_vector import LaneVectorEnv
from envs.lanes import Views, finish_lanes, step_lanes
from envs.slam import TinySlam


class ExploreVectorEnv(LaneVectorEnv):
    """`ExploreEnv` in many lanes, with kinematic physics.

    Lane i does exactly, to the last bit, what a single environment with `physics="kinematic"` does that is seeded with
    seed + i. Observations are fresh arrays each step. Places for coming episodes are prepared in a background thread.

    `info` holds arrays with an entry per lane, each with its mask (`_time` beside `time`); what belongs to the end of
    an episode (`map_iou`, `end_reason`, `episode` with return `r`, length `l` and duration `t`) is masked for the lanes
    that ended. With `AutoresetMode.SAME_STEP` the observation and the info that a lane ended with are in `final_obs`
    and `final_info`.
    """

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
        return self._finish(rewards, terminated, truncated, views)

    def _step_all(self, actions: np.ndarray, active: np.ndarray, views: Views) -> None:
        """Step active lanes, a share of them on each core."""
        self._in_threads(self._step_share, [(*share, actions, active, views) for share in self._shares])
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

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != (self.num_envs, 2):
            raise ValueError(f"actions must have shape ({self.num_envs}, 2), got {actions.shape}")
        wrong = ~(np.abs(actions) <= 1.0).all(axis=1)
        if wrong.any():
            lane = int(np.argmax(wrong))
            raise ValueError(f"actions must be finite and lie in [-1, 1], got {actions[lane]} in lane {lane}")
        return actions

    def _draw_noise(self, first: int, last: int, active: np.ndarray) -> None:
        """Draw the noise of lanes `first` to `last` - 1 as each one's own simulator and SLAM would."""
        lanes = self._lanes
        for i in range(first, last):
            if not active[i]:
                continue
            simulator, slam = self._simulators[i], self._slams[i]
            simulator.rngs[0].standard_normal(out=lanes.normals[i])
            if self._loses_beams:
                simulator.rngs[0].random(out=lanes.uniforms[i])
            if isinstance(slam, TinySlam):
                slam.rng.standard_normal(out=lanes.candidates[i])

    def _move_circles(self, active: np.ndarray) -> None:
        """Move what moves."""
        for i in self._moving:
            if active[i]:
                self._move_circles_of(i)

    def _judge(self, active: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """Return the reward terms, and which lanes terminate and truncate."""
        lanes, env, period = self._lanes, self.envs[0], self._numbers.period
        terminated = active & (self._fractions >= env.target_coverage)
        late = (lanes.steps * period >= lanes.time_limit - 1e-6) | (lanes.steps >= self._max_steps)
        terms = env.weights.terms(lanes.gained * self._cell_area, lanes.bumper, terminated, period)
        rewards = {name: np.where(active, term, 0.0) for name, term in terms.items()}
        return rewards, terminated, active & late & ~terminated
