"""Drive a robot by keyboard and map a world: `python -m lidarnaut.envs.teleop --world turtlebot3_house`."""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pygame
import tyro

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.rendering.picture import GAP, Typesetter
from lidarnaut.envs.rendering.renderer import SIZE, open_window
from lidarnaut.envs.rendering.style import PAPER
from lidarnaut.envs.slam import DEFAULT_SLAM
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.worlds.map_files import map_paths

HELP = "arrows or WASD: drive     space: stop     R: restart     M: save the map     Q: quit"
TURN_RATE = 1.0
"""Maximum yaw rate of keyboard commands [rad/s]."""
HELP_HEIGHT = 32
DIRECTIONS = {
    pygame.K_UP: (1.0, 0.0),
    pygame.K_w: (1.0, 0.0),
    pygame.K_DOWN: (-1.0, 0.0),
    pygame.K_s: (-1.0, 0.0),
    pygame.K_LEFT: (0.0, 1.0),
    pygame.K_a: (0.0, 1.0),
    pygame.K_RIGHT: (0.0, -1.0),
    pygame.K_d: (0.0, -1.0),
}
"""Signs of forward speed and yaw rate for each key."""


class Teleop:
    """Window that drives a robot while keys are held."""

    def __init__(self, env: LidarEnv, map_path: Path, seed: int | None = None) -> None:
        """Open the window and start an episode of an environment with `render_mode="rgb_array"`.

        `map_path`: path of saved maps. Raises RuntimeError without a display.
        """
        self._env = env
        self._map_path = map_path
        self._held: set[int] = set()
        self._message = ""
        self._window = open_window("lidarnaut", (SIZE[0], SIZE[1] + HELP_HEIGHT))
        self._text = Typesetter()
        env.reset(seed=seed)
        if env.world.map is not None:
            self._message = env.world.notes
        self._show()

    def tick(self) -> bool:
        """Process keys, drive one control period and draw; return False to quit."""
        for event in pygame.event.get():
            if event.type in (pygame.QUIT, pygame.WINDOWCLOSE):
                return False
            if event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._held.clear()
            elif event.type == pygame.KEYDOWN and not self._press(event.key):
                return False
        self._env.step(self._action())
        self._show()
        return True

    def close(self) -> None:
        self._window.destroy()
        self._env.close()

    def _press(self, key: int) -> bool:
        if key in DIRECTIONS:
            self._held.add(key)
        elif key == pygame.K_SPACE:
            self._held.clear()
        elif key == pygame.K_r:
            self._env.reset()
            self._message = "restarted"
        elif key == pygame.K_m:
            self._save()
        return key != pygame.K_q

    def _save(self) -> None:
        try:
            self._message = f"saved {save_map(self._env.belief.grid, self._map_path).resolve()}"
        except OSError as error:
            self._message = f"not saved: {error}"

    def _action(self) -> np.ndarray:
        v, w = np.sign(np.sum([DIRECTIONS[key] for key in self._held], axis=0)) if self._held else (0.0, 0.0)
        return np.array([v, w * min(1.0, TURN_RATE / self._env.robot.max_w)], dtype=np.float32)

    def _show(self) -> None:
        frame = self._env.render()
        assert frame is not None
        height, width = frame.shape[:2]
        surface = self._window.get_surface()
        surface.fill(PAPER)
        surface.blit(pygame.image.frombuffer(frame.tobytes(), (width, height), "RGB"), (0, 0))
        self._text.write(surface, HELP, midleft=(GAP, height + HELP_HEIGHT // 2 - 4))
        self._text.write(surface, self._message, midright=(width - GAP, height + HELP_HEIGHT // 2 - 4))
        self._window.flip()


def main(
    world: str = "turtlebot3_world",
    robot: str | None = None,
    physics: str = "bullet",
    slam: str = DEFAULT_SLAM,
    people: str = "0",
    control_hz: float = 10.0,
    seed: int | None = None,
    map: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("map.yaml"),
) -> None:
    """Drive a robot by keyboard through an unknown world while it builds a map.

    Args:
        world: library world, procedural family, or path of a world YAML or map_server YAML.
        robot: library robot or path of a robot YAML; default is the robot of the world.
        physics: bullet or kinematic.
        slam: hector, tinyslam, gmapping, graph, odometry or truth, also with parameters such as
            `hector?preset=faithful`, or `module:attribute` of a custom SLAM.
        people: number of people, or a crowd such as `dense` or `20?attentive=0.5`.
        control_hz: steps per second.
        seed: seed of world and noise.
        map: file for maps saved by M, for map_server: NAME.yaml, with NAME.pgm.
    """
    place: dict[str, Any] = {"world": world, "slam": slam, "start": "spawn", "people": people, "time_limit": math.inf}
    env = LidarEnv(Explore, robot=robot, physics=physics, control_hz=control_hz, render_mode="rgb_array", **place)
    map_paths(map)
    if not map.resolve().parent.is_dir():
        raise FileNotFoundError(f"folder {map.resolve().parent} for maps does not exist")
    teleop = Teleop(env, map, seed)
    clock = pygame.Clock()
    while teleop.tick():
        clock.tick(control_hz)
    teleop.close()


def cli() -> None:
    """Run `main` with command-line options."""
    run_command(main)


if __name__ == "__main__":
    cli()
