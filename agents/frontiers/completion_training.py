"""Train the network that completes maps: `python -m lidarnaut.agents.frontiers.completion_training OUT`.

The rule `gain_over_cost` explores worlds that training may see; what it knows around its candidates, and what is there,
are the samples. Losses are cross entropies of unknown cells, which count less the farther from the viewpoint they are.
"""

import math
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from numba import njit
from torch.nn import functional

from lidarnaut.agents.learned import find_policy
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.progress import Progress

from .completion import BLOCKED, CELL, FREE, SIDE, UNKNOWN, Completion, CompletionNetwork, crop
from .rollout import explore
from .score import RECORD_FILE, WEIGHTS_FILE, FrontierScore
from .tasks import Task, draw_task, make_environment

PER_DECISION = 4
"""Candidates of a decision that become samples, at most."""
NEAR = 4.0
"""Distance over which the weight of a cell falls to 1/e [m]."""
BATCH, RATE = 64, 2e-3
"""Samples of a step, and the greatest learning rate."""


@njit(cache=True, error_model="numpy")
def true_crop(is_open, frame, pose, x, y, out):
    """Write which cells around a point (x, y), map frame [m], are free and which are blocked; see `crop`.

    `is_open`: shape (height, width), bool, world frame: cells that can be explored; `frame`: as for `crop`; `pose`: of
    the map frame (x, y, theta) in the world frame. A cell is free where all that is below it can be explored.
    """
    height, width = is_open.shape
    left, low, side = frame
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(SIDE):
        for j in range(SIDE):
            free = True
            for k in range(4):
                by = y + CELL * (i - SIDE / 2 + (k // 2 + 0.5) / 2)
                bx = x + CELL * (j - SIDE / 2 + (k % 2 + 0.5) / 2)
                row = math.floor((pose[1] + s * bx + c * by - low) / side)
                col = math.floor((pose[0] + c * bx - s * by - left) / side)
                free &= 0 <= row < height and 0 <= col < width and is_open[row, col]
            out[i, j] = FREE if free else BLOCKED


def samples_of(task: Task) -> np.ndarray:
    """Explore a task by the rule; return what is known around candidates, and the truth: (n, 2, SIDE, SIDE), uint8."""
    env = make_environment(task.robot, task.resolution, task.drift)
    rule, rng, samples = FrontierScore(), np.random.default_rng(task.seed), list[np.ndarray]()

    def choose(observation: dict[str, np.ndarray]) -> np.int64:
        area, planning, views = env.explore.task.coverage.area, env.navigator.map, env.candidates["viewpoint"]
        frame, world = (*planning.origin, planning.side), (*area.walls.origin, area.walls.resolution)
        for k in rng.choice(len(views), min(len(views), PER_DECISION), replace=False).tolist():
            sample, (x, y) = np.empty((2, SIDE, SIDE), dtype=np.uint8), views[k].tolist()
            crop(planning.joined, frame, x, y, sample[0])
            true_crop(area.explorable, world, tuple(env.explore.map_pose), x, y, sample[1])
            samples.append(sample)
        return rule(observation)

    explore(task, choose)
    return np.array(samples, dtype=np.uint8).reshape(-1, 2, SIDE, SIDE)


def fit(samples: np.ndarray, steps: int, rng: np.random.Generator) -> CompletionNetwork:
    """Train a network on samples, shape (n, 2, SIDE, SIDE), uint8, turned and mirrored at random."""
    torch.manual_seed(int(rng.integers(2**31)))
    network = CompletionNetwork()
    optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    away = CELL * (np.arange(SIDE) + 0.5 - SIDE / 2)
    weights = torch.from_numpy(np.exp(-np.hypot(away, away[:, None]) / NEAR)).float()
    with Progress(total=steps, unit="step", desc="training") as bar:
        for _ in range(steps):
            batch = torch.from_numpy(samples[rng.integers(len(samples), size=BATCH)])
            batch = torch.rot90(batch, int(rng.integers(4)), (2, 3))
            batch = batch.flip(3) if rng.random() < 0.5 else batch
            known, truth = batch[:, 0], (batch[:, 1] == BLOCKED).float()
            counted = weights * (known == UNKNOWN)
            losses = functional.binary_cross_entropy_with_logits(network(known), truth, reduction="none")
            loss = (losses * counted).sum() / counted.sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            bar.update(1)
            bar.set_postfix(loss=f"{loss.item():.3f}")
    return network


def main(
    out: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    score: str = "pretrained/frontiers",
    tasks: int = 600,
    steps: int = 2000,
    seed: int = 0,
    jobs: int = 2,
) -> None:
    """Train a network, and write it with a score of frontiers to a folder, which is a policy then.

    Args:
        out: folder to write.
        score: folder of the score that is given the network's estimates.
        tasks: number of explored worlds.
        steps: of gradients.
        seed: of tasks and weights.
        jobs: processes that explore.

    Raises:
        CheckpointError: if there is no such score.
    """
    rated = find_policy(score)
    FrontierScore.load(rated)
    drawn = [draw_task(np.random.default_rng([seed, 3, k])) for k in range(tasks)]
    with ProcessPoolExecutor(jobs) as pool, Progress(total=tasks, unit="world", desc="exploring") as bar:
        samples = []
        for some in pool.map(samples_of, drawn):
            samples.append(some)
            bar.update(1)
    network = fit(np.concatenate(samples), steps, np.random.default_rng([seed, 4]))
    out.mkdir(parents=True, exist_ok=True)
    for name in WEIGHTS_FILE, RECORD_FILE:
        shutil.copyfile(rated / name, out / name)
    Completion(network).save(out, {"tasks": str(tasks), "steps": str(steps), "seed": str(seed)})


if __name__ == "__main__":
    run_command(main)
