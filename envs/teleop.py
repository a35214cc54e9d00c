"""Drive a robot and map a world, or use a known map: `python -m lidarnaut.envs.teleop --world turtlebot3_house`."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pygame
import tyro

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.rendering.renderer import Renderer
from lidarnaut.envs.rendering.scene import people_in
from lidarnaut.envs.slam import DEFAULT_SLAM, MatcherTrace
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.worlds.map_files import map_paths

HELP = "arrows or WASD: drive, space: stop, R: restart, M: save the map, C: tested poses, L: localize globally, Q: quit"
TURN_RATE = 1.0
"""Maximum yaw rate of keyboard commands [rad/s]."""
_SIGNS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
DIRECTIONS = dict(zip((pygame.K_UP, pygame.K_LEFT, pygame.K_DOWN, pygame.K_RIGHT, *map(ord, "wasd")), 2 * _SIGNS))
"""Signs of forward speed and yaw rate for each key."""


class Teleop:
    """Window that drives a robot while keys are held."""

    def __init__(self, env: LidarEnv, save_path: Path, seed: int | None = None) -> None:
        """Open the window and start an episode; RuntimeError without a display."""
        self._env, self._save_path, self._held = env, save_path, set[int]()
        self.renderer = Renderer("human", 1.0 / env.control_period)
        env.reset(seed=seed)
        self._message = env.world.notes if env.world.map is not None else ""
        self._show()

    def tick(self) -> bool:
        """Process keys, drive one control period and draw; return False to quit."""
        for event in pygame.event.get():
            if event.type in (pygame.QUIT, pygame.WINDOWCLOSE) or getattr(event, "key", None) == pygame.K_q:
                return False
            if event.type == pygame.KEYDOWN:
                self._press(event.key)
            elif event.type == pygame.KEYUP:
                self._held.discard(event.key)
        robot = self._env.robot_params
        signs = np.sign(np.sum([DIRECTIONS[key] for key in self._held] or [(0.0, 0.0)], axis=0))
        self._env.step(np.clip(signs * (1.0, TURN_RATE / robot.max_w), -1.0, 1.0).astype(np.float32))
        self._show()
        return True

    def _press(self, key: int) -> None:
        env, estimator = self._env, self._env.robots[0].estimator
        if key in DIRECTIONS:
            self._held.add(key)
        elif key == pygame.K_SPACE:
            self._held.clear()
        elif key == pygame.K_r:
            env.reset()
        elif key == pygame.K_m:
            try:
                self._message = f"saved {save_map(env.belief.grid, self._save_path).resolve()}"
            except OSError as error:
                self._message = f"not saved: {error}"
        elif key == pygame.K_c and estimator.observers is not None:
            estimator.observers = () if estimator.observers else (MatcherTrace(),)
        elif key == pygame.K_l and isinstance(env.task, Navigate):
            env.set_initial_pose("unknown")

    def _show(self) -> None:
        scene = self._env.scene()
        scene.tracks = people_in(self._env.belief.people, self._env.belief.pose)
        if scene.goal is not None:  # of `Navigate`, which draws one
            scene.goal, scene.progress = None, 0.0
        self.renderer.draw(scene, f"{self._message}    {HELP}".strip())


def main(
    world: str = "turtlebot3_world",
    robot: str | None = None,
    physics: str = "bullet",
    slam: str | None = None,
    people: str = "0",
    seed: int | None = None,
    map: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None,
    map_pose: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y THETA")] = None,
    save: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("map.yaml"),
) -> None:
    """Drive a robot by keyboard through an unknown world while it builds a map, or on a known map.

    Args:
        world: library world, procedural family, or path of a world YAML or map_server YAML.
        robot: library robot or path of a robot YAML; default is the robot of the world.
        physics: bullet or kinematic.
        slam: hector, tinyslam, gmapping, graph, odometry or truth, also with parameters such as
            `hector?preset=faithful`, or `module:attribute` of a custom SLAM.
        people: number of people, or a crowd such as `dense` or `20?attentive=0.5`.
        seed: seed of world and noise.
        map: known map, as saved by M: NAME.yaml of map_server. AMCL localizes on it.
        map_pose: world pose of the frame of the known map [m, m, rad]; default: the spawn, where saved maps begin.
        save: file for maps saved by M, for map_server: NAME.yaml, with NAME.pgm.
    """
    map_paths(save)
    if not save.resolve().parent.is_dir():
        raise FileNotFoundError(f"folder {save.resolve().parent} for maps does not exist")
    if (map_pose if map is None else slam) is not None:
        raise ValueError("--map localizes on a known map, and excludes --slam; --map-pose needs --map")
    task: Any = Navigate if map else Explore
    given = {"map": map, "map_pose": map_pose or "spawn", "amcl": "slam_map"} if map else {"slam": slam or DEFAULT_SLAM}
    place: dict[str, Any] = {"world": world, "robot": robot, "physics": physics, "start": "spawn", "people": people}
    env = LidarEnv(task, time_limit=math.inf, **place, **given)
    teleop = Teleop(env, save, seed)
    while teleop.tick():
        pass
    teleop.renderer.close()
    env.close()


cli = partial(run_command, main)

if __name__ == "__main__":
    cli()
