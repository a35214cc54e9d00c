"""A real robot's half of an environment: estimation, observations and policy, fed by messages."""

import logging
import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from lidarnaut.baselines.adoption import adopt, needed_arguments
from lidarnaut.baselines.episode import Decide, begin_episode, decide_with
from lidarnaut.baselines.policy import PrivilegedPolicy
from lidarnaut.envs.arguments import check_positive
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.logs.scans import MAX_SWEEP, Scan, advise_on_zeros, resampled
from lidarnaut.envs.logs.trajectory import MAX_CLOCK_JUMP
from lidarnaut.envs.robots import RobotParams, load_robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.navigate import KnownMapBrief

from .brief import brief_of, check_brief
from .gate import STAMP, ImplausibleError, check_array, check_numbers, pose_covariance
from .messages_mover import MessagesMover, Sample
from .wheels import MOST_MESSAGES, WheelMotion

LOGGER = logging.getLogger(__name__)
STOP = Twist(0.0, 0.0)
TICK = 1e-6
"""Wheel travel per count of the virtual encoders that poses of odometry are converted to [m]."""
KEPT, MOST_SCANS = 10.0, 256
"""Messages are kept for at most this time until a scan is used [s]; and scans, at most this number."""
MIN_STEP, MIN_PERIOD = 1e-9, 1e-3
"""Least times between messages of a kind, and between two used scans [s]; rates are quotients of them."""
GOAL_REACH, MAX_RANGE = 200.0, 100.0
"""Goals may lie this far beyond the range of the lidar, and that of longer ranges, around the map and the robot [m]:
planners cover all space up to the goal."""


class Driver:
    """Drives a real robot with a policy: messages in, velocity commands out.

    Estimation, observations, policy and limits are those of a `LidarEnv`; messages replace its simulator. Pass messages
    as they arrive, and call `command` at the rate `control_hz`. Stamps are times of measurement [s] of one clock.

    A scan is used once odometry covers all its beams, and then the newest one. It is shown as from the pose of the
    newest odometry, which the command is for. Without a new scan, the last command holds. Messages whose numbers are
    implausible (`gate.KINDS`), or that are not newer than the last one of their kind, are dropped and counted; those
    without numbers raise ValueError. After a step of the clock back by more than a second, all kinds begin anew.
    Between the last scan before a pause and the first one after it, the policy's clock stands. Calls must come from
    one thread at a time.
    """

    def __init__(
        self,
        policy: Any,
        robot: str | RobotParams,
        *,
        id: str | None = None,
        motion: Literal["odometry", "encoders"] = "odometry",
        control_hz: float | None = None,
        timeout: float = 1.0,
        odometry_scales: tuple[float, float] = (1.0, 1.0),
        gyro: bool = False,
        seed: int = 0,
        **arguments: Any,
    ) -> None:
        """Create a driver.

        Args:
            policy: explorer, goal controller or learned policy, as for `lidarnaut.run_episode`.
            robot: library robot, path of a robot YAML, or parameters.
            id: environment with the policy's task, which selects estimator, observations and goal; default: that of
                the policy's training, otherwise `lidarnaut/Explore-v0`.
            motion: messages with the motion of the wheels: `odometry` or `encoders`.
            control_hz: rate of `command` [Hz]; default: that of the policy's training, otherwise 10.
            timeout: maximum age of the last used scan; beyond, the robot stops [s].
            odometry_scales: factors of distances and turns, as `lidarnaut-replay` prints them for a drive.
            gyro: whether yaw rates of `imu` replace the turns of odometry. With encoders, the robot YAML says so.
            seed: seed of estimator and policy.
            arguments: arguments of the environment, such as `slam` and `map`. By default, `observations` and
                `collision_monitor` are those of the policy's training, and `track_people` is True.

        Raises:
            ValueError: a value is not allowed, the task is not for a single robot, or the policy uses ground truth.
            TypeError: the environment has no such argument.
        """
        policy = adopt(policy, spaces.Box(-1.0, 1.0, (2,), np.float32))
        id = id or policy.id or "lidarnaut/Explore-v0"
        if control_hz is None:
            control_hz = policy.control_hz or 10.0
        check_positive(control_hz=control_hz, timeout=timeout)
        for scale in odometry_scales:
            check_positive(odometry_scales=scale)
        _check_arguments(policy, motion, seed, arguments)
        robot = load_robot(robot)
        if motion == "odometry":
            counts = 2.0 * math.pi * robot.odometry.wheel_radius / TICK
            robot = replace(robot, odometry=replace(robot.odometry, ticks_per_rev=counts, uses_gyro=gyro))
        arguments = {"track_people": True, **needed_arguments(policy), **arguments}
        self.env = LidarEnv(brief_of(id), robot=robot, physics=MessagesMover, control_hz=control_hz, **arguments)
        """Environment without a simulator, for recordings and pictures."""
        check_brief(self.env.task)
        self.robot, self.timeout = robot, timeout
        self.reason = "no scan yet"
        """Why the last command was a stop; empty while driving."""
        self.dropped: Counter[str] = Counter()
        """Numbers of dropped messages by reason."""
        self._policy, self._seed = policy, seed
        self.takes_headings = hasattr(policy, "act") or "heading_tolerance" in arguments
        """Whether goals may have headings: not for learned policies, unless there is a `heading_tolerance`."""
        self._decide: Decide | None = None
        self._wheels = WheelMotion(robot, odometry_scales, uses_encoders=motion == "encoders")
        self._scans = deque[tuple[float, Any]](maxlen=MOST_SCANS)
        self._rates = deque[tuple[float, Any]](maxlen=MOST_MESSAGES)
        self._newest: dict[str, float] = {}
        self._fault, self._touched, self._advice = "", False, ""
        self._jump_stamp = self._steady_stamp = -math.inf  # of the last scans with and without a jump before
        self._stamp, self._scan_stamp, self._offset, self._time = -math.inf, -math.inf, 0.0, 0.0
        self._command = STOP
        if self.env.task.goal is not None and self.env.task.has_goal:
            self._check_reach(self.env.task.goal)

    def scan(self, ranges: np.ndarray, stamp: float, delays: np.ndarray | None = None) -> None:
        """Receive a scan: ranges, shape (num_beams,) [m]; +inf is no return, NaN an invalid beam, 0 see `no_return`.

        `delays`: time of each beam after the stamp, shape (num_beams,) [s]; None for beams measured at once.

        Raises:
            ValueError: another number of beams than the robot's lidar has, no numbers, or delays of more than a second.
        """
        ranges, lidar = check_array("scan", ranges, np.float32), self.robot.lidar
        if ranges.shape != (lidar.num_beams,):
            raise ValueError(f"scan must have {lidar.num_beams} ranges, got shape {ranges.shape}")
        delays = np.zeros(len(ranges)) if delays is None else check_array("delays", delays, np.float64)
        if not (delays.shape == ranges.shape and np.abs(delays).max() <= MAX_SWEEP):
            raise ValueError(f"delays must have shape {ranges.shape}, and be at most {MAX_SWEEP:g} s, got {delays}")
        is_zero = ranges == 0.0
        ranges[~(ranges >= lidar.range_min) | is_zero] = np.nan
        ranges[ranges > lidar.range_max] = np.inf
        if lidar.no_return == "zero":
            ranges[is_zero] = np.inf
        elif not self._advice:
            self._advice = advise_on_zeros(int(is_zero.sum()), int(np.isposinf(ranges).sum()), len(ranges))
            if self._advice:
                LOGGER.warning("%s", self._advice)
        if np.isnan(ranges).all():
            self._drop("scan without a valid beam")
        else:
            self._receive("scan", self._scans, stamp, (ranges, delays))

    def odometry(self, pose: Sequence[float], stamp: float) -> None:
        """Receive a base pose (x, y, theta) in the odometry frame [m, m, rad]; ValueError with `motion="encoders"`."""
        self._receive_motion("odometry", pose, stamp)

    def encoders(self, left: int, right: int, stamp: float) -> None:
        """Receive cumulative encoder counts of the wheels; ValueError without `motion="encoders"`."""
        self._receive_motion("encoders", (left, right), stamp)

    def _receive_motion(self, kind: str, numbers: Sequence[float], stamp: float) -> None:
        if self._wheels.uses_encoders != (kind == "encoders"):
            raise ValueError(f"messages of {kind} need motion={kind!r}")
        self._receive(kind, self._wheels.messages, stamp, numbers)

    def imu(self, yaw_rate: float, stamp: float) -> None:
        """Receive a yaw rate [rad/s]: the turn during jumps; always if the robot's odometry uses the gyroscope."""
        self._receive("imu", self._rates, stamp, (yaw_rate,))

    def bumper(self, touched: bool) -> None:
        """Receive the state of the bumper."""
        self._touched |= bool(touched)

    def goal(self, x: float, y: float, theta: float | None = None) -> None:
        """Set the goal, map frame [m, m, rad]. Without a heading, the goal is reached with any.

        Raises:
            ValueError: the task has no goal, or asks for a heading; a number is implausible; the goal is farther from
                the map than the range of the lidar and `GOAL_REACH`; or a heading is given to a learned policy, and the
                driver has no argument `heading_tolerance`.
        """
        if self.env.task.goal is None:
            raise ValueError(f"task {type(self.env.task).__name__.removesuffix('Brief')} has no goal")
        if theta is not None and not self.takes_headings:
            name = type(self._policy).__name__
            raise ValueError(f"{name} is not known to turn to headings: set a goal x, y, or a heading_tolerance")
        goal = check_numbers("goal", (x, y, 0.0 if theta is None else theta))
        self._check_reach(goal)
        self.env.task.set_goal(goal[:2] if theta is None else goal)

    def _check_reach(self, goal: Sequence[float]) -> None:
        """Raise ValueError if a goal is too far from the rectangle around the map and the robot."""
        if self.has_begun:
            known = np.vstack([np.reshape(self.belief.grid.bounds, (2, 2)), self.belief.pose[:2]])
        else:
            grid = self.env.task.prior(0, np.random.default_rng(0)).map
            known = np.reshape(np.zeros(4) if grid is None else grid.bounds, (2, 2))
        distance = math.dist(goal[:2], np.clip(goal[:2], known.min(axis=0), known.max(axis=0)))
        if distance > (allowed := GOAL_REACH + min(self.robot.lidar.range_max, MAX_RANGE)):
            where = f"goal ({goal[0]:.1f}, {goal[1]:.1f})"
            raise ValueError(f"{where} is {distance:.0f} m from the map; at most {allowed:.0f} m are allowed")

    def initial_pose(self, x: float, y: float, theta: float, covariance: Any = None) -> None:
        """Restart localization on the known map at a pose, map frame [m, m, rad].

        `covariance`: that of the pose, 36 numbers of a `PoseWithCovariance` or shape (3, 3); see `pose_covariance`.

        Raises:
            ValueError: there is no known map, the pose is outside, or a number is implausible; the estimate stays.
        """
        task = self.env.task
        if not isinstance(task, KnownMapBrief):
            raise ValueError(f"an initial pose needs a task on a known map, not {type(task).__name__}")
        begin = task.set_initial_pose if self.has_begun else task.begin_at
        begin(check_numbers("initial pose", (x, y, theta)), pose_covariance(covariance))

    @property
    def has_begun(self) -> bool:
        """Whether the first scan has been used."""
        return self._decide is not None

    @property
    def end_reason(self) -> str | None:
        """Why the policy has nothing more to do; None while it has."""
        return self._policy.end_reason if self.has_begun else None

    @property
    def belief(self) -> Belief:
        """Estimated pose and map."""
        return self.env.belief

    @property
    def plan(self) -> np.ndarray | None:
        """Planned path, shape (n, 2), map frame [m]; None without one."""
        return self.env.overlay.plan

    @property
    def map_to_odometry(self) -> Pose2D:
        """Pose of the odometry frame in the map frame, for `/tf`; without odometry messages, the estimated pose."""
        return self.belief.pose.compose(self._wheels.pose.inverse())

    def command(self, stamp: float, hold: str = "") -> Twist:
        """Return the velocity command at the time `stamp`; a stop, and `reason`, if the robot may not drive.

        `hold`: further reason to stand still, such as a dead man's switch; empty to drive.
        """
        fault, scan = "", None
        try:
            check_numbers("command", (stamp,), STAMP)
            if (scan := self._next_scan()) is not None:
                self._use(*scan)
        except (ImplausibleError, MemoryError) as error:  # or the map would be too large
            fault = str(error) or "out of memory"
        self.reason = fault or self._why_stopped(stamp) or hold
        if not self.reason and scan is not None and self._decide is not None:
            action = self._decide(self._observation)
            if isinstance(action, str):
                self.reason = action
            else:
                self._send(self.env.commands(action))
        if self.reason and self.has_begun:
            self._send(self.env.period.follow(np.zeros((1, 2))))
        return self._command

    def _send(self, commands: np.ndarray) -> None:
        """Begin a control period; the next scan that is used ends it."""
        period = self.env.period
        period.command(commands)
        self._command = Twist(*period.numbers["command"][0].tolist())

    def _receive(self, kind: str, messages: deque[tuple[float, Any]], stamp: float, content: Any) -> None:
        try:
            content = content if kind == "scan" else np.array(check_numbers(kind, content))
            (stamp,), last = check_numbers(kind, (stamp,), STAMP), self._newest.get(kind, -math.inf)
        except ImplausibleError as error:
            self._drop(str(error))
            return
        if stamp < last - MAX_CLOCK_JUMP:
            LOGGER.warning("the clock steps back from %.3f to %.3f s at a message of %s", last, stamp, kind)
            for each in (self._scans, self._wheels.messages, self._rates):
                each.clear()
            self._newest.clear()
            self._stamp = self._scan_stamp = self._jump_stamp = -math.inf
        elif not stamp - last > MIN_STEP:
            self._drop(f"{kind} that is not newer than the last")
            return
        self._newest[kind] = stamp
        messages.append((stamp, content))
        while messages[0][0] < stamp - KEPT:
            messages.popleft()

    def _drop(self, reason: str, count: int = 1) -> None:
        self.dropped[reason] += count
        self._fault = reason

    def _next_scan(self) -> tuple[float, Any] | None:
        messages = self._wheels.messages
        first, newest = (messages[0][0], messages[-1][0]) if messages else (math.inf, -math.inf)
        found = None
        if newest - self._stamp > MIN_PERIOD:
            while self._scans and self._scans[0][0] + self._scans[0][1][1].max() <= newest:
                found = self._scans.popleft()
        if found is not None and found[0] < min(first, self._stamp):
            self._drop("scan before the odometry")
            return None
        return found

    def _use(self, scan_stamp: float, scan: tuple[np.ndarray, np.ndarray]) -> None:
        """Estimate and observe the state at the newest odometry."""
        wheels, is_first = self._wheels, not self.has_begun
        stamp, before, (ranges, delays) = wheels.messages[-1][0], wheels.ticks, scan
        is_paused = not (is_first or stamp - self._stamp <= self.timeout)
        if is_first:
            self._offset = stamp
        elif is_paused:  # or another clock
            self._offset = stamp - self._time - self.env.control_period
        self._time, self._scan_stamp = stamp - self._offset, scan_stamp
        if num_jumps := wheels.advance(self._stamp, self.timeout, self._rates, is_first=is_first):
            self._drop(f"jump of {'encoders' if wheels.uses_encoders else 'odometry'}", num_jumps)
            self._jump_stamp = stamp
        elif scan_stamp + delays.min() >= self._jump_stamp and (scan_stamp != stamp or delays.any()):
            times = scan_stamp + (delays if delays.any() else delays[:1])
            ranges = self._moved(ranges, wheels.poses(np.append(stamp, times)))
        self._steady_stamp = self._steady_stamp if num_jumps else stamp
        rates = [rate for time, rate in self._rates if time <= stamp]
        yaw_rate = float(np.mean(rates)) if rates else 0.0
        elapsed, period = stamp - self._stamp, self.env.control_period
        if is_paused and self.robot.odometry.uses_gyro:  # a period has the turn of the pause, as the wheels' motion
            covered = min(elapsed, stamp - self._rates[0][0] + period) if rates else period
            yaw_rate *= covered / period if wheels.ticks != before else 1.0
            elapsed = period
        if not (rates or is_first):
            (left, right), odometry = np.subtract(wheels.ticks, before), self.robot.odometry
            yaw_rate = float((right - left) * odometry.metres_per_tick / odometry.track / elapsed)
        self.env.simulator.sample = Sample(self._time, ranges, wheels.ticks, yaw_rate, self._touched)
        self._stamp, self._touched, self._fault = stamp, False, ""
        while self._rates and self._rates[0][0] <= stamp:
            self._rates.popleft()
        if is_first:
            rng = np.random.default_rng([self._seed, 1])
            self._observation, _ = begin_episode(self.env, self._policy, self._seed, rng)
            self._decide = decide_with(self._policy, self.env)
        else:
            self.env.period.advance()
            self._observation = self.env.observe()

    def _moved(self, ranges: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Return the ranges of a scan as from the first of `poses`; the others are those of its beams."""
        lidar = self.robot.lidar
        mount, first = lidar.mount, lidar.mount.yaw + lidar.angle_min
        scan = Scan(ranges, first, lidar.angle_increment, lidar.range_min, lidar.range_max, (mount.x, mount.y, mount.z))
        return resampled(scan, (mount.x, mount.y), first, lidar.angle_increment, lidar.num_beams, poses)

    def _why_stopped(self, stamp: float) -> str:
        missing, fault = "odometry" if self._scans else "scan", f" (dropped: {self._fault})" if self._fault else ""
        messages = self._wheels.messages
        if self._scans and messages and (lag := self._scans[0][0] - messages[-1][0]) > self.timeout:
            return f"the stamps of odometry are {lag:.1f} s behind those of scans"
        if not self.has_begun:
            return f"no {missing} yet{fault}"
        if (age := stamp - self._scan_stamp) < -self.timeout:
            return f"the clock of the messages is {-age:.1f} s ahead"
        if not age <= self.timeout:
            return f"no {missing} for {age:.1f} s{fault}"
        if (age := self._stamp - self._steady_stamp) > self.timeout:
            return f"jumps of odometry for {age:.1f} s"
        task = self.env.task
        if task.goal is not None:
            if not task.has_goal:
                return "no goal yet"
            pose, goal = self.belief.pose, task.goal
            turn = abs(wrap_angle(pose.theta - goal.theta))
            is_near = math.dist(pose[:2], goal[:2]) <= task.goal_tolerance and turn <= task.heading_tolerance
            if is_near and not self.belief.is_lost:
                return "reached"
        return ""


def _check_arguments(policy: Any, motion: str, seed: Any, arguments: dict[str, Any]) -> None:
    if motion not in ("odometry", "encoders"):
        raise ValueError(f"motion must be 'odometry' or 'encoders', got {motion!r}")
    if isinstance(policy, PrivilegedPolicy):
        raise ValueError(f"{type(policy).__name__} uses ground truth, which a robot does not have")
    if simulated := sorted({"physics", *MessagesMover.ignores} & arguments.keys()):
        raise TypeError(f"a driver has no arguments {simulated}: they describe a simulation")
    if not (isinstance(seed, int) and seed >= 0):
        raise ValueError(f"seed must be a whole number from 0, got {seed!r}")
