"""How fast simple rules explore in `lidarnaut/ExploreFrontiers-v0`: `python -m benchmarks.decision_rules`.

Kinematic physics, TinySLAM, several settings of the environment, beside the `nearest` explorer that steers by itself.
"""

import numpy as np
from rich.table import Table

from baselines import make_explorer
from baselines.episode import run, run_episode
from envs.command_line import make_console, run_command
from envs.core import LidarEnv
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.navigation import FEATURES
from envs.navigation.candidate_features import HALF_AREA, HALF_COST
from envs.progress import Progress
from envs.tasks.explore import Explore

VISIBLE, COST, FAILURES = (FEATURES.index(name) for name in ("visible", "cost", "failures"))
WORLDS = {
    "rooms 10 m x 10 m": ({"world": "rooms", "world_size": (10.0, 10.0), "split": "test"}, 8),
    "turtlebot3_house": ({"world": "turtlebot3_house"}, 6),
}
"""Arguments and number of starts of each world."""
SETTINGS = ((5.0, 4.0), (10.0, 4.0), (4.0, 4.0), (5.0, 15.0))
"""Control steps per second, and the longest decision [s]."""
MARK = 0.95
"""Explored fraction that is waited for."""


def nearest(observation: dict[str, np.ndarray]) -> np.int64:
    """Take the candidate with the cheapest path; those that failed come last."""
    features, mask = observation["candidates"], observation["action_mask"] == 1
    return np.int64(np.where(mask, features[:, COST] + 10.0 * (features[:, FAILURES] > 0), np.inf).argmin())


def gain_over_cost(observation: dict[str, np.ndarray]) -> np.int64:
    """Take the candidate with the most unknown area in view over its cost; those that failed come last."""
    features, mask = observation["candidates"], observation["action_mask"] == 1
    cost = HALF_COST * features[:, COST] / (1.0 - features[:, COST])
    visible = HALF_AREA * features[:, VISIBLE] / (1.0 - features[:, VISIBLE])
    utility = (visible + 0.3) / (cost + 3.0) - 1000.0 * (features[:, FAILURES] > 0)
    return np.int64(np.where(mask, utility, -np.inf).argmax())


RULES = {"nearest": nearest, "gain over cost": gain_over_cost}


def time_rule(rule: str, world: str, control_hz: float, max_decision_time: float, seed: int) -> float:
    """Return the time to `MARK` [s]; the time limit if it was not reached."""
    arguments = {**WORLDS[world][0], "physics": "kinematic", "target_coverage": MARK}
    env = ExploreFrontiersEnv(control_hz=control_hz, max_decision_time=max_decision_time, **arguments)
    observation, info = env.reset(seed=seed)
    if not info["is_success"]:
        info = run(env, RULES[rule], observation, info).info
    return float(info["time"] if info["is_success"] else env.explore.time_limit)


def time_explorer(world: str, seed: int) -> float:
    """Return the same for the `nearest` explorer."""
    env = LidarEnv(Explore, physics="kinematic", target_coverage=MARK, **WORLDS[world][0])
    episode = run_episode(env, make_explorer("nearest"), seed)
    return min(episode.time_to_95, episode.time_limit)


def main() -> None:
    """Print mean times to 95 %."""
    columns = [(rule, world) for rule in RULES for world in WORLDS]
    table = Table("mean time to 95 %, s", *(f"{rule}, {world}" for rule, world in columns))
    for setting in Progress(SETTINGS, "settings"):
        means = [
            np.mean([time_rule(rule, world, *setting, seed) for seed in range(WORLDS[world][1])])
            for rule, world in columns
        ]
        table.add_row("{:g} Hz, {:g} s".format(*setting), *(f"{mean:.0f}" for mean in means))
    own = [np.mean([time_explorer(world, seed) for seed in range(WORLDS[world][1])]) for world in WORLDS]
    table.add_row("nearest explorer, 10 Hz", *(f"{mean:.0f}" for mean in own))
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
