"""Mapping, global localization and navigation: `python -m baselines.global_localization --world turtlebot3_world`.

The whole experiment of Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022), in one command. A robot explores an
unknown world and saves the map as PGM and YAML. Then it starts at an unknown pose on that map. It drives by the scan
alone until the particle filter has converged, and then from goal to goal. A GIF shows the particles converging and the
path driven.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pygame
from PIL import Image
from rich.console import Console

from baselines import make_explorer
from baselines.episode import Info, begin_episode, decide_with, run, run_episode
from envs.command_line import run_command
from envs.core import LidarEnv
from envs.localization import load_preset
from envs.navigation import GoalNavigator, GoalParams, crop_to_known
from envs.rendering.picture import Picture
from envs.tasks.explore import Explore
from envs.tasks.goals import draw_goal
from envs.tasks.navigate import Navigate
from envs.worlds import save_map

AMCL = replace(load_preset("default"), lost_fit=0.7)
"""AMCL for a map that a SLAM made: such maps are off by centimetres, and explain a little less of a scan."""
PICTURE_SIZE = (1280, 720)
"""Width and height of the GIF [px]."""
FRAME_TIMES = {True: 0.1, False: 1.0}
"""Simulated time between two frames while the robot is lost, and while it is localized [s]."""
FRAME_MS = {True: 400, False: 80}
"""How long a frame of either kind is shown [ms]."""
TIME_PER_GOAL = 600.0
"""Simulated time for a goal at most, on average; half of it to localize [s]."""
MAX_FRAMES = 240
"""Frames of the GIF at most; of a longer drive every second or third one is left out."""


class Outcome(NamedTuple):
    """Measures of mapping, localization and navigation."""

    explored_fraction: float
    map_path: Path
    time_to_localize: float
    """Time from the start on the map until the localizer no longer reported that it is lost [s]; inf if never."""
    error_when_localized: float
    """Distance between estimated and true position at that time [m]; NaN if never."""
    goals: tuple[str, ...]
    """How the drive to each goal ended: "reached", or why not."""
    collisions: int
    """Contacts while navigating."""
    gif_path: Path


class Animation:
    """Collects pictures of a drive."""

    def __init__(self) -> None:
        self._picture = Picture(PICTURE_SIZE)
        self._frames: list[Image.Image] = []
        self._durations: list[int] = []
        self._next = 0.0

    def take(self, env: LidarEnv) -> None:
        """Take a picture if it is time for one."""
        scene = env.scene()
        if scene.time < self._next:
            return
        self._next = scene.time + FRAME_TIMES[scene.belief.is_lost] - 1e-6
        pixels = pygame.image.tobytes(self._picture.paint(scene), "RGB")
        self._frames.append(Image.frombytes("RGB", PICTURE_SIZE, pixels))
        self._durations.append(FRAME_MS[scene.belief.is_lost])

    def save(self, path: Path) -> Path:
        """Write the GIF, with its last picture shown for two seconds, and three of its pictures side by side as PNG.

        These are the first one, the first one after the robot was localized, and the last one.
        """
        kept = slice(None, None, -(-len(self._frames) // MAX_FRAMES))
        small = [frame.quantize(64, dither=Image.Dither.NONE) for frame in self._frames[kept]]
        durations = [*self._durations[kept][:-1], 2000]
        small[0].save(path, save_all=True, append_images=small[1:], duration=durations, loop=0, optimize=True)
        found = self._durations.index(FRAME_MS[False]) if FRAME_MS[False] in self._durations else -1
        width, height = PICTURE_SIZE
        strip = Image.new("RGB", (3 * width, height))
        for k, index in enumerate((0, found, -1)):
            strip.paste(self._frames[index], (k * width, 0))
        strip.resize((3 * width // 2, height // 2), Image.Resampling.LANCZOS).save(path.with_suffix(".png"))
        return path


def main(
    world: str = "turtlebot3_world",
    out: Path = Path("runs/global_localization"),
    seed: int = 0,
    goals: int = 3,
    robot: str | None = None,
    physics: str = "bullet",
) -> Outcome:
    """Explore a world, save its map, start at an unknown pose on it, localize, and drive to goals.

    Args:
        world: Library world, or path of a world file.
        out: Folder for map.yaml, map.pgm, global_localization.gif and three of its frames, global_localization.png.
        seed: Of everything random.
        goals: Goals to drive to.
        robot: Library robot; by default the world's usual one.
        physics: bullet or kinematic.
    """
    console = Console(highlight=False, markup=False)
    out.mkdir(parents=True, exist_ok=True)
    exploration = LidarEnv(Explore, world=world, robot=robot, physics=physics, start="spawn")
    explored = run_episode(exploration, make_explorer("nearest"), seed).explored_fraction
    map_path = save_map(crop_to_known(exploration.belief.grid, margin=5), out / "map.yaml")
    exploration.close()
    console.print(f"explored    {100 * explored:.1f} % of {world}; map in {map_path}")
    env = LidarEnv(
        Navigate,
        world=world,
        robot=robot,
        physics=physics,
        map=map_path,
        map_pose=exploration.map_pose,
        initial_pose="unknown",
        amcl=AMCL,
        time_limit=TIME_PER_GOAL * max(goals, 1),
    )
    driver = GoalNavigator(GoalParams(lost_time=0.5 * TIME_PER_GOAL))
    observation, info = begin_episode(env, driver, seed + 1, np.random.default_rng([seed, 1]))
    decide, rng = decide_with(driver, env), np.random.default_rng([seed, 2])
    animation, outcomes, localized = Animation(), list[str](), (np.inf, np.nan)

    def watch(info: Info) -> None:
        nonlocal localized
        animation.take(env)
        if not info["is_lost"] and np.isinf(localized[0]):
            localized = info["time"], float(info["pose_error"][0])
            console.print(f"localized   after {localized[0]:.1f} s, {100 * localized[1]:.0f} cm from the true position")

    watch(info)
    for k in range(goals):
        if k:
            here = env.map_pose.compose(env.belief.pose)
            env.set_goal(env.map_pose.between(draw_goal(env.task.area, here, rng)))
        observation, info, _ = run(env, decide, observation, info, watch)
        outcomes.append(info["end_reason"])
        console.print(f"goal {k + 1}      {outcomes[-1]}")
        if outcomes[-1] == "lost":
            break
    gif = animation.save(out / "global_localization.gif")
    env.close()
    console.print(f"collisions  {info['collisions']:.0f}\nanimation   {gif}")
    return Outcome(explored, map_path, *localized, tuple(outcomes), int(info["collisions"]), gif)


if __name__ == "__main__":
    run_command(main)
