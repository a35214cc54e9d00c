"""Animated pictures of the registered environments: `python -m benchmarks.films --out docs/images/environments`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from PIL import Image

import envs  # noqa: F401  (registers the environments)
from baselines import policies_for
from baselines.episode import run_episode
from envs.command_line import run_command
from envs.core import lidar_env_of

NUM_FRAMES = 48
"""Frames of a film, besides the last one, at most; at least half as many in episodes that last."""
WIDTH, QUALITY = 720, 50
"""Width [px] and quality of the WebP pictures, up to 100."""
FRAME_MS, HOLD_MS = 120, 2500
"""How long a frame is shown, and the last one [ms]."""
WORLDS = {
    "lidarnaut/Explore-v0": "aws_small_house",
    "lidarnaut/ExploreFrontiersAbstract-v0": "rrt_house",
    "lidarnaut/ExploreTeam-v0": "rrt_house",
    "lidarnaut/Navigate-v0": "turtlebot3_house",
}
"""Worlds of ids whose default is shown by another one."""

SEEDS = {"lidarnaut/Navigate-v0": 3}
"""Seeds of ids, others have 0: this one drives from room to room."""


class Film:
    """Takes pictures of an episode at equal intervals of simulated time, also within decisions."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._env: Any = lidar_env_of(env)
        self._interval = self._env.control_period
        self.frames: list[np.ndarray] = []
        self._env.on_period = self.shoot

    def shoot(self, _: Any) -> None:
        """Take a picture if it is time for one; the interval doubles whenever there are too many."""
        if self._env.time < len(self.frames) * self._interval - 1e-6:
            return
        if len(self.frames) == NUM_FRAMES:
            del self.frames[1::2]
            self._interval *= 2.0
        self.frames.append(self._env.render())

    def save(self, path: Path) -> None:
        """Write an endless WebP."""
        frames = [*self.frames, self._env.render()]
        height = round(frames[0].shape[0] * WIDTH / frames[0].shape[1])
        first, *rest = [Image.fromarray(f).resize((WIDTH, height), Image.Resampling.LANCZOS) for f in frames]
        durations = [FRAME_MS] * len(rest) + [HOLD_MS]
        first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, quality=QUALITY, method=4)


DRIVERS: Sequence[tuple[str, str]] = (
    ("lidarnaut/ExploreFrontiers", "nearest"),
    ("lidarnaut/ExploreTeam", "rrt_team"),
    ("lidarnaut/ExploreWarehouse", "nearest"),
    ("lidarnaut/Explore", "gain_over_cost"),
    ("lidarnaut/Navigate", "pursuit"),
    ("lidarnaut/Track", "route_follower"),
)
"""What drives, by the beginning of the id; the first that fits."""


def main(out: Path = Path("docs/images/environments"), only: str = "") -> None:
    """Film an episode of each registered environment, kinematic physics.

    Args:
        out: Folder of the pictures, one per id.
        only: Film only ids that contain this.
    """
    out.mkdir(parents=True, exist_ok=True)
    ids = [id for id in gymnasium.registry if id.startswith("lidarnaut/") and only in id]
    for id in sorted(ids, key=lambda id: bool(gymnasium.spec(id).kwargs)):  # those that set no arguments come first
        arguments: dict[str, Any] = {"world": WORLDS[id]} if id in WORLDS else {}
        env = gymnasium.make(id, physics="kinematic", render_mode="rgb_array", disable_env_checker=True, **arguments)
        driver, seed = next(driver for start, driver in DRIVERS if id.startswith(start)), SEEDS.get(id, 0)
        env.reset(seed=seed)
        film = Film(env)
        run_episode(env, policies_for(env)[driver](), seed)
        film.save(path := out / f"{id.partition('/')[2].lower()}.webp")
        env.close()
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    run_command(main)
