"""Pictures for the documentation.

`python -m benchmarks.pictures --world turtlebot3_house` films an explorer at work; with `--maps DIR` it draws the maps
of all SLAMs side by side instead.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from baselines import make_explorer
from baselines.episode import run_episode
from benchmarks.slam_maps import draw_drive, draw_log
from envs.command_line import run_command
from envs.core import LidarEnv
from envs.geometry.polyline import lengths_along
from envs.rendering import style
from envs.slam import DEFAULT_SLAM
from envs.tasks.explore import Explore

HOLD = 3.0
"""Time for which a film shows its last picture [s]."""
FPS = 10.0
DRIVE_ROBOT = "turtlebot3_waffle_pi"
"""Robot of the drive that maps are compared on, if none is given: its lidar sees 3.5 m far."""


@dataclass(slots=True)
class Film:
    """Takes a picture every now and then; pass `shoot` to `run_episode`."""

    env: LidarEnv
    """With `render_mode="rgb_array"`."""
    every: float
    """Simulated time between two pictures [s]."""
    frames: list[np.ndarray] = field(default_factory=list)
    """Shape (height, width, 3), uint8 each."""
    shown: list[tuple[bool, float]] = field(default_factory=list)
    """Whether about half of the world is explored, and the length of the planned path [m], at each picture."""
    explored: float = 0.0
    """Explored fraction at the last call of `shoot`."""

    def shoot(self, info: dict[str, Any]) -> None:
        """Take a picture if it is time for one."""
        self.explored = info["explored_fraction"]
        if info["time"] >= len(self.frames) * self.every - 1e-6:
            self.finish()

    def finish(self) -> None:
        """Take a picture in any case, such as the last one."""
        frame = self.env.render()
        assert frame is not None
        self.frames.append(frame)
        plan = 0.0 if self.env.plan is None else float(lengths_along(self.env.plan)[-1])
        self.shown.append((0.5 <= self.explored <= 0.75, plan))

    @property
    def hero(self) -> np.ndarray:
        """The picture that shows most at a glance: half of the world known, and a long path planned."""
        return self.frames[self.shown.index(max(self.shown))]


def _palette() -> Image.Image:
    """Return an image whose palette serves all pictures: their colours, and mixtures of lines with what they cross.

    A palette made from the pictures would give large even areas a slightly different colour.
    """
    lines = (style.TRUE, style.ESTIMATED, style.PLAN, style.FRONTIER, style.INK)
    seen = _mixture(style.LIDAR, style.FLOOR, style.SEEN_ALPHA / 255)
    beam = _mixture(style.LIDAR, style.FLOOR, style.BEAM_ALPHA / 255)
    colours = [style.PAPER, style.MUTED, style.RULE, style.SOLID, style.WALL, style.OCCUPIED, style.MOVER, style.LIDAR]
    colours += [beam, *lines, style.UNKNOWN, style.OUTSIDE, seen]
    for ground in (style.FLOOR, style.UNKNOWN, style.OUTSIDE, seen):
        colours += [_mixture(line, ground, share) for line in lines for share in (1 / 3, 2 / 3)]
    colours += [_mixture(style.FREE, (0, 0, 0), share) for share in np.linspace(0, 1, 8)]
    image = Image.new("P", (1, 1))
    image.putpalette(np.array(colours, dtype=np.uint8).tobytes())
    return image


def _mixture(a: style.Colour, b: style.Colour, share: float) -> style.Colour:
    """Return `share` of colour `a` in colour `b`."""
    red, green, blue = (round(share * x + (1 - share) * y) for x, y in zip(a, b))
    return red, green, blue


def save_gif(frames: Sequence[np.ndarray], path: Path, width: int = 960, palette: Image.Image | None = None) -> None:
    """Save frames, shape (height, width, 3), uint8 each, as an endless GIF of a width [px].

    None for the palette takes that of the pictures of `envs.rendering`.
    """
    size = width, round(frames[0].shape[0] * width / frames[0].shape[1])
    palette = palette or _palette()
    first, *rest = [
        Image.fromarray(frame)
        .resize(size, Image.Resampling.LANCZOS)
        .quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    durations = [round(1000 / FPS)] * len(rest) + [round(1000 * HOLD)]
    first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, optimize=False)


def draw_maps(folder: Path, world: str, robot: str, seed: int, minutes: float = 20.0) -> None:
    """Draw the maps of all SLAMs side by side, of a drive and of the Intel log; see `main`."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_drive(drawn := folder / "slam_maps.png", world, robot, seed, minutes)
    print(f"{drawn}: {drawn.stat().st_size / 1e3:.0f} kB")
    if "LIDARNAUT_DATA" not in os.environ:
        print("the Intel log is left out; set LIDARNAUT_DATA")
        return
    data = Path(os.environ["LIDARNAUT_DATA"]) / "intel"
    draw_log(drawn := folder / "slam_maps_intel.png", data / "scans_2725.npz", data / "intel.relations", seed)
    print(f"{drawn}: {drawn.stat().st_size / 1e3:.0f} kB")


def main(
    world: str = "turtlebot3_house",
    explorer: str = "frontier",
    slam: str = DEFAULT_SLAM,
    robot: str | None = None,
    physics: Literal["bullet", "kinematic"] = "bullet",
    seed: int = 0,
    every: float = 4.0,
    film: Path = Path("docs/images/exploring.gif"),
    picture: Path = Path("docs/images/hero.png"),
    maps: Path | None = None,
) -> None:
    """Explore a world; save a film of it and one picture.

    Args:
        world: Library world, procedural family, or path of a world YAML or map_server YAML.
        explorer: One of the classic explorers.
        slam: SLAM by name; with "graph", the film shows how loops are closed.
        robot: Library robot, or path of a robot YAML; the world's usual one if not given.
        physics: Simulator.
        seed: Seed of world, start and noise.
        every: Simulated time between two pictures of the film [s].
        film: Where the film goes.
        picture: Where the picture goes.
        maps: Folder that gets `slam_maps.png` instead, the maps of all SLAMs on a drive of 20 minutes in `world`
            with `robot`, and `slam_maps_intel.png`, those of the Intel log if it lies in `$LIDARNAUT_DATA/intel`.
    """
    if maps is not None:
        draw_maps(maps, world, robot or DRIVE_ROBOT, seed)
        return
    env = LidarEnv(
        Explore, world=world, start="spawn", slam=slam, robot=robot, physics=physics, render_mode="rgb_array"
    )
    taken = Film(env, every)
    episode = run_episode(env, make_explorer(explorer), seed, taken.shoot)
    taken.finish()
    env.close()
    for path in (film, picture):
        path.parent.mkdir(parents=True, exist_ok=True)
    save_gif(taken.frames, film)
    Image.fromarray(taken.hero).save(picture, optimize=True)
    print(f"{world}: {100 * episode.explored_fraction:.1f} % explored in {episode.duration:.0f} s")
    for path in (film, picture):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    run_command(main)
