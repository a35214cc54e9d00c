"""Record animations of environments for the documentation: `python -m lidarnaut.benchmarks.films`."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import yaml
from PIL import Image

from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import run_episode
from lidarnaut.benchmarks.arena.episodes import REFERENCES
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import resolve
from lidarnaut.envs.geometry.lines import lengths_along

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


class Film:
    """Records frames of an episode at equal intervals of simulated time."""

    def __init__(self, env: gymnasium.Env, every: float | None = None) -> None:
        """Attach to an environment with `render_mode="rgb_array"`; `every` is the simulated time between frames [s]."""
        self._env: Any = lidar_env_of(env)
        self._interval, self._most = (self._env.control_period, NUM_FRAMES) if every is None else (every, math.inf)
        self.frames: list[np.ndarray] = []
        self._plans: list[float] = []
        self._env.on_period = self.shoot

    def shoot(self, _: Any) -> None:
        """Record a frame if due; at the maximum number, drop every second frame and double the interval."""
        if self._env.time < len(self.frames) * self._interval - 1e-6:
            return
        if len(self.frames) == self._most:
            del self.frames[1::2], self._plans[1::2]
            self._interval *= 2.0
        self.finish()

    def finish(self) -> None:
        self.frames.append(self._env.render())
        plan = self._env.overlay.plan
        self._plans.append(0.0 if plan is None else float(lengths_along(plan)[-1]))

    @property
    def hero(self) -> np.ndarray:
        """Still image: the frame with the longest planned path in the middle third of the episode."""
        third = len(self.frames) // 3
        return max(zip(self._plans[third:], self.frames[third : len(self.frames) - third]), key=lambda both: both[0])[1]


def save_film(frames: Sequence[np.ndarray], path: Path, width: int = 960) -> None:
    """Save RGB frames, shape (height, width, 3), uint8, as a looping GIF or WebP of `width` pixels."""
    size = width, round(frames[0].shape[0] * width / frames[0].shape[1])
    first, *rest = [Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in frames]
    if path.suffix == ".gif":
        palette = _palette([*frames[:: max(1, len(frames) // 8)], frames[-1]])
        first, *rest = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in (first, *rest)]
    more = {"quality": QUALITY, "method": 4} if path.suffix == ".webp" else {"optimize": False}
    durations = [FRAME_MS] * len(rest) + [HOLD_MS]
    first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, **more)


def _palette(frames: Sequence[np.ndarray]) -> Image.Image:
    packed = np.concatenate([frame.reshape(-1, 3) @ np.array([1 << 16, 1 << 8, 1]) for frame in frames])
    values, counts = np.unique(packed, return_counts=True)
    values = values[np.argsort(-counts, kind="stable")]
    firsts = np.sort(np.unique(values & 0xF8F8F8, return_index=True)[1])[:256]
    colours = values[firsts, None] >> np.array([16, 8, 0]) & 255
    image = Image.new("P", (1, 1))
    image.putpalette(colours.astype(np.uint8).tobytes())
    return image


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
        out: Output folder; or, for a single id, a .gif or .webp file.
        policy: Classic policy; default: the reference policy of evaluations.
        physics: Simulator.
        seed: Seed of world, start and noise.
        every: Simulated time between frames [s]; default: about 48 frames.
        arguments: Environment arguments, YAML: "{world: rooms, slam: graph}".
        picture: Also save a still image to this file.
    """
    ids = [id for id in gymnasium.registry if id.startswith("lidarnaut/") and only in id]
    for id in sorted(ids, key=lambda id: bool(gymnasium.spec(id).kwargs)):  # default configurations first
        options = ({"world": WORLDS[id]} if id in WORLDS else {}) | yaml.safe_load(arguments)
        env = gymnasium.make(id, physics=physics, render_mode="rgb_array", disable_env_checker=True, **options)
        start = SEEDS.get(id, 0) if seed is None else seed
        env.reset(seed=start)
        film = Film(env, every)
        drivers = policies_for(env)
        driver = policy or next(name for name in REFERENCES if name in drivers)
        run_episode(env, resolve(driver, drivers, "policy")(), start)
        film.finish()
        env.close()
        path = out if out.suffix else out / f"{id.partition('/')[2].lower()}.webp"
        path.parent.mkdir(parents=True, exist_ok=True)
        save_film(film.frames, path, 720 if path.suffix == ".webp" else 960)
        if picture is not None:
            Image.fromarray(film.hero).save(picture, optimize=True)
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    run_command(main)
