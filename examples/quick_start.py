"""Run the pretrained explorer in a house for one simulated minute, in a window or, without a display, as a film."""

import os
import sys
from pathlib import Path

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy
from lidarnaut.baselines.episode import Info, run_episode
from lidarnaut.benchmarks.films import save_film


def has_display() -> bool:
    """Return True if a window can be opened."""
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def main(seconds: float = 60.0, film: Path | None = None, seed: int = 0) -> float:
    """Explore a house that is not in the training set, and return the explored fraction.

    Args:
        seconds: Simulated time [s].
        film: File of a film instead of a window; without a display runs/quick_start.gif.
        seed: Seed of start and noise.
    """
    if film is None and not has_display():
        film = Path("runs/quick_start.gif")
    render_mode = "human" if film is None else "rgb_array"
    env = gymnasium.make("lidarnaut/ExploreHouse-v0", physics="kinematic", time_limit=seconds, render_mode=render_mode)
    frames: list[np.ndarray] = []

    def save_frame(info: Info) -> None:
        if film is not None and info["time"] >= len(frames):
            frames.append(env.render())

    explorer = make_policy("pretrained/frontiers")
    episode = run_episode(env, explorer, seed, save_frame)
    env.close()
    if film is not None:
        film.parent.mkdir(parents=True, exist_ok=True)
        save_film(frames, film)
        print(f"film: {film}")
    print(
        f"explored {100 * episode.explored_fraction:.0f} % in {episode.duration:.0f} s, {episode.path_length:.0f} m; "
        f"position error {100 * episode.position_rmse:.1f} cm (RMSE), {episode.collisions:.0f} collisions"
    )
    return episode.explored_fraction


if __name__ == "__main__":
    tyro.cli(main)
