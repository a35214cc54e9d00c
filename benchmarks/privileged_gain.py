"""What the truth about gains would buy explorers: `python -m benchmarks.privileged_gain`.

The gain of a frontier is the unknown area in view from it as if nothing unknown blocked the view. Here the rule
`gain_over_cost` and a score choose with true gains, or leave frontiers without any for last, in the abstract simulator,
on tasks drawn as for training, but from all six families. What that saves of the time to 95 % bounds what a prediction
saves, with these weights.
"""

import math

import numpy as np
from rich.table import Table

from agents.frontiers.features import LEAST_GAIN
from agents.frontiers.rollout import MAX_RATIO, explore
from agents.frontiers.score import FrontierScore
from agents.frontiers.tasks import draw_task, make_environment
from agents.learned import find_policy
from benchmarks.arena.statistics import paired_ratio
from benchmarks.parallel import run_each
from envs.abstract import ExploreFrontiersAbstractEnv
from envs.command_line import Count, make_console, run_command
from envs.navigation.candidate_features import FAILURES, HALF_AREA, VISIBLE
from envs.navigation.candidate_views import NUM_RAYS, cast_view, ray_directions
from envs.navigation.params import PlanningParams

KNOWN = ("what the robot knows", "true gains", "which gain nothing")
"""What choices are made by."""


def true_gains(env: ExploreFrontiersAbstractEnv) -> np.ndarray:
    """Return the explorable area in view of each candidate that is not explored yet, shape (k,), float64 [m2]."""
    coverage, view_range = env.explore.task.coverage, min(PlanningParams().view_range, env.robot.lidar.range_max)
    area, walls = coverage.area, coverage.area.walls
    truth = np.where(walls.data > 0, 100, np.where(area.explorable & ~coverage.explored, -1, 0)).astype(np.int8)
    free, unknown = np.empty((2, NUM_RAYS))
    gains = np.empty(len(env.candidates))
    for k, (row, col) in enumerate(walls.cells(coverage.start.transform(env.candidates.viewpoints))):
        cast_view(truth, row, col, round(view_range / walls.resolution), ray_directions(), free, unknown)
        gains[k] = unknown.sum() * walls.resolution**2
    return gains


class PrivilegedScore(FrontierScore):
    """A score that chooses by ground truth."""

    def __init__(self, weights: np.ndarray, env: ExploreFrontiersAbstractEnv, known: str) -> None:
        """Take weights as `FrontierScore`, the environment that is explored, and one of `KNOWN`."""
        super().__init__(weights)
        self._env, self._known = env, known

    def __call__(self, observation: dict[str, np.ndarray]) -> np.int64:
        """Return the candidate to go to."""
        candidates, gains = observation["candidates"].copy(), true_gains(self._env)
        if self._known == "true gains":
            candidates[: len(gains), VISIBLE] = gains / (gains + HALF_AREA)
        elif self._known == "which gain nothing":
            candidates[: len(gains), FAILURES] = np.maximum(candidates[: len(gains), FAILURES], gains < LEAST_GAIN)
        return super().__call__(observation | {"candidates": candidates})


def time_scores(seed: tuple[int, int], weights: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the times to the target [s] by weights and by `KNOWN` in the task of a seed: shape (n, len(KNOWN))."""
    task = draw_task(np.random.default_rng(seed))
    env, limit, logs = make_environment(task), math.inf, []
    for row, known in ((row, known) for row in weights for known in KNOWN):
        logs.append(explore(env, PrivilegedScore(row, env, known), task, limit))
        limit = MAX_RATIO * math.exp(logs[0])
    return np.exp(logs).reshape(len(weights), len(KNOWN))


def main(tasks: Count = 200, policy: str = "pretrained/frontiers", seed: int = 0, jobs: Count = 2) -> None:
    """Measure and print a table.

    Args:
        tasks: how many worlds, robots and starts are drawn.
        policy: folder of a score, or `pretrained/NAME`.
        seed: draws the tasks.
        jobs: number of processes.
    """
    scores = {"gain_over_cost": FrontierScore().weights, policy: FrontierScore.load(find_policy(policy)).weights}
    work = [((seed, i), tuple(scores.values())) for i in range(tasks)]
    times = np.array(run_each(time_scores, work, jobs, unit="task"))
    table = Table("score", "knows", *(f"time / {name}'s" for name in scores))
    for i, j in np.ndindex(len(scores), len(KNOWN)):
        ratios = [paired_ratio([times[:, i, j]], [times[:, k, 0]]) for k in range(len(scores))]
        table.add_row(list(scores)[i], KNOWN[j], *(f"{e.iqm:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in ratios))
    make_console().print(f"{tasks} tasks drawn as for training, from all families", table)


if __name__ == "__main__":
    run_command(main)
