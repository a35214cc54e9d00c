"""Episodes of a team, and their measures."""

from dataclasses import dataclass

import numpy as np

from baselines.episode import Decide, Info, Observation, Watch, first_at, run
from baselines.explorer import to_action
from baselines.rrt.team import RrtTeam
from envs.core import LidarEnv


@dataclass(frozen=True, slots=True, eq=False)
class TeamEpisode:
    """The measures of one episode of a team; times are infinite where the mark was never reached."""

    explored_fraction: float
    """Share of the explorable area that was explored at the end."""
    area_left: float
    """Explorable area that was not explored at the end [m2]."""
    time_to_90: float
    time_to_95: float
    time_to_99: float
    """Times until 90, 95 and 99 % were explored [s]."""
    path_length: np.ndarray
    """Shape (num_robots,), distance that each robot drove [m]."""
    collisions: np.ndarray
    """Shape (num_robots,), int64, contacts that each robot had."""
    position_rmse: np.ndarray
    """Shape (num_robots,), root mean square error of each estimated position [m]."""
    end_reason: str
    """Why it ended: "covered" or "time_limit", or why the team stopped ("no_reachable_frontier", ...)."""
    duration: float
    """Time at the end [s]."""
    time_limit: float
    """Time limit [s]."""


def decide_with_team(team: RrtTeam, env: LidarEnv) -> Decide:
    """Return the decisions of a team in an environment, which also gets its plans to draw."""

    def decide(observation: Observation) -> np.ndarray | str:
        twists = team.act([robot.reading for robot in env.robots], [robot.belief for robot in env.robots])
        env.plans = team.plans
        return team.end_reason or np.stack([to_action(twist, env.robot) for twist in twists])

    return decide


def run_team_episode(env: LidarEnv, team: RrtTeam, seed: int, on_step: Watch | None = None) -> TeamEpisode:
    """Let a team explore until the target coverage or the time limit is reached, or the team stops.

    The seed and `on_step` are those of `baselines.episode.run_episode`; the team gets readings and beliefs only.
    """
    observation, info = env.reset(seed=seed)
    # The environment spawns its generators from the seed; the pair is a root of its own beside them.
    team.reset(env.robot, env.control_period, env.task.num_robots, np.random.default_rng([seed, 1]))
    samples: list[tuple[float, ...]] = []

    def watch(info: Info) -> None:
        samples.append((info["time"], info["explored_fraction"], *info["pose_error"][:, 0]))
        if on_step:
            on_step(info)

    info = run(env, decide_with_team(team, env), observation, info, watch).info
    time, explored, *errors = np.array(samples).T
    return TeamEpisode(
        explored_fraction=float(explored[-1]),
        area_left=env.task.coverage.area.area - info["explored_area"],
        time_to_90=first_at(time, explored, 0.90),
        time_to_95=first_at(time, explored, 0.95),
        time_to_99=first_at(time, explored, 0.99),
        path_length=info["path_length"],
        collisions=info["collisions"],
        position_rmse=np.sqrt(np.square(errors).mean(axis=1)),
        end_reason=info["end_reason"],
        duration=float(time[-1]),
        time_limit=env.time_limit,
    )
