"""Velocity commands with a deadline of their own: a process that stops the robot if decisions do not arrive in time."""

import contextlib
import json
import logging
import os
import re
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from typing import Any

from .rosbridge import Rosbridge, said_once, shortened

LOGGER = logging.getLogger(__name__)
TWIST = "geometry_msgs/msg/Twist"
DECISION = struct.Struct("<4d")
"""Forward speed [m/s], yaw rate [rad/s], time of the robot's clock and local time of a decision [s]."""
NEVER = 0.0, 0.0, 0.0, 0.0
"""Values before the first decision."""
RECORDS = 128
"""Maximum number of decisions that are read at once; pipes pass each one on as a whole."""
STOPS, BETWEEN_STOPS = 3, 0.05
"""Number of stops at the end, and time between them [s]."""
ENDED = "the process that sends commands has ended"


def local_time() -> float:
    """Return a time that all processes of this computer share, and that goes on while it sleeps [s]."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


@dataclass(frozen=True)
class CommandTopic:
    """Where and how commands are sent."""

    topic: str = "/cmd_vel"
    stamped: bool = False
    """Whether commands are TwistStamped instead of Twist."""
    frame: str = "base_footprint"
    """Frame of commands that are stamped."""
    url: str = ""
    namespace: str = ""
    period: float = 0.1
    """Time between commands [s]."""
    timeout: float = 1.0
    """Decisions hold for this time; then the robot is stopped [s]."""


class BridgeCommands:
    """Commands through a given connection."""

    error = ""

    def __init__(self, bridge: Any, target: CommandTopic) -> None:
        """Advertise the topic."""
        self._bridge, self._target, self._stamp = bridge, target, 0.0
        self._advertise(target.stamped)

    def _advertise(self, is_stamped: bool) -> None:
        self._is_stamped = is_stamped
        self._bridge.advertise(self._target.topic, f"{TWIST}Stamped" if is_stamped else TWIST)

    def use_type(self, text: str) -> bool:
        """Take the last type of twists that a text of the server names; return whether it is another one."""
        found = re.findall(r"geometry_msgs/(?:msg/)?Twist(Stamped)?\b", text)
        if not found or bool(found[-1]) == self._is_stamped:
            return False
        self._advertise(not self._is_stamped)
        return True

    def send(self, command: tuple[float, float], stamp: float, decided: float = 0.0) -> None:
        """Send a command (v, w) [m/s, rad/s] with a stamp of the robot's clock [s]."""
        self._bridge.publish(self._target.topic, self.message(command, stamp))

    def message(self, command: tuple[float, float], stamp: float) -> dict[str, Any]:
        """Return the message of a command, see `send`."""
        self._stamp, (v, w) = stamp, command
        twist = {"linear": {"x": v, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": w}}
        if not self._is_stamped:
            return twist
        seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
        header = {"stamp": {"secs": seconds, "nsecs": nanoseconds}, "frame_id": self._target.frame}
        return {"header": header, "twist": twist}

    def close(self) -> None:
        """Send stops."""
        for _ in range(STOPS):
            self.send((0.0, 0.0), self._stamp)
            time.sleep(BETWEEN_STOPS)


class CommandProcess:
    """Commands through a connection of a process of its own.

    It repeats the newest decision at the control rate, and sends stops if there is none younger than the timeout:
    also while this process computes, compiles, waits for a disk or a terminal, is stopped, or has ended.
    """

    def __init__(self, target: CommandTopic) -> None:
        """Start the process."""
        self.error = "not connected yet"
        """Why no commands are sent; empty while they are."""
        command = [sys.executable, "-m", "lidarnaut.driver.commands", json.dumps(asdict(target))]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        self._input: Any = self._process.stdin
        os.set_blocking(self._input.fileno(), False)  # type: ignore[union-attr]
        self._thread = threading.Thread(target=self._listen, args=(self._process.stdout,), daemon=True)
        self._thread.start()

    def send(self, command: tuple[float, float], stamp: float, decided: float) -> None:
        """Pass a decision on; never waits. `decided`: time of `local_time` at which its computation began [s].

        Raises:
            RuntimeError: the process has ended by itself.
        """
        try:
            self._input.write(DECISION.pack(*command, stamp, decided))
        except BrokenPipeError:
            raise RuntimeError(ENDED) from None

    def close(self) -> None:
        """Let the process send stops and end."""
        self._input.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._thread.join(1.0)

    def _listen(self, output: Any) -> None:
        for line in output:
            told = json.loads(line)
            self.error = told.get("error", self.error)
            if text := told.get("log"):
                LOGGER.warning("%s", text)
        self.error = ENDED


class _Sender(BridgeCommands):
    """The work of the process."""

    def __init__(self, target: CommandTopic) -> None:
        super().__init__(Rosbridge(target.url, target.namespace, on_status=self._on_status), target)
        self._newest, self._log = NEVER, said_once(lambda text: self._tell(log=text))

    def _tell(self, **what: str) -> None:
        with contextlib.suppress(OSError):  # the driver has ended, or does not read
            os.write(1, json.dumps(what).encode() + b"\n")

    def _on_status(self, text: str) -> None:
        self._log(f"the rosbridge server says: {text}")
        if self._target.topic in text:
            self._take_type(text)

    def _take_type(self, text: str) -> None:
        if self.use_type(text):
            self._tell(log=f"commands are sent with the type of {self._target.topic} that the server names: {text}")

    def _current(self) -> dict[str, Any]:
        """Return the command at the time at which it is sent: this process may have stood still in between."""
        v, w, stamp, decided = self._newest
        age = local_time() - decided
        return self.message((v, w) if age <= self._target.timeout else (0.0, 0.0), stamp + age)

    def run(self) -> None:
        """Send commands until the input ends, then stops."""
        said = "not connected yet"
        while True:
            if select.select([0], [], [], self._target.period)[0]:
                if not (records := os.read(0, RECORDS * DECISION.size)):
                    break
                self._newest = DECISION.unpack(records[-DECISION.size :])
            if self._newest != NEVER:
                self._bridge.publish(self._target.topic, self._current)
            self._bridge.spin()
            if self._bridge.error != said:
                said = self._bridge.error
                self._tell(error=said)
                topic = {"topic": self._target.topic}
                self._bridge.ask("/rosapi/topic_type", topic, lambda found: self._take_type(shortened(found.type)))
        if self._newest != NEVER:
            self.close()
        self._bridge.close()


if __name__ == "__main__":
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # of the whole group; the end of the input counts
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    os.set_blocking(1, False)
    logging.disable()  # a terminal that stands still must not hold up commands: texts go to the driver
    _Sender(CommandTopic(**json.loads(sys.argv[1]))).run()
