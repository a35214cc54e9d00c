"""Robot teams as PettingZoo environments; requires the extra `[pettingzoo]`."""

import copy
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

try:
    from pettingzoo import AECEnv, ParallelEnv
except ImportError as error:
    raise ImportError("needs PettingZoo: pip install 'lidarnaut[pettingzoo]', or -e '.[pettingzoo]'") from error

from lidarnaut.envs.arguments import read_options
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.explore_team_frontiers import ExploreTeamFrontiersEnv
from lidarnaut.envs.tasks.explore import ExploreTeam

Observation = dict[str, np.ndarray]
PER_ROBOT = ("pose_error", "path_length", "collisions")
"""Keys of `info` with one value per robot."""
OPTIONS = ("world", "start")
"""Keys of `options` that `reset` supports."""


class _Team:
    env: Any
    agents: list[str]
    observation_spaces: dict[str, spaces.Space]
    action_spaces: dict[str, spaces.Space]

    def observation_space(self, agent: str) -> spaces.Space:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        return self.action_spaces[agent]

    def render(self) -> np.ndarray | None:
        return self.env.render()

    def close(self) -> None:
        self.env.close()

    def _check_begun(self) -> None:
        if not self.agents:
            raise gymnasium.error.ResetNeeded("call reset first: no episode has begun, or all agents have ended")


class TeamParallelEnv(_Team, ParallelEnv[str, Observation, np.ndarray]):
    """Exploration by a robot team as a PettingZoo `ParallelEnv` with agents "robot_0", "robot_1", ...

    Wraps `ExploreTeam-v0` and takes the same arguments. Each agent has its own actions, observations and per-robot
    `info`. Agents share reward (see `info["rewards"]`) and episode end.
    """

    metadata: ClassVar[dict[str, Any]] = {**LidarEnv.metadata, "name": "lidarnaut_explore_team_v0"}

    def __init__(self, **arguments: Any) -> None:
        self.env = LidarEnv(ExploreTeam, **arguments)
        self.render_mode = self.env.render_mode
        self.possible_agents = [f"robot_{k}" for k in range(self.env.task.num_robots)]
        self.agents: list[str] = []
        observation, action = self.env.observation_space, self.env.action_space
        assert isinstance(observation, spaces.Dict)
        rows: dict[str, spaces.Space] = {name: _row(part) for name, part in observation.items()}
        self.observation_spaces = {agent: spaces.Dict(rows) for agent in self.possible_agents}
        self.action_spaces = {agent: _row(action) for agent in self.possible_agents}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode. `options`: `world` and `start` poses of this episode.

        Unknown options are ignored, as PettingZoo's API test requires.
        """
        self.agents = list(self.possible_agents)
        known = {name: value for name, value in read_options(options).items() if name in OPTIONS}
        observation, info = self.env.reset(seed=seed, options=known)
        return self._split(observation), self._infos(info)

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Apply one action (v, w) in [-1, 1] per agent for one control period.

        Raises:
            ValueError: missing or unknown agents, or an invalid action.
            gymnasium.error.ResetNeeded: before `reset`, after the episode, or after a failed step.
        """
        self._check_begun()
        agents = self.agents
        if not isinstance(actions, Mapping) or set(actions) != set(agents):
            raise ValueError(f"actions must map each of {agents} to its action, got {actions!r}")
        for agent, action in actions.items():
            if np.shape(action) != (2,):
                raise ValueError(f"action of {agent} must have shape (2,), got {action!r}")
        rows = np.stack([actions[agent] for agent in agents])
        observation, reward, terminated, truncated, info = self.env.step(rows)
        split, infos = self._split(observation), self._infos(info)
        if terminated or truncated:
            self.agents = []
        ended = dict.fromkeys(agents, bool(terminated)), dict.fromkeys(agents, bool(truncated))
        return split, dict.fromkeys(agents, float(reward)), *ended, infos

    def state(self) -> np.ndarray:
        """Return the team's map: -1 unknown, 0 to 100 % occupied, int8. The shape (height, width) may grow."""
        return self.env.belief.grid.data.copy()

    def _split(self, observation: Observation) -> dict[str, Observation]:
        return {agent: {name: rows[k] for name, rows in observation.items()} for k, agent in enumerate(self.agents)}

    def _infos(self, info: dict[str, Any]) -> dict[str, dict[str, Any]]:
        rows = ({name: info[name][k] for name in PER_ROBOT} for k in range(len(self.agents)))
        return {agent: copy.deepcopy(info | own) for agent, own in zip(self.agents, rows, strict=True)}


class TeamFrontiersAECEnv(_Team, AECEnv[str, Observation, np.int64]):
    """Exploration by a robot team as a PettingZoo `AECEnv`: robots choose frontiers in turn.

    Wraps `ExploreTeamFrontiers-v0` and takes the same arguments. An agent is selected when its robot needs a frontier.
    Agents share reward and episode end.
    """

    metadata: ClassVar[dict[str, Any]] = {
        **LidarEnv.metadata,
        "name": "lidarnaut_explore_team_frontiers_v0",
        "is_parallelizable": False,
    }

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        self.env = ExploreTeamFrontiersEnv(**arguments)
        self.render_mode = self.env.render_mode
        self.possible_agents = [f"robot_{k}" for k in range(len(self.env.explore.robots))]
        self.observation_spaces = dict.fromkeys(self.possible_agents, self.env.observation_space)
        self.action_spaces = dict.fromkeys(self.possible_agents, self.env.action_space)
        self.agents = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start an episode. `options`: `world` and `start` poses of this episode."""
        known = {name: value for name, value in read_options(options).items() if name in OPTIONS}
        observation, info = self.env.reset(seed=seed, options=known)
        self.agents = list(self.possible_agents)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self._seen = {agent: {name: np.zeros_like(part) for name, part in observation.items()} for agent in self.agents}
        self._take(observation, info, terminated=False, truncated=False)

    def step(self, action: Any) -> None:
        """Send the selected agent's robot to frontier number `action`; drive all robots until one needs a new frontier.

        Raises:
            ValueError: the action is not an integer from 0 to `max_candidates` - 1, or that of an ended agent is not
                None.
            gymnasium.error.ResetNeeded: before `reset`, after the episode, or after a failed step.
        """
        self._check_begun()
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._cumulative_rewards[agent] = 0.0
        self.rewards = dict.fromkeys(self.agents, float(reward))
        self._accumulate_rewards()
        self._take(observation, info, terminated=terminated, truncated=truncated)

    def observe(self, agent: str) -> Observation:
        """Return an agent's observation from when its robot last needed a frontier; zeros before the first time."""
        return self._seen[agent]

    def _take(self, observation: Observation, info: dict[str, Any], *, terminated: bool, truncated: bool) -> None:
        self.agent_selection = f"robot_{info['robot']}"
        self._seen[self.agent_selection] = observation
        self.infos = {agent: copy.deepcopy(info) for agent in self.agents}
        self.terminations = dict.fromkeys(self.agents, bool(terminated))
        self.truncations = dict.fromkeys(self.agents, bool(truncated))


def _row(space: spaces.Space) -> spaces.Box:
    assert isinstance(space, spaces.Box)
    return spaces.Box(space.low[0], space.high[0], dtype=space.dtype)
