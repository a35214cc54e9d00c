"""Recording of episodes as ROS 2 bags."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.logs import messages
from lidarnaut.envs.logs.bag_writer import BagWriter
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.rendering.scene import people_in
from lidarnaut.envs.simulation import Twist

MAP_PERIOD = 1.0
"""Minimum time between recorded maps [s]."""
TRACKS, PEOPLE = "/tracks", "/ground_truth/people"
"""ROS topics of tracked and true people (`visualization_msgs/MarkerArray`)."""
_NO_PATH = np.empty((0, 2))


class BagRecorder:
    """Recorder of one episode of a single robot as a ROS 2 bag.

    As a context manager, removes the bag after an exception. Per control period: `/clock`, `/scan`, `/odom`, `/tf`,
    `/cmd_vel`, `/plan`, `/sensors/NAME` (user-defined), `/tracks` (people) and `/ground_truth/people`. Per second:
    `/map`. Once: `/tf_static`. The clock is `messages.RESET_STAMP` at the reset. `/odom` is odometry, also with
    `slam="truth"`. Frames: `map`, `odom`, `base_footprint`, `base_link`, `laser`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], path: str | Path) -> None:
        """Start recording a (possibly wrapped) environment, whose next call must be `reset`.

        `path`: bag file `NAME.mcap`, created when complete; replaces a file of this name.

        Raises:
            TypeError: the environment has no robot with a lidar.
            ValueError: several robots, a running recording, or another file suffix.
            OSError: the bag cannot be written.
        """
        inner = lidar_env_of(env)
        if len(inner.robots) > 1:
            raise ValueError(f"bags support one robot, the environment has {len(inner.robots)}")
        if inner.on_period is not None:
            raise ValueError("the environment is being recorded already")
        self._env = inner
        self._robot = inner.robots[0]
        self._is_open, self._is_started = True, False
        self._time = self._map_time = 0.0
        self._writer = BagWriter(Path(path))
        inner.on_period = self._record

    def close(self) -> None:
        """Write the last map and complete the bag. Without a reset, no bag is created. Idempotent."""
        if not (self._is_open and self._is_started):
            self.discard()
            return
        self._stop()
        if self._map_time < self._time:
            self._write_map()
        self._writer.close()

    def discard(self) -> None:
        """Stop recording and remove the bag, unless complete."""
        if self._is_open:
            self._stop()
            self._writer.discard()

    def __enter__(self) -> "BagRecorder":
        return self

    def __exit__(self, kind: Any, error: BaseException | None, traceback: Any) -> None:
        self.close() if error is None else self.discard()

    def _stop(self) -> None:
        self._is_open, self._env.on_period = False, None

    def _record(self, commands: Sequence[Twist] | None) -> None:
        reading, write = self._robot.reading, self._writer.write
        time = messages.RESET_STAMP + reading.time
        if commands is None:
            if self._is_started:
                raise RuntimeError("a bag holds one episode: close the recorder before the next reset")
            self._is_started = True
            write("/tf_static", time, messages.static_transforms(self._robot.params.lidar.mount))
        else:
            plan = self._env.overlay.plan
            write("/cmd_vel", self._time, messages.command(self._time, commands[0]))
            write("/plan", self._time, messages.path(self._time, _NO_PATH if plan is None else plan))
        twist = Twist(reading.motion.x / self._env.control_period, reading.motion.theta / self._env.control_period)
        self._time = time
        map_odom = self._robot.belief.pose.compose(reading.odometry.inverse())
        scan = messages.laser_scan(time, reading.ranges, self._robot.params.lidar, self._env.control_period)
        write("/clock", time, messages.clock(time))
        write("/scan", time, scan)
        for sensor in self._env.sensors:
            write(f"/sensors/{sensor.name}", time, messages.numbers(np.asarray(reading.extra[sensor.name])))
        people = people_in(self._env.simulator.people, self._env.map_pose.inverse())
        for topic, found in ((TRACKS, self._env.overlay.tracks), (PEOPLE, people)):
            if len(found):
                write(topic, time, messages.people(time, found))
        write("/odom", time, messages.odometry(time, reading.odometry, twist))
        edges = (messages.MAP, messages.ODOM, map_odom), (messages.ODOM, messages.BASE, reading.odometry)
        write("/tf", time, messages.transforms(time, *edges))
        if commands is None or time - self._map_time >= MAP_PERIOD - 1e-6:
            self._write_map()

    def _write_map(self) -> None:
        self._map_time = self._time
        known = crop_to_known(self._robot.belief.grid, margin=0)
        self._writer.write("/map", self._time, messages.occupancy_grid(self._time, known))


class RecordBag(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Wrapper that records each episode as a ROS 2 bag `episode_<n>.mcap`, with n from 0.

    A bag is complete after the episode, the next reset, or `close`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], path: str | Path) -> None:
        """Wrap a single-robot environment. `path`: folder of the bags; bags of equal names are overwritten."""
        gymnasium.utils.RecordConstructorArgs.__init__(self, path=path)
        super().__init__(env)
        self._folder = Path(path)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._count = 0
        self._recorder: BagRecorder | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self._finish()
        self._recorder = BagRecorder(self.env, self._folder / f"episode_{self._count}.mcap")
        try:
            result = self.env.reset(seed=seed, options=options)
        except BaseException:
            self._recorder.discard()
            raise
        self._count += 1
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._finish()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        try:
            self._finish()
        finally:
            super().close()

    def _finish(self) -> None:
        if self._recorder is not None:
            self._recorder.close()
