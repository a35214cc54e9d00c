"""Drive a robot of ROS 1 or ROS 2 through rosbridge: `lidarnaut-drive --url ws://robot:9090 --robot my_robot.yaml`."""

import contextlib
import functools
import logging
import math
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines import EXPLORERS, OFFERED
from lidarnaut.envs.arguments import check_positive
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.logs import messages
from lidarnaut.envs.logs.scans import Scan, resampled
from lidarnaut.envs.logs.transforms import frame_name, seconds
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.robots import LidarParams, Mount, RobotParams, load_robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.worlds import save_map
from lidarnaut.envs.worlds.map_files import map_paths
from lidarnaut.envs.wrappers.record_bag import BagRecorder

from .commands import BridgeCommands, CommandProcess, CommandTopic, local_time
from .driver import STOP, Driver
from .frames import Frames
from .program import Clock, first_signal, handle_signals, run_program, time_limited
from .progress import Progress
from .rosbridge import Rosbridge
from .viewer import Viewer

LOGGER = logging.getLogger(__name__)
MAX_STEP = 60.0
"""A decision that takes longer ends the drive, except for the first one, which compiles [s]."""
SAVE_PERIOD = 60.0
"""Time between writes of the map of `save_map` while driving, for ends that leave no time for it [s]."""
DEAD_MAN_TIME = 0.5
"""A message of the dead man's switch permits driving for this time [s]."""


@dataclass(frozen=True)
class Options:
    """Options of the driver."""

    url: str = "ws://localhost:9090"
    """Address of the rosbridge server."""
    robot: str = "turtlebot3_burger"
    """Library robot, or path of a robot YAML."""
    policy: str = "learned:pretrained/frontiers"
    """Name as in `lidarnaut-evaluate --policies`. Policies with a goal wait for `goal` or one of RViz."""
    goal: tuple[float, ...] | None = None
    """Goal x, y [m], optionally heading [rad] (not for learned policies), map frame; selects policies with a goal."""
    slam: str = "hector"
    """SLAM, without a map."""
    map: Path | None = None
    """Known map (YAML of map_server), on which AMCL localizes the robot."""
    initial_pose: tuple[float, float, float] | None = None
    """Start on the known map, x, y [m] and heading [rad]; default: unknown (global localization)."""
    control_hz: float = 10.0
    """Commands per second [Hz]; learned policies have the rate of their training."""
    max_v: float | None = None
    """Maximum forward speed, if below that of the robot [m/s]."""
    max_w: float | None = None
    """Maximum yaw rate, if below that of the robot [rad/s]."""
    timeout: float = 1.0
    """The robot stops if the last scan or the connection is older [s]."""
    time_limit: float | None = None
    """Drive for at most this time of the robot's clock, jumps left out; exit status 3 if the task is not done [s]."""
    dry_run: bool = False
    """Print commands instead of sending them."""
    dead_man: str | None = None
    """Topic (std_msgs/Bool) that must be true, at least every 0.5 s, for the robot to drive."""
    record: Path | None = None
    """Bag of the session, `NAME.mcap`, a new file."""
    save_map: Path | None = None
    """Map to write at the end, `NAME.yaml` of map_server."""
    lidar_from_messages: bool = False
    """Use the beams of the first scan, and its mount; otherwise, scans are resampled to those of the robot YAML."""
    lidar_from_robot: bool = False
    """Take the mount of the lidar from the robot YAML instead of `/tf_static` and `/tf`."""
    no_return: str = "inf"
    """Meaning of ranges that rosbridge sends as null: `inf` (no return) or `nan` (invalid); with `zero`, as with this
    key of the robot's lidar, ranges of 0.0 are no return as well."""
    use_sim_time: bool = False
    """Take the time from `/clock`."""
    stamped: bool = False
    """Send commands as TwistStamped instead of Twist; also done if the server names this type."""
    odometry_scales: tuple[float, float] = (1.0, 1.0)
    """Factors of distances and turns of odometry, as `lidarnaut-replay` prints them for a recorded drive. Turns
    that the gyroscope of `imu_topic` measures are not multiplied."""
    seed: int = 0
    """Seed of estimator and policy."""
    namespace: str = ""
    """Prefix of all topics except `/clock`, such as `robot1`."""
    trust: tuple[str, ...] = ()
    """Modules, or names `module:attribute`, of your own code that the policy may import."""
    scan_topic: str = "/scan"
    odom_topic: str = "/odom"
    """Topic of the odometry: Odometry messages, or `/tf`."""
    imu_topic: str | None = None
    """Topic of an IMU (sensor_msgs/Imu) whose yaw rate replaces the turns of odometry, such as `/imu`."""
    cmd_vel_topic: str = "/cmd_vel"
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str | None = None
    """Base of the robot, between its wheels; default: the child frame of the odometry."""
    laser_frame: str | None = None
    """Frame of the scans; default: that of the first scan. Messages of other frames are ignored, with a warning."""


class Session:
    """A driver connected to the topics of a robot."""

    def __init__(self, options: Options, bridge: Any, commands: Any = None, viewer: Any = None) -> None:
        """Subscribe to the robot's topics. `step` then drives.

        `bridge`: connection of the sensors. `commands`: a `CommandProcess`; None to send commands by `bridge`, or
        nothing with `dry_run`. `viewer`: connection for RViz; None for `bridge`.

        Raises:
            ValueError: an option has a value that is not allowed.
            lidarnaut.agents.run_folder.CheckpointError: the policy cannot be loaded.
        """
        if options.no_return not in ("inf", "nan", "zero"):
            raise ValueError(f"no_return must be 'inf', 'nan' or 'zero', got {options.no_return!r}")
        if options.goal is not None and len(options.goal) not in (2, 3):
            raise ValueError(f"goal must be x, y, and optionally a heading, got {options.goal}")
        for name in ("control_hz", "max_v", "max_w", "time_limit"):
            if (value := getattr(options, name)) is not None:
                check_positive(**{name: value})
        if options.save_map is not None and not map_paths(options.save_map)[1].parent.is_dir():
            raise ValueError(f"save_map: {options.save_map.parent} is not a folder")
        if options.record is not None and options.record.exists():
            raise ValueError(f"record: {options.record} exists; give another name or remove it")
        self.options, self._bridge, self._clock = options, bridge, Clock()
        robot = load_robot(options.robot)
        max_v, max_w = options.max_v or robot.max_v, options.max_w or robot.max_w
        lidar = replace(robot.lidar, no_return="zero") if options.no_return == "zero" else robot.lidar
        self._robot = replace(robot, lidar=lidar, max_v=min(max_v, robot.max_v), max_w=min(max_w, robot.max_w))
        self.driver = self._make_driver(self._robot)
        """Driver; replaced at the first scan with `lidar_from_messages`."""
        self._recorder: BagRecorder | None = None
        self._waits_for_lidar = options.lidar_from_messages
        if not self._waits_for_lidar:
            self._start_recording()
        self._frames = Frames(options, lidar)
        self._permitted, self._waited = -math.inf, 0.0  # messages may have waited in `run` for that time
        self._sim_time, self._ticked, self._progress = math.nan, math.inf, Progress(options.goal)
        self._saved, self._failures = local_time(), dict[str, str]()
        self.reason = "no scan yet"
        """Why the last command was a stop; empty while driving."""
        self._bridges = [bridge] if viewer is None else [bridge, viewer]
        self._viewer = Viewer(self._bridges[-1], self._frames.map, self._frames.odom)
        self._commands = commands
        if commands is None and not options.dry_run:
            self._commands = BridgeCommands(bridge, command_topic(options))
        self._subscribe()

    def _make_driver(self, robot: RobotParams) -> Driver:
        o = self.options
        has_goal = (o.goal or o.map) is not None or o.policy in OFFERED["goal"].keys() - EXPLORERS.keys()
        policy = parse_policy(o.policy, OFFERED["goal"] if has_goal else EXPLORERS, trust=o.trust).make()
        if o.map is None:
            task: dict[str, Any] = {"id": policy.id or ("lidarnaut/ReachGoal-v0" if has_goal else None), "slam": o.slam}
        else:
            task = {"id": "lidarnaut/Navigate-v0", "map": o.map, "initial_pose": o.initial_pose or "unknown"}
        how: Any = {"timeout": o.timeout, "odometry_scales": o.odometry_scales, "seed": o.seed}
        hz, gyro = policy.control_hz or o.control_hz, o.imu_topic is not None
        driver = Driver(policy, robot, control_hz=hz, gyro=gyro, **how, **task)
        if o.goal is not None:
            driver.goal(*o.goal)
        return driver

    def _start_recording(self) -> None:
        if self.options.record is not None:
            env = self.driver.env
            self._recorder = BagRecorder(env, self.options.record)
            self._write: Any = env.on_period
            env.on_period = self._record

    def _record(self, commands: Any) -> None:
        """Record a control period; the recording ends, and not the drive, if that fails, as on a full disk."""
        self._try("recording", functools.partial(self._write, commands))
        if "recording" in self._failures and self._recorder is not None:
            with contextlib.suppress(Exception):
                self._recorder.close()
            self._recorder = self.driver.env.on_period = None

    def _subscribe(self) -> None:
        o, bridge = self.options, self._bridge
        if o.use_sim_time:
            bridge.subscribe("/clock", "rosgraph_msgs/msg/Clock", self._on_clock)
        bridge.subscribe("/tf_static", "tf2_msgs/msg/TFMessage", self._on_static)
        bridge.subscribe(o.scan_topic, "sensor_msgs/msg/LaserScan", self._on_scan)
        self._has_odometry_on_tf = o.odom_topic.rpartition("/")[2] == "tf"
        bridge.subscribe(o.odom_topic if self._has_odometry_on_tf else "/tf", "tf2_msgs/msg/TFMessage", self._on_tf)
        if not self._has_odometry_on_tf:
            bridge.subscribe(o.odom_topic, "nav_msgs/msg/Odometry", self._on_odometry)
        if o.imu_topic is not None:
            bridge.subscribe(o.imu_topic, "sensor_msgs/msg/Imu", self._on_imu)
        for topic in ("/goal_pose", "/move_base_simple/goal"):  # of RViz in ROS 2, and in ROS 1
            bridge.subscribe(topic, "geometry_msgs/msg/PoseStamped", self._on_goal)
        bridge.subscribe("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", self._on_initial_pose)
        if o.dead_man is not None:
            bridge.subscribe(o.dead_man, "std_msgs/msg/Bool", self._on_dead_man)

    @property
    def time(self) -> float:
        """Time of the robot's clock [s]; NaN before the first message."""
        return self._sim_time if self.options.use_sim_time else self._clock.time

    def _on_clock(self, message: Any) -> None:
        if (time_now := seconds(message.clock)) != self._sim_time:
            self._sim_time, self._ticked = time_now, time.monotonic()

    def _on_dead_man(self, message: Any) -> None:
        self._permitted = time.monotonic() - self._waited if message.data is True else -math.inf

    def _on_static(self, message: Any) -> None:
        self._frames.add(message, static=True)
        self._use_scans()

    def _on_tf(self, message: Any) -> None:
        self._frames.add(message, static=False)
        for one in message.transforms if self._has_odometry_on_tf else ():
            if frame_name(one.header.frame_id) == self._frames.odom:
                pose = pose_of(one.transform.translation, one.transform.rotation)
                self._note_odometry(one.header.stamp, one.child_frame_id, pose)
        self._use_scans()

    def _on_odometry(self, message: Any) -> None:
        if self._frames.is_expected("odometry", message.header.frame_id, self._frames.odom):
            pose = pose_of(message.pose.pose.position, message.pose.pose.orientation)
            self._note_odometry(message.header.stamp, getattr(message, "child_frame_id", ""), pose)

    def _note_odometry(self, stamp: Any, child: str, pose: Pose2D) -> None:
        self._clock.note(time := seconds(stamp))
        if (base_pose := self._frames.base_pose(child, pose, self.time)) is not None:
            self.driver.odometry(base_pose, time)

    def _on_imu(self, message: Any) -> None:
        if (yaw_rate := self._frames.yaw_rate(message, self.time)) is not None:
            self.driver.imu(yaw_rate, seconds(message.header.stamp))

    def _on_scan(self, message: Any) -> None:
        self._clock.note(seconds(message.header.stamp))
        self._frames.receive(message)
        self._use_scans()

    def _use_scans(self) -> None:
        """Pass the scans whose transform is known to the driver."""
        for scan in self._frames.placed(self.time):
            if self._waits_for_lidar:
                self.driver = self._make_driver(replace(self._robot, lidar=_lidar_of(scan, self._robot.lidar)))
                self._waits_for_lidar = False
                self._start_recording()
            self.driver.scan(*_on_beams(scan, self.driver.robot.lidar))

    def _on_goal(self, message: Any) -> None:
        frames, frame, driver = self._frames, frame_name(message.header.frame_id), self.driver
        goal = pose_of(message.pose.position, message.pose.orientation)
        if self._waits_for_lidar:
            LOGGER.warning("goals before the first scan are ignored")
            return
        if frame and frame in (frames.odom, frames.base) and driver.has_begun:
            goal = (driver.map_to_odometry if frame == frames.odom else driver.belief.pose).compose(goal)
        elif not frames.is_expected("goal", frame, frames.map):
            return
        if not driver.takes_headings:  # RViz always sends one
            LOGGER.warning("learned policies do not turn to headings: that of the goal is ignored")
        driver.goal(goal.x, goal.y, goal.theta if driver.takes_headings else None)

    def _on_initial_pose(self, message: Any) -> None:
        if self._frames.is_expected("initial pose", message.header.frame_id, self._frames.map):
            pose = pose_of(message.pose.pose.position, message.pose.pose.orientation)
            self.driver.initial_pose(*pose, getattr(message.pose, "covariance", None))

    def step(self) -> Twist:
        """Send the next command, and estimates for RViz; return the command."""
        now, began, driver = self.time, local_time(), self.driver
        if self._waits_for_lidar or math.isnan(now):
            self.reason = self._frames.explain("no scan yet")
            return STOP
        command = driver.command(now, self._why_held())
        self.reason = driver.reason = self._frames.explain(driver.reason)
        if self._commands is None:
            LOGGER.info("%.2f s: %.3f m/s, %.3f rad/s", now, *command)
        else:
            self._commands.send(command, now, began)
        self._progress.note(driver, now)
        if driver.has_begun:
            self._viewer.show(driver, now)
            if began - self._saved >= SAVE_PERIOD:
                self._saved = began
                self._try("map", self._save_map)
        return command

    def _why_held(self) -> str:
        for connection in (self._bridge, self._commands):
            if connection is not None and connection.error:
                return f"no connection: {connection.error}"
        if self.options.dead_man is not None and time.monotonic() - self._permitted > DEAD_MAN_TIME:
            return f"{self.options.dead_man} is not true"
        if time.monotonic() - self._ticked > self.options.timeout:
            return "/clock stands still"
        return ""

    def run(self, is_over: threading.Event, watch: Callable[[], Any] = contextlib.nullcontext) -> bool:
        """Receive messages, and send commands at the control rate, which is that of the training for learned policies.

        Ends when `is_over` is set, when the task is done, or at the time limit; returns False in the last case. Each
        step but the first one, which compiles kernels, is within a context of `watch`.
        """
        due, stepped, spun, limit = -math.inf, 0.0, time.monotonic(), self.options.time_limit or math.inf
        while not is_over.is_set():
            self._waited, spun = time.monotonic() - spun, time.monotonic()
            for bridge in self._bridges:
                bridge.spin()
            period = self.driver.env.control_period
            now, is_frozen = self.time, time.monotonic() - stepped > 0.5 * self.options.timeout
            if now >= due or now < due - 1.0 or is_frozen:
                with watch() if self.driver.has_begun else contextlib.nullcontext():
                    self.step()
                if self._progress.is_done(self.driver):
                    LOGGER.info("done: %s", self.reason)
                    return True
                if self._progress.elapsed > limit:
                    LOGGER.warning("not done within %g s", limit)
                    return False
                stepped = time.monotonic()
                due = due + period if now - period < due <= now else now + period
            time.sleep(0.001 if self.options.use_sim_time else 0.1 * period)
        return True

    def close(self) -> None:
        """Stop the robot, write the map, and complete the recording: each of them also if another one fails.

        Raises:
            RuntimeError: the map or the recording is not complete.
        """
        if self._commands is not None:
            self._try("stops", self._commands.close)
        self._try("map", self._save_map)
        if self._recorder is not None:
            self._try("recording", self._recorder.close)
        if self._failures:
            raise RuntimeError("; ".join(f"{name}: {text}" for name, text in self._failures.items()))

    def _try(self, name: str, work: Callable[[], None]) -> None:
        """Do something whose failure must not keep the drive or its end from going on; warn of the first failure."""
        try:
            work()
            self._failures.pop(name, None)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if name not in self._failures:
                LOGGER.warning("%s: %s", name, text)
            self._failures[name] = text

    def _save_map(self) -> None:
        if self.options.save_map is not None and self.driver.has_begun:
            save_map(crop_to_known(self.driver.belief.grid), self.options.save_map)


def command_topic(options: Options) -> CommandTopic:
    """Return where and how the commands of a drive are sent."""
    o = options
    period, frame = 1.0 / o.control_hz, o.base_frame or messages.BASE
    return CommandTopic(o.cmd_vel_topic, o.stamped, frame, o.url, o.namespace, period, o.timeout)


def _lidar_of(scan: Scan, lidar: LidarParams) -> LidarParams:
    """Return a lidar with beams and mount of a scan."""
    fov, count = scan.step * (len(scan.ranges) - 1), len(scan.ranges)
    mount = Mount(*scan.position, yaw=scan.first + 0.5 * fov)
    low, high = scan.range_min, scan.range_max
    return replace(lidar, num_beams=count, fov=fov, mount=mount, range_min=low, range_max=high)


def _on_beams(scan: Scan, lidar: LidarParams) -> tuple[np.ndarray, float, np.ndarray]:
    """Return the ranges of a lidar's beams, the stamp [s] and the time of each beam after it [s]."""
    first, step = lidar.mount.yaw + lidar.angle_min, lidar.angle_increment
    shift = math.hypot(scan.position[0] - lidar.mount.x, scan.position[1] - lidar.mount.y)
    is_same = len(scan.ranges) == lidar.num_beams and abs(scan.step - step) < 1e-4 and shift < 1e-3
    if is_same and abs(wrap_angle(scan.first - first)) < 0.1 * step:
        return scan.ranges, scan.time, scan.delays
    ranges = resampled(scan, (lidar.mount.x, lidar.mount.y), first, step, lidar.num_beams)
    steps = (lidar.angles + lidar.mount.yaw - scan.first + 0.5 * scan.step) % (2.0 * math.pi) / scan.step - 0.5
    return ranges, scan.time, scan.delay + scan.time_increment * np.clip(steps, 0.0, len(scan.ranges) - 1.0)


def pose_of(position: Any, q: Any) -> Pose2D:
    """Return x, y [m] and yaw [rad] of a point and a quaternion message."""
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return Pose2D(position.x, position.y, yaw)


def main(options: Options) -> None:
    """Drive a robot until the task is done, the time limit, or Ctrl-C.

    Three connections do not wait for each other: commands (in a process of their own), RViz, and last the sensors,
    which are subscribed to once commands can be sent.

    Raises:
        ValueError: an option has a value that is not allowed.
        RuntimeError: the map or the recording is not complete.
        TimeoutError: a decision takes over `MAX_STEP`.
        SystemExit: with status 3: the task is not done within the time limit.
        lidarnaut.agents.run_folder.CheckpointError: the policy cannot be loaded.
    """
    o, is_done = options, True
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as held:
        viewer = held.enter_context(contextlib.closing(Rosbridge(o.url, o.namespace)))
        commands = None if o.dry_run else held.enter_context(contextlib.closing(CommandProcess(command_topic(o))))
        how: Any = {"expected": [topic for topic in (o.scan_topic, o.odom_topic, o.imu_topic) if topic is not None]}
        how["is_ready"] = lambda: not (viewer.error or (commands is not None and commands.error))
        bridge = held.enter_context(contextlib.closing(Rosbridge(o.url, o.namespace, **how)))
        session = held.enter_context(contextlib.closing(Session(o, bridge, commands, viewer)))
        held.callback(handle_signals, signal.SIG_IGN)
        try:
            is_done = session.run(first_signal(), functools.partial(time_limited, MAX_STEP))
        except (ValueError, RuntimeError, OSError):
            raise
        except (Exception, SystemExit) as error:  # a policy that exits must not seem to be done
            place = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"the policy fails: {what} ({place.filename}:{place.lineno})") from error
    if not is_done:
        sys.exit(3)


cli = functools.partial(run_program, main, Options)
"""Run `main` with options of the command line."""

if __name__ == "__main__":
    cli()
