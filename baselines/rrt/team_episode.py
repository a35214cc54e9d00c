"""One team, one place, one seed: what came of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.rrt.team import RrtTeam
from envs.explore_team import ExploreTeamEnv


@dataclass(frozen=True, slots=True, eq=False)
class TeamEpisode:
    """The measures of one episode of a team. A mark that was never reached counts as the time limit."""

    explored_fraction: float
    """Truly known share of the explorable area at the end."""
    area_left: float
    """Explorable area that was still unknown at the end [m2]."""
    time_to_90: float
    """Time until 90 % was explored [s]."""
    time_to_95: float
    """Time until 95 % was explored [s]."""
    time_to_99: float
    """Time until 99 % was explored [s]."""
    path_length: np.ndarray
    """Shape (num_robots,), distance that each robot drove [m]."""
    collisions: np.ndarray
    """Shape (num_robots,), int64, contacts that each robot had."""
    position_rmse: np.ndarray
    """Shape (num_robots,), root mean square error of each believed position [m]."""
    end_reason: str
    """Why it ended: "covered" or "time_limit", or why the team stopped ("no_reachable_frontier", ...)."""
    duration: float
    """Time at the end [s]."""
    time_limit: float
    """Time that there was [s]."""


def run_team_episode(
    env: ExploreTeamEnv, team: RrtTeam, seed: int, on_step: Callable[[dict[str, Any]], None] | None = None
) -> TeamEpisode:
    """Let a team explore until the place is covered, the time is up, or the team stops.

    Args:
        env: the environment.
        team: decides; it sees observations and beliefs only.
        seed: of everything: place, starts, noise, and the team's own draws.
        on_step: called with `info` after the reset and after every step, to record pictures.
    """
    observation, info = env.reset(seed=seed)
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    team.reset(env.robot, env.control_period, env.num_robots, np.random.default_rng([seed, 1]))
    infos, end_reason = [info], None
    while end_reason is None:
        if on_step:
            on_step(info)
        action = team.act(observation, env.beliefs)
        end_reason = team.end_reason
        if end_reason is None:
            env.plans = team.plans
            observation, _, _, _, info = env.step(action)
            infos.append(info)
            end_reason = info.get("end_reason")
    times = np.array([info["time"] for info in infos])
    fractions = np.array([info["explored_fraction"] for info in infos])
    errors = np.array([info["pose_error"][:, 0] for info in infos])

    def time_to(mark: float) -> float:
        reached = times[fractions >= mark]
        return float(reached[0]) if len(reached) else env.time_limit

    return TeamEpisode(
        explored_fraction=float(fractions[-1]),
        area_left=env.coverage.area.area - info["explored_area"],
        time_to_90=time_to(0.90),
        time_to_95=time_to(0.95),
        time_to_99=time_to(0.99),
        path_length=info["path_length"],
        collisions=info["collisions"],
        position_rmse=np.sqrt((errors**2).mean(axis=0)),
        end_reason=end_reason,
        duration=float(times[-1]),
        time_limit=env.time_limit,
    )
