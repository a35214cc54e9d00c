"""What the environments share: robots are driven by twists, bump into things, and can be drawn."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from envs.compilation import announce_compilation
from envs.coverage import ExplorableArea
from envs.geometry import Pose2D
from envs.geometry.pose import distance
from envs.observation import Trail
from envs.robots import RobotParams, load_robot
from envs.simulation import Twist, make_simulator
from envs.simulation.sensors import sense
from envs.worlds import World

USUAL_ROBOT = "turtlebot3_burger"
"""Robot of worlds that `USUAL_ROBOTS` does not name."""
USUAL_ROBOTS = {
    "turtlebot3_house": "turtlebot3_waffle_pi",
    "tugbot_warehouse": "tugbot",
    "pimouse_arena": "raspimouse",
    "raspimouse_sample_maze": "raspimouse",
    "create3_maze": "create3",
}
"""Robot that a world is driven with when none is named."""


class DrivenEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray], ABC):
    """An environment in which robots are driven, one control period in a step, and can be drawn."""

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        *,
        robot: RobotParams,
        control_hz: float,
        time_limit: float | None,
        render_mode: str | None,
    ) -> None:
        """Take the arguments that all of them have.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        check_positive(control_hz=control_hz)
        if time_limit is not None and not time_limit > 0:
            raise ValueError(f"time_limit must be positive or None, got {time_limit!r}")
        announce_compilation(sense)
        self.robot = robot
        self.control_period = 1.0 / control_hz
        self.time_limit = time_limit or math.inf
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": max(1, round(control_hz))}
        self._time_limit = time_limit
        self._renderer: Any = None

    def close(self) -> None:
        """Release the window."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __getstate__(self) -> dict[str, Any]:
        """Leave the window behind when pickled."""
        return {**self.__dict__, "_renderer": None}

    def render(self) -> np.ndarray | None:
        """Draw this moment; an array (height, width, 3), uint8, for `rgb_array`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode; pass one to gymnasium.make")
            return None
        if self._renderer is None:
            from envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode, self.metadata["render_fps"], make_picture=self._painter())
        return self._renderer.draw(self.scene())

    @abstractmethod
    def scene(self) -> Any:
        """Return this moment for drawing."""

    @abstractmethod
    def _painter(self) -> Callable[[tuple[int, int]], Any] | None:
        """Return what makes the picture that scenes are painted in, see `envs.rendering.Renderer`."""


class RobotEnv(DrivenEnv):
    """An environment in which a policy drives one differential-drive robot; subclasses give it a task."""

    def __init__(
        self,
        *,
        robot: RobotParams,
        physics: str,
        control_hz: float,
        time_limit: float | None,
        render_mode: str | None,
    ) -> None:
        """Take the arguments that all of them have.

        Raises:
            ValueError: if one is not allowed; the message names it and what is.
        """
        super().__init__(robot=robot, control_hz=control_hz, time_limit=time_limit, render_mode=render_mode)
        self.simulator = make_simulator(physics, robot, self.control_period)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def close(self) -> None:
        """Release the physics engine and the window."""
        self.simulator.close()
        super().close()

    def _stand(self, world: World, pose: Pose2D, rng: np.random.Generator) -> None:
        """Put the robot at a pose of a world, with nothing driven yet."""
        self.reading = self.simulator.reset(world, [pose], [rng])[0]
        self._state = self.simulator.states[0]
        self._true_trail = Trail()
        self._true_trail.append(self._state.pose)
        self._action = np.zeros(2, dtype=np.float32)
        self._path_length = 0.0
        self._collisions = 0

    def _drive(self, action: np.ndarray) -> Pose2D:
        """Drive for one control period, and return the true pose before it.

        Raises:
            ValueError: if the action has the wrong shape, is not finite, or lies outside [-1, 1].
        """
        action = checked_action(action, (2,))
        self._action = action
        touching, before = self.reading.bumper, self._state.pose
        command = Twist(float(action[0]) * self.robot.max_v, float(action[1]) * self.robot.max_w)
        self.reading = self.simulator.step([command])[0]
        self._state = self.simulator.states[0]
        self._true_trail.append(self._state.pose)
        self._path_length += distance(self._state.pose.x - before.x, self._state.pose.y - before.y)
        self._collisions += self.reading.bumper and not touching
        return before

    @property
    def _is_late(self) -> bool:
        """Whether the time is up."""
        return self.reading.time >= self.time_limit - 1e-6


def checked_action(action: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return an action as an array of its own, float32.

    Raises:
        ValueError: if it has another shape, is not finite, or lies outside [-1, 1].
    """
    action = np.array(action, dtype=np.float32)
    if action.shape != shape:
        raise ValueError(f"action must have shape {shape}, got {action.shape}")
    if not (np.abs(action) <= 1.0).all():
        raise ValueError(f"action must be finite and lie in [-1, 1], got {action}")
    return action


def choose_robot(robot: str | RobotParams | None, world: str | World) -> RobotParams:
    """Return a robot by name, path or as it is; for None the world's usual one."""
    name = world if isinstance(world, str) else getattr(world, "name", "")
    return load_robot(USUAL_ROBOTS.get(name, USUAL_ROBOT) if robot is None else robot)


def read_start(start: str | tuple[float, float, float]) -> str | Pose2D:
    """Return the argument `start` of environments: `"random"`, `"spawn"`, or a pose.

    Raises:
        ValueError: if it is none of them.
    """
    if isinstance(start, str) and start in ("random", "spawn"):
        return start
    if not is_pose(start):
        raise ValueError(f"start must be 'random', 'spawn' or (x, y, theta), got {start!r}")
    return Pose2D(*(float(value) for value in start))


def choose_start(
    start: str | Pose2D, world: World, area: ExplorableArea, robot: RobotParams, rng: np.random.Generator
) -> Pose2D:
    """Return the pose to start from, world frame.

    Args:
        start: what `read_start` returned.
        world: the place; its first spawn is `"spawn"`.
        area: of the world.
        robot: who starts there.
        rng: draws `"random"` uniformly over where the robot can stand.

    Raises:
        ValueError: if the robot cannot stand there.
    """
    if start == "random":
        return area.draw_pose(rng)
    pose = world.spawns[0] if isinstance(start, str) else start
    if not area.can_stand(pose):
        raise ValueError(
            f"start {tuple(pose)} is no place where robot {robot.name!r} (radius {robot.radius} m) "
            f"can stand in world {world.name!r}; its spawns are {[tuple(spawn) for spawn in world.spawns]}"
        )
    return pose


def is_pose(pose: Any) -> bool:
    """Tell whether something is (x, y, theta), all finite."""
    try:
        return len(pose) == 3 and all(math.isfinite(value) for value in pose)
    except TypeError:
        # No sequence, or one of something else than numbers.
        return False


def check_positive(**values: float) -> None:
    """Refuse numbers that are not positive and finite.

    Raises:
        ValueError: names the first of them.
    """
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be positive, got {value!r}")
