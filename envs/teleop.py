"""Drive a robot and map a world, or use a known map: `python -m lidarnaut.envs.teleop --world turtlebot3_house`."""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pygame
import tyro

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import GoalNavigator, GoalParams
from lidarnaut.envs.rendering.picture import GAP, Picture, Typesetter
from lidarnaut.envs.rendering.renderer import SIZE, open_window
from lidarnaut.envs.rendering.scene import people_in
from lidarnaut.envs.rendering.style import ESTIMATED, FRONTIER, PAPER
from lidarnaut.envs.slam import DEFAULT_SLAM, MatcherTrace
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.worlds.map_files import map_paths

HELP = "arrows or WASD: drive     space: stop     R: restart     M: save the map     Q: quit     "
SLAM_HELP = "C: tested poses"
MAP_HELP = "P, then drag on the map: pose estimate     G, then drag: goal     L: localize globally"
TOOLS = {pygame.K_p: ESTIMATED, pygame.K_g: FRONTIER}
"""Arrow colors of the tools for pose estimates and goals, by RViz's keys of 2D Pose Estimate and 2D Goal Pose."""
GOAL_PARAMS = GoalParams(local_planner="dwb", track_people=True)
TURN_RATE = 1.0
"""Maximum yaw rate of keyboard commands [rad/s]."""
HELP_HEIGHT = 52
_SIGNS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
_ARROWS, _LETTERS = (pygame.K_UP, pygame.K_LEFT, pygame.K_DOWN, pygame.K_RIGHT), map(ord, "wasd")
DIRECTIONS = {**dict(zip(_ARROWS, _SIGNS)), **dict(zip(_LETTERS, _SIGNS))}
"""Signs of forward speed and yaw rate for each key."""


class Teleop:
    """Window that drives a robot while keys are held, and to goals on a known map."""

    def __init__(self, env: LidarEnv, save_path: Path, seed: int | None = None) -> None:
        """Open the window and start an episode of an environment.

        `env`: with the task `Navigate`, the mouse gives pose estimates and goals. `save_path`: path of saved maps.
        Raises RuntimeError without a display.
        """
        self._env, self._save_path = env, save_path
        self._has_map, self._navigator = isinstance(env.task, Navigate), GoalNavigator(GOAL_PARAMS)
        self._held: set[int] = set()
        self._tool: int | None = None
        self._drag: tuple[tuple[int, int], tuple[int, int]] | None = None
        self._window = open_window("lidarnaut", (SIZE[0], SIZE[1] + HELP_HEIGHT))
        self._picture, self._text = Picture(SIZE), Typesetter()
        env.reset(seed=seed)
        self._message = env.world.notes if env.world.map is not None else ""
        self._show()

    def tick(self) -> bool:
        """Process keys and mouse, drive one control period and draw; return False to quit."""
        for event in pygame.event.get():
            if event.type in (pygame.QUIT, pygame.WINDOWCLOSE):
                return False
            if event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._held.clear()
            elif event.type == pygame.KEYDOWN and not self._press(event.key):
                return False
            elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self._tool is not None:
                self._drag = event.pos, event.pos
            elif event.type in (pygame.MOUSEMOTION, pygame.MOUSEBUTTONUP) and self._drag is not None:
                self._drag = self._drag[0], event.pos
                if event.type == pygame.MOUSEBUTTONUP and event.button == 1:
                    self._release(*self._drag)
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
            self._navigator.goal = None
        elif key == pygame.K_r:
            self._env.reset()
            self._navigator.goal, self._message = None, "restarted"
        elif key == pygame.K_m:
            try:
                self._message = f"saved {save_map(self._env.belief.grid, self._save_path).resolve()}"
            except OSError as error:
                self._message = f"not saved: {error}"
        elif key == pygame.K_c:
            slam: Any = self._env.robots[0].estimator
            if slam.observers is not None:
                slam.observers = () if slam.observers else (MatcherTrace(),)
            else:
                self._message = f"{type(slam).__name__} does not report tested poses"
        elif self._has_map and key in TOOLS:
            self._tool, self._message = key, "drag on the map"
        elif self._has_map and key == pygame.K_l:
            self._env.set_initial_pose("unknown")
        return key != pygame.K_q

    def _release(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        env, tool, self._tool, self._drag = self._env, self._tool, None, None
        x, y = self._picture.point_at(env.world, start)
        pose = env.map_pose.between(Pose2D(x, y, math.atan2(start[1] - end[1], end[0] - start[0])))
        pose = Pose2D(round(pose.x, 2), round(pose.y, 2), round(pose.theta, 2))
        self._message = f"x {pose.x} m, y {pose.y} m, {math.degrees(pose.theta):.0f} degrees"
        try:
            if tool == pygame.K_p:
                env.set_initial_pose(pose)
                return
            env.set_goal(pose)
            self._navigator.reset(env.robot_params, env.control_period, env.np_random.spawn(1)[0])
            self._navigator.set_goal(pose[:2], pose.theta)
        except ValueError as error:
            self._message = str(error)

    def _action(self) -> np.ndarray:
        env, navigator, twist = self._env, self._navigator, np.zeros(2)
        limits = np.array([env.robot_params.max_v, env.robot_params.max_w])
        if self._held:
            navigator.goal = None
            twist = np.sign(np.sum([DIRECTIONS[key] for key in self._held], axis=0)) * (limits[0], TURN_RATE)
        elif navigator.is_driving:
            twist = np.array(navigator.act(env.reading, env.belief))
            self._message = navigator.end_reason or self._message
        env.overlay.plan = navigator.plan
        return np.clip(twist / limits, -1.0, 1.0).astype(np.float32)

    def _show(self) -> None:
        env, (width, height), surface = self._env, SIZE, self._window.get_surface()
        env.overlay.tracks = people_in(env.belief.people, env.belief.pose)
        scene = env.scene()
        if self._has_map and self._navigator.goal is None:
            scene.goal, scene.progress = None, 0.0
        surface.fill(PAPER)
        surface.blit(self._picture.paint(scene), (0, 0))
        if self._drag is not None and self._tool is not None:
            back, end = (pygame.Vector2(self._drag[0]) - self._drag[1]).clamp_magnitude(16), self._drag[1]
            pygame.draw.line(surface, TOOLS[self._tool], *self._drag, 4)
            pygame.draw.polygon(surface, TOOLS[self._tool], [end, end + back.rotate(25), end + back.rotate(-25)])
        self._text.write(surface, HELP + (MAP_HELP if self._has_map else SLAM_HELP), midleft=(GAP, height + 8))
        self._text.write(surface, self._message, midright=(width - GAP, height + 30))
        self._window.flip()


def main(
    world: str = "turtlebot3_world",
    robot: str | None = None,
    physics: str = "bullet",
    slam: str | None = None,
    people: str = "0",
    control_hz: float = 10.0,
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
        control_hz: steps per second.
        seed: seed of world and noise.
        map: known map, as saved by M: NAME.yaml of map_server. AMCL localizes on it; mouse drags give pose and goals.
        map_pose: world pose of the frame of the known map [m, m, rad]; default: the spawn, where saved maps begin.
        save: file for maps saved by M, for map_server: NAME.yaml, with NAME.pgm.
    """
    shared: dict[str, Any] = {"world": world, "robot": robot, "physics": physics, "start": "spawn", "people": people}
    shared |= {"control_hz": control_hz, "time_limit": math.inf}
    if (map_pose if map is None else slam) is not None:
        slam_rule = "--map localizes on a known map and excludes --slam, which builds a map"
        raise ValueError(f"{slam_rule}; --map-pose needs --map")
    if map is None:
        env = LidarEnv(Explore, slam=slam or DEFAULT_SLAM, **shared)
    else:
        env = LidarEnv(Navigate, map=map, map_pose=map_pose or "spawn", amcl="slam_map", **shared)
    map_paths(save)
    if not save.resolve().parent.is_dir():
        raise FileNotFoundError(f"folder {save.resolve().parent} for maps does not exist")
    teleop = Teleop(env, save, seed)
    clock = pygame.Clock()
    while teleop.tick():
        clock.tick(control_hz)
    teleop.close()


def cli() -> None:
    """Run `main` with command-line options."""
    run_command(main)


if __name__ == "__main__":
    cli()
