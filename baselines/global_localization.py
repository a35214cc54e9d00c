"""Map, localize globally, navigate: `python -m lidarnaut.baselines.global_localization --world turtlebot3_world`.

Experiment of Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022): a robot maps an unknown world, localizes
globally on this map by a particle filter, and drives to goals.
"""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lidarnaut.baselines import EXPLORERS, Explorer
from lidarnaut.baselines.episode import Episode, Info, begin_episode, decide_with, run, run_episode
from lidarnaut.envs.command_line import Count, make_console, run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.files import resolve
from lidarnaut.envs.navigation import GoalNavigator, GoalParams, crop_to_known
from lidarnaut.envs.rendering import Renderer
from lidarnaut.envs.slam import DEFAULT_SLAM
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.goals import draw_goal
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import save_map

FRAME_TIMES = {True: 0.1, False: 1.0}
"""Simulated time between animation frames [s], for a lost (True) or localized (False) robot."""
FRAME_MS = {True: 400, False: 80}
"""Display time of an animation frame [ms], for a lost (True) or localized (False) robot."""
TIME_PER_GOAL = 600.0
"""Simulated time allowed per goal [s], at most half of it for localization."""
MAX_FRAMES = 240


class Animation:
    """Recorder of an animated GIF of a drive."""

    def __init__(self) -> None:
        self._renderer, self._next = Renderer("rgb_array", fps=10.0), 0.0
        self._frames: list[tuple[Image.Image, int]] = []

    def take(self, env: LidarEnv) -> None:
        scene = env.scene()
        if scene.time < self._next:
            return
        self._next = scene.time + FRAME_TIMES[scene.belief.is_lost] - 1e-6
        picture = Image.fromarray(np.asarray(self._renderer.draw(scene)))
        self._frames.append((picture, FRAME_MS[scene.belief.is_lost]))

    def save(self, path: Path) -> None:
        kept = self._frames[:: -(-len(self._frames) // MAX_FRAMES)]
        first, *others = (frame.quantize(64, dither=Image.Dither.NONE) for frame, _ in kept)
        durations = [*(duration for _, duration in kept[:-1]), 2000]
        first.save(path, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
        pictures = [frame for frame, _ in self._frames]
        localized = next((frame for frame, duration in self._frames if duration == FRAME_MS[False]), pictures[-1])
        strip = Image.fromarray(np.hstack([np.asarray(picture) for picture in (pictures[0], localized, pictures[-1])]))
        half = strip.resize((strip.width // 2, strip.height // 2), Image.Resampling.LANCZOS)
        small = half.quantize(96, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        small.save(path.with_suffix(".png"), optimize=True)


def map_world(out: Path, seed: int, explorer: Explorer, **arguments: Any) -> tuple[LidarEnv, Episode]:
    """Explore a world from its first spawn pose, and save the map as `out`/map.yaml.

    `arguments`: of the environment, such as `world`. Returns the closed environment and the episode.
    """
    env = LidarEnv(Explore, start="spawn", **arguments)
    episode = run_episode(env, explorer, seed)
    save_map(crop_to_known(env.belief.grid, margin=5), out / "map.yaml")
    env.close()
    return env, episode


def localize_and_drive(
    mapped: LidarEnv, map: Path, seed: int, goals: int, watch: Callable[[LidarEnv], None], **arguments: Any
) -> tuple[Info | None, list[Info]]:
    """Start at an unknown pose on the map of the explored world `mapped`, localize globally, and drive to random goals.

    `watch`: called with the environment at the start and after every step. `arguments`: of the environment. Returns
    `info` at the first step with a localized robot, or None, and at the end of each drive; stops if the robot is lost.
    """
    known: Any = {"map": map, "map_pose": mapped.map_pose, "initial_pose": "unknown", "amcl": "slam_map"}
    arguments = {"heading_tolerance": math.pi, **arguments}
    env = LidarEnv(Navigate, time_limit=TIME_PER_GOAL * goals, **known, **arguments)
    driver, localized, ends = GoalNavigator(GoalParams(lost_time=0.5 * TIME_PER_GOAL)), None, list[Info]()
    observation, info = begin_episode(env, driver, seed + 1, np.random.default_rng([seed, 1]))
    decide, rng = decide_with(driver, env), np.random.default_rng([seed, 2])

    def note(info: Info) -> None:
        nonlocal localized
        watch(env)
        localized = localized or (None if info["is_lost"] else info)

    while len(ends) < goals and not (ends and ends[-1]["end_reason"] == "lost"):
        if ends:
            here = env.map_pose.compose(env.belief.pose)
            env.set_goal(env.map_pose.between(draw_goal(env.task.area, here, rng)))
        observation, info, _ = run(env, decide, observation, info, note)
        ends.append(info)
    env.close()
    return localized, ends


def main(
    world: str = "turtlebot3_world",
    out: Path = Path("runs/global_localization"),
    seed: int = 0,
    goals: Count = 3,
    robot: str | None = None,
    physics: str = "bullet",
    explorer: str = "nearest",
    slam: str = DEFAULT_SLAM,
) -> None:
    """Explore a world, save its map, localize globally on the map, and drive to goals.

    Args:
        world: Library world, or path of a world file.
        out: Folder for map.yaml, map.pgm, global_localization.gif and global_localization.png.
        seed: Random seed.
        goals: Number of goals.
        robot: Library robot; default is the robot of the world.
        physics: bullet or kinematic.
        explorer: Explorer of the unknown world.
        slam: SLAM of the exploration, also with parameters, for example hector?preset=faithful.
    """
    out.mkdir(parents=True, exist_ok=True)
    place: Any = {"world": world, "robot": robot, "physics": physics}
    mapped, episode = map_world(out, seed, resolve(explorer, EXPLORERS, "explorer")(), slam=slam, **place)
    say = partial(make_console().print, highlight=False, markup=False)
    say(f"explored    {100 * episode.explored_fraction:.1f} % of {world}; map in {out / 'map.yaml'}")
    animation = Animation()
    localized, ends = localize_and_drive(mapped, out / "map.yaml", seed, goals, animation.take, **place)
    if localized is None:
        say("localized   never")
    else:
        error_cm = 100 * localized["pose_error"][0]
        say(f"localized   after {localized['time']:.1f} s, {error_cm:.0f} cm from the true position")
    for k, info in enumerate(ends, start=1):
        say(f"goal {k}      {info['end_reason']}")
    animation.save(out / "global_localization.gif")
    say(f"collisions  {ends[-1]['collisions']}")
    say(f"animation   {out / 'global_localization.gif'}")


if __name__ == "__main__":
    run_command(main)
