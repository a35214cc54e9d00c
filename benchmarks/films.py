"""Record animations of environments for the documentation: `python -m lidarnaut.benchmarks.films`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import yaml
from PIL import Image

from lidarnaut.agents.policies import make_policy
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import run_episode
from lidarnaut.benchmarks.arena.episodes import REFERENCES
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import lidar_env_of

NUM_FRAMES = 48
"""Maximum number of frames of an animation, without the final frame."""
FRAME_MS, HOLD_MS = 100, 3000
"""Display time of a frame, and of the final frame [ms]."""
QUALITY = 50
WORLDS = {
    "lidarnaut/Explore-v0": "aws_small_house",
    "lidarnaut/ExploreFrontiersAbstract-v0": "rrt_house",
    "lidarnaut/ExploreTeam-v0": "rrt_house",
    "lidarnaut/Navigate-v0": "turtlebot3_house",
}
SEEDS = {"lidarnaut/Navigate-v0": 3}


def record(env: gymnasium.Env, every: float | None = None) -> list[np.ndarray]:
    """Return a list to which an environment with `render_mode="rgb_array"` adds frames while it is stepped.

    `every`: simulated time between frames [s]; by default it doubles whenever there are `NUM_FRAMES` frames, of which
    every second one is dropped.
    """
    base: Any = lidar_env_of(env)
    frames: list[np.ndarray] = []
    interval = every or base.control_period

    def shoot(_: Any) -> None:
        nonlocal interval
        if base.time < len(frames) * interval - 1e-6:
            return
        if every is None and len(frames) == NUM_FRAMES:
            del frames[1::2]
            interval *= 2.0
        frames.append(base.render())

    base.on_period = shoot
    return frames


def save_film(frames: Sequence[np.ndarray], path: Path, width: int = 960) -> None:
    """Save RGB frames, shape (height, width, 3), uint8, as a looping GIF or WebP of `width` pixels."""
    size = width, round(frames[0].shape[0] * width / frames[0].shape[1])
    first, *rest = [Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in frames]
    durations = [FRAME_MS] * len(rest) + [HOLD_MS]
    first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, quality=QUALITY)


def main(
    only: str = "",
    out: Path = Path("docs/images/environments"),
    policy: str | None = None,
    physics: Literal["bullet", "kinematic"] = "kinematic",
    seed: int | None = None,
    every: float | None = None,
    arguments: str = "{}",
    picture: Path | None = None,
) -> None:
    """Record one episode of each registered environment as an animation.

    Args:
        only: Record only environment ids that contain this text.
        out: Output folder, of films 720 pixels wide; or, for a single id, a .gif or .webp file, 960 pixels wide.
        policy: Policy, such as "pursuit" or "learned:pretrained/foresight"; default: the reference of evaluations.
        physics: Simulator.
        seed: Seed of world, start and noise.
        every: Simulated time between frames [s]; default: about 48 frames.
        arguments: Environment arguments, YAML: "{world: rooms, slam: graph}".
        picture: Also save the frame in the middle to this file.
    """
    ids = [id for id in gymnasium.registry if id.startswith("lidarnaut/") and only in id]
    for id in sorted(ids, key=lambda id: bool(gymnasium.spec(id).kwargs)):  # default configurations first
        options = ({"world": WORLDS[id]} if id in WORLDS else {}) | yaml.safe_load(arguments)
        env = gymnasium.make(id, physics=physics, render_mode="rgb_array", disable_env_checker=True, **options)
        start = SEEDS.get(id, 0) if seed is None else seed
        env.reset(seed=start)
        frames = record(env, every)
        driver = policy or next(name for name in REFERENCES if name in policies_for(env))
        run_episode(env, make_policy(driver, env), start)
        last: Any = lidar_env_of(env).render()
        frames.append(last)
        env.close()
        path = out if out.suffix else out / f"{id.partition('/')[2].lower()}.webp"
        path.parent.mkdir(parents=True, exist_ok=True)
        save_film(frames, path, 960 if out.suffix else 720)
        if picture is not None:
            Image.fromarray(frames[len(frames) // 2]).save(picture, optimize=True)
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    run_command(main)
