"""How well the abstract simulator agrees with the real one, and how fast it is: `python -m benchmarks.abstract`.

Geometric means of the time to 95 % in training worlds, kinematic physics, and decisions per second of processor time.
The ratio of two rules is what learning needs: it is compared from the same starts.
"""

import time

import numpy as np
from rich.table import Table

from baselines.frontier.explorer import FrontierRule
from baselines.frontier.gain_over_cost import GainOverCost
from baselines.frontier.nearest import nearest
from envs.abstract import ExploreFrontiersAbstractEnv
from envs.command_line import Count, make_console, run_command
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.progress import Progress

WORLDS = {
    "rooms": {"world": "rooms", "world_size": (14.0, 14.0)},
    "maze": {"world": "maze", "world_size": (10.0, 10.0)},
    "caves": {"world": "caves", "world_size": (14.0, 14.0)},
    "rrt_house": {"world": "rrt_house"},
    "rmf_battle_royale_L1": {"world": "rmf_battle_royale_L1"},
}
RULES: dict[str, FrontierRule] = {"nearest": nearest, "gain_over_cost": GainOverCost()}
SIMULATORS = {
    "real, Hector": (ExploreFrontiersEnv, {"physics": "kinematic"}),
    "real, ground truth": (ExploreFrontiersEnv, {"physics": "kinematic", "slam": "truth"}),
    "abstract, 0.1 m": (ExploreFrontiersAbstractEnv, {"map_resolution": 0.1}),
    "abstract, 0.2 m": (ExploreFrontiersAbstractEnv, {"map_resolution": 0.2}),
}


def measure(env: ExploreFrontiersEnv, rule: FrontierRule, starts: int) -> tuple[np.ndarray, float]:
    """Return the times to the target [s], the time limit where it was not reached, and decisions per second."""
    times, decisions, began = [], 0, time.process_time()
    for seed in range(starts):
        env.reset(seed=seed)
        done = False
        while not done:
            *_, terminated, truncated, info = env.step(np.int64(rule(env.candidates, env.belief)))
            decisions += 1
            done = terminated or truncated
        times.append(info["time"] if info["is_success"] else env.explore.time_limit)
    return np.array(times), decisions / (time.process_time() - began)


def main(starts: Count = 12) -> None:
    """Print the table.

    Args:
        starts: in each world.
    """
    table = Table("simulator", *(f"{world}: {rule}" for world in WORLDS for rule in RULES), "ratio", "decisions/s")
    for name, (make, arguments) in Progress(SIMULATORS.items(), "simulators"):
        cells, ratios, rates = [], [], []
        for world in WORLDS.values():
            env = make(target_coverage=0.95, **world, **arguments)  # type: ignore[operator]
            found = {rule: measure(env, choose, starts) for rule, choose in RULES.items()}
            cells += [f"{np.exp(np.log(times).mean()):.0f}" for times, _ in found.values()]
            rates += [rate for _, rate in found.values()]
            ratios.append(np.log(found["gain_over_cost"][0] / found["nearest"][0]))
        ratio = np.exp(np.concatenate(ratios).mean())
        table.add_row(name, *cells, f"{ratio:.2f}", f"{np.mean(rates):.0f}")
    make_console().print(table)


if __name__ == "__main__":
    run_command(main)
