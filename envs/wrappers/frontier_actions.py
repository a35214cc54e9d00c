"""Decisions in place of twists: an action picks a frontier, and the robot drives there."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from envs.arguments import check_positive
from envs.compilation import announce_compilation
from envs.estimation import Belief
from envs.explore import ExploreEnv
from envs.navigation import FEATURES, Candidates, FrontierNavigator
from envs.navigation.candidates import find_candidates
from envs.observations import FAR_PIXEL, MapCrop, make_parts
from envs.robots import RobotParams

RESET, EPISODE_END = "reset", "episode_end"
"""Outcomes beside those of `FrontierNavigator`: there was no drive yet; the episode ended in the midst of one."""


class FrontierActions(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """Drives the robot of an exploration from decision to decision; see `ExploreFrontiersEnv`.

    Control steps in between make no observations and no `info`.
    """

    def __init__(self, env: ExploreEnv, *, max_candidates: int, max_decision_time: float) -> None:
        """Take an exploration with one robot.

        Args:
            env: what is driven.
            max_candidates: frontiers that are offered at most.
            max_decision_time: longest drive, but for recoveries and looking around [s].

        Raises:
            ValueError: if `max_candidates` or `max_decision_time` is not positive.
        """
        if max_candidates < 1:
            raise ValueError(f"max_candidates must be at least 1, got {max_candidates}")
        check_positive(max_decision_time=max_decision_time)
        announce_compilation(find_candidates)
        self.explore = env
        """The environment that is driven."""
        self.navigator = FrontierNavigator(
            env.robot, env.control_period, max_candidates=max_candidates, max_time=max_decision_time
        )
        self.render_mode = env.render_mode
        self.metadata = env.metadata
        self._max_candidates = max_candidates
        self._parts = make_parts({"map": {"resolution": FAR_PIXEL}, "motion": None}, {"map": MapCrop})
        self.action_space = spaces.Discrete(max_candidates)
        own: dict[str, spaces.Space[Any]] = {
            "candidates": spaces.Box(-1.0, 1.0, (max_candidates, len(FEATURES)), np.float32),
            "action_mask": spaces.MultiBinary(max_candidates),
        }
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            own | {name: part.space(env.robot) for name, part in self._parts.items()}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode and return the first observation and info; see `LidarEnv.reset`."""
        super().reset(seed=seed)
        _, info = self.explore.reset(seed=seed, options=options)
        self.navigator.begin(self.explore.reading, self.belief)
        self._steps, self._quantities = 0, dict.fromkeys(info["rewards"], 0.0)
        self._path_length, self._taken, self._result = 0.0, -1, RESET
        return self.observe(), self._info()

    def step(self, action: np.int64) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive until the next decision is due.

        Raises:
            ValueError: if the action is not an integer from 0 to `max_candidates` - 1.
        """
        self.apply(action)
        return self.observe(), *self.outcome()

    def apply(self, action: Any) -> None:
        """Drive until the next decision is due, without an observation or outcome; raises as `step`."""
        if not self.action_space.contains(action):
            raise ValueError(f"action must be an integer from 0 to {self._max_candidates - 1}, got {action!r}")
        self._steps, self._quantities = 0, dict.fromkeys(self._quantities, 0.0)
        self._path_length = self.explore.truths[0].path_length
        self._taken = min(int(action), len(self.candidates) - 1)
        if self._taken >= 0:
            self.navigator.choose(self._taken)
        else:
            self.navigator.look_around()
        self._result = self._drive()

    def outcome(self, is_last: bool = False) -> tuple[float, bool, bool, dict[str, Any]]:
        """Return reward, terminated, truncated and info of the last decision; see `LidarEnv.outcome`."""
        explore, info = self.explore, self._info()
        terminated, truncated = explore.is_over
        reason = explore.task.end_reason
        if not (terminated or truncated or len(self.candidates)):
            terminated, reason = True, self.navigator.end_reason
        truncated = truncated or (is_last and not terminated)
        if terminated or truncated:
            info |= explore.task.final_metrics()
            info["end_reason"] = reason or "time_limit"
        return sum(info["rewards"].values()), terminated, truncated, info

    def observe(self, out: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """Return the observation in fresh arrays, or write it to the arrays of `out`."""
        if out is None:
            spaces_ = self.observation_space.spaces  # type: ignore[attr-defined]
            out = {name: np.empty(space.shape, space.dtype) for name, space in spaces_.items()}
        self.navigator.write_features(self.belief.pose, out["candidates"])
        out["action_mask"][...] = self._mask()
        for name, part in self._parts.items():
            part.write(self.explore.robots[0], out[name])
        return dict(out)

    def action_masks(self) -> np.ndarray:
        """Return which actions have a candidate, shape (max_candidates,), bool, as sb3-contrib's MaskablePPO asks."""
        return self._mask().astype(np.bool_)

    @property
    def candidates(self) -> Candidates:
        """What there is to choose from, for rules (`baselines.frontier`)."""
        return self.navigator.candidates

    @property
    def belief(self) -> Belief:
        """Pose estimate and map of the robot."""
        return self.explore.belief

    @property
    def robot(self) -> RobotParams:
        """The robot."""
        return self.explore.robot

    def prepare(self) -> None:
        """Draw the world of the next episode ahead of time; see `LidarEnv.prepare`."""
        self.explore.prepare()

    def render(self) -> np.ndarray | None:
        """Draw this moment; an array (height, width, 3), uint8, for `rgb_array`."""
        return self.explore.render()

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.explore.close()

    def _drive(self) -> str:
        """Drive until a decision is due, and return why."""
        explore, navigator, robot = self.explore, self.navigator, self.explore.robots[0]
        max_v, max_w = robot.params.max_v, robot.params.max_w
        while True:
            if explore.render_mode == "human":
                explore.plan = navigator.plan
                explore.render()
            twist = navigator.command(robot.belief)
            robot.action = twist.v / max_v, twist.w / max_w
            explore.advance([twist])
            self._steps += 1
            for name, quantity in explore.task.quantities().items():
                self._quantities[name] += quantity
            if any(explore.is_over):
                navigator.look(robot.reading, robot.belief)
                return EPISODE_END
            result = navigator.update(robot.reading, robot.belief)
            if result is not None:
                explore.plan = navigator.plan
                return result

    def _mask(self) -> np.ndarray:
        mask = np.zeros(self._max_candidates, dtype=np.int8)
        mask[: len(self.candidates)] = 1
        return mask

    def _info(self) -> dict[str, Any]:
        """Return the info of the exploration after a decision, with what there is to say of the decision."""
        explore = self.explore
        info = explore.info(explore.task.weights.terms(self._quantities))
        return info | {
            "action_mask": self._mask(),
            "action": self._taken,
            "outcome": self._result,
            "decision_time": self._steps * explore.control_period,
            "decision_length": info["path_length"] - self._path_length,
            "decision_steps": self._steps,
            "area_left": explore.coverage.area.area - info["explored_area"],
        }
