"""Drive a robot by keyboard: `python -m lidarnaut.envs.teleop --world turtlebot3_house`.

The robot maps an unknown world, or localizes on a known map (`--map`) and drives to goals.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pygame
import tyro

from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization import load_preset
from lidarnaut.envs.navigation import GoalNavigator, GoalParams
from lidarnaut.envs.rendering.glyphs import draw_arrow
from lidarnaut.envs.rendering.picture import GAP, Picture, Typesetter
from lidarnaut.envs.rendering.renderer import SIZE, open_window
from lidarnaut.envs.rendering.scene import people_in
from lidarnaut.envs.rendering.style import ESTIMATED, FRONTIER, PAPER
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.slam import DEFAULT_SLAM, MatcherTrace
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.worlds.map_files import map_paths

HELP = "arrows or WASD: drive     space: stop     {}     R: restart     M: save the map     Q: quit"
SLAM_KEYS = "C: tested poses"
MAP_KEYS = "P, then drag on the map: pose estimate     G, then drag: goal     L: localize globally"
MIN_FIT = 0.7
"""Share of beam end points that fit a map made by SLAM, whose walls are off by centimetres; AMCL is lost below."""
GOAL_PARAMS = GoalParams(local_planner="dwb", track_people=True)
TOOLS = {pygame.K_p: ("pose estimate", ESTIMATED), pygame.K_g: ("goal", FRONTIER)}
"""Name and arrow color of the tools for dragging, by RViz's keys of 2D Pose Estimate and 2D Goal Pose."""
TURN_RATE = 1.0
"""Maximum yaw rate of keyboard commands [rad/s]."""
HELP_HEIGHT = 52
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
    """Window that drives a robot while keys are held, and to goals on a known map."""

    def __init__(self, env: LidarEnv, save_path: Path, seed: int | None = None) -> None:
        """Open the window and start an episode of an environment.

        `env`: with the task `Navigate`, goals and pose estimates are given by the mouse. `save_path`: path of saved
        maps. Raises RuntimeError without a display.
        """
        self._env, self._save_path = env, save_path
        self._navigator = GoalNavigator(GOAL_PARAMS) if isinstance(env.task, Navigate) else None
        self._trace = MatcherTrace()
        self._held: set[int] = set()
        self._tool: int | None = None
        self._drag: tuple[tuple[int, int], tuple[int, int]] | None = None
        self._message = ""
        self._window = open_window("lidarnaut", (SIZE[0], SIZE[1] + HELP_HEIGHT))
        self._picture, self._text = Picture(SIZE), Typesetter()
        self._begin(seed)
        if env.world.map is not None:
            self._message = env.world.notes
        self._show()

    def _begin(self, seed: int | None = None) -> None:
        self._env.reset(seed=seed)
        if self._navigator is not None:
            self._navigator.reset(self._env.robot, self._env.control_period, self._env.np_random.spawn(1)[0])

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
            elif event.type in (pygame.MOUSEBUTTONDOWN, pygame.MOUSEMOTION, pygame.MOUSEBUTTONUP):
                self._point(event)
        self._env.step(self._action())
        self._show()
        return True

    def close(self) -> None:
        self._window.destroy()
        self._env.close()

    def _press(self, key: int) -> bool:
        navigator = self._navigator
        if key in DIRECTIONS or key == pygame.K_SPACE:
            self._held = self._held | {key} if key in DIRECTIONS else set()
            if navigator is not None:
                navigator.goal = None
        elif key == pygame.K_r:
            self._begin()
            self._message = "restarted"
        elif key == pygame.K_m:
            self._save()
        elif key == pygame.K_c:
            self._toggle_trace()
        elif navigator is not None and key in TOOLS:
            self._tool, self._message = key, f"drag on the map: {TOOLS[key][0]}"
        elif navigator is not None and key == pygame.K_l:
            self._env.set_initial_pose(None)
            self._message = "global localization"
        return key != pygame.K_q

    def _point(self, event: pygame.Event) -> None:
        if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self._tool is not None:
            self._drag = event.pos, event.pos
        elif self._drag is not None and event.type == pygame.MOUSEMOTION:
            self._drag = self._drag[0], event.pos
        elif self._drag is not None and event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self._release(self._drag[0], event.pos)

    def _release(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        env, navigator, tool = self._env, self._navigator, self._tool
        self._tool = self._drag = None
        assert navigator is not None
        assert tool is not None
        point = self._picture.point_at(env.world, start)
        if point is None:
            self._message = "press on the map, on the right"
            return
        heading = math.atan2(start[1] - end[1], end[0] - start[0])
        pose = Pose2D(*(round(value, 2) for value in env.map_pose.between(Pose2D(*point, heading))))
        try:
            if tool == pygame.K_p:
                env.set_initial_pose(pose)
            else:
                env.set_goal(pose)
                navigator.set_goal(pose[:2], pose.theta)
            self._message = f"{TOOLS[tool][0]}: x {pose.x} m, y {pose.y} m, {math.degrees(pose.theta):.0f} degrees"
        except ValueError as error:
            self._message = str(error)

    def _save(self) -> None:
        try:
            self._message = f"saved {save_map(self._env.belief.grid, self._save_path).resolve()}"
        except OSError as error:
            self._message = f"not saved: {error}"

    def _toggle_trace(self) -> None:
        slam: Any = self._env.robots[0].estimator
        if not hasattr(slam, "observers"):
            self._message = f"{type(slam).__name__} does not report tested poses"
        elif self._trace in slam.observers:
            slam.observers = tuple(one for one in slam.observers if one is not self._trace)
        else:
            slam.observers = (*slam.observers, self._trace)

    def _action(self) -> np.ndarray:
        env, navigator, limits = self._env, self._navigator, self._env.robot
        v, w = np.sign(np.sum([DIRECTIONS[key] for key in self._held], axis=0)) if self._held else (0.0, 0.0)
        twist = Twist(v * limits.max_v, w * min(limits.max_w, TURN_RATE))
        if navigator is not None:
            was_driving, command = navigator.is_driving, navigator.act(env.reading, env.belief)
            env.plan = navigator.plan
            if was_driving:
                twist, self._message = command, navigator.end_reason or self._message
        return np.clip([twist.v / limits.max_v, twist.w / limits.max_w], -1.0, 1.0).astype(np.float32)

    def _show(self) -> None:
        env, navigator = self._env, self._navigator
        env.tracks = people_in(env.belief.people, env.belief.pose)
        scene = env.scene()
        if navigator is not None and navigator.goal is None:
            scene.goal, scene.progress = None, 0.0
        surface, (width, height) = self._window.get_surface(), SIZE
        surface.fill(PAPER)
        surface.blit(self._picture.paint(scene), (0, 0))
        if self._drag is not None and self._tool is not None:
            draw_arrow(surface, *self._drag, TOOLS[self._tool][1])
        self._text.write(surface, HELP.format(SLAM_KEYS if navigator is None else MAP_KEYS), midleft=(GAP, height + 8))
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
        slam: hector (default), tinyslam, gmapping, graph, odometry, truth, or `module:attribute` of a custom SLAM.
        people: number of people, or a crowd such as `dense` or `20?attentive=0.5`.
        control_hz: steps per second.
        seed: seed of world and noise.
        map: known map, as saved by M: NAME.yaml of map_server. AMCL localizes on it; mouse drags give pose and goals.
        map_pose: world pose of the frame of the known map [m, m, rad]; default: the spawn, where saved maps begin.
        save: file for maps saved by M, for map_server: NAME.yaml, with NAME.pgm.

    Raises:
        ValueError: if both `map` and `slam` are given, or another argument is not allowed.
        OSError: if the map cannot be read, or the folder of `save` does not exist.
    """
    shared: dict[str, Any] = {"world": world, "robot": robot, "physics": physics, "start": "spawn", "people": people}
    shared |= {"control_hz": control_hz, "time_limit": math.inf}
    if map is None:
        env = LidarEnv(Explore, slam=slam or DEFAULT_SLAM, **shared)
    elif slam is None:
        amcl = replace(load_preset("default"), lost_fit=MIN_FIT)
        env = LidarEnv(Navigate, map=map, map_pose=map_pose or "spawn", amcl=amcl, **shared)
    else:
        raise ValueError(f"--map localizes on a known map, and --slam {slam} builds a map: choose one")
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
