"""Client of the rosbridge protocol, version 2: ROS topics as JSON over a websocket, for ROS 1 and ROS 2."""

import dataclasses
import json
import logging
import math
import signal
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from lidarnaut.envs.command_line import run_command

try:
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import ClientConnection, connect
except ImportError as error:
    raise ImportError("rosbridge needs websockets: pip install 'lidarnaut[ros]'") from error

LOGGER = logging.getLogger(__name__)
RETRY_PERIOD = 1.0
"""Time between attempts to connect [s]."""
PING_PERIOD, MAX_SILENCE = 0.5, 2.0
"""Time between pings, and maximum time without an answer before the connection counts as lost [s]."""
MAX_BYTES = 64 * 2**20
"""Maximum size of a received message."""
ROS1 = {"sec": "secs", "nanosec": "nsecs"}
"""Names of ROS 1 for fields of times and durations of ROS 2."""
ROS2 = {other: name for name, other in ROS1.items()}
ROS2_ONLY = {"texture_resource", "texture", "uv_coordinates", "mesh_file"}
"""Unused fields of `visualization_msgs/Marker` that ROS 1 does not have."""
Receive = Callable[[Any], None]


class Rosbridge:
    """Connection to a rosbridge server, in a thread of its own; a lost connection is opened again.

    Topics are advertised and subscribed to anew after each connection. `latched` messages are sent again as well.
    """

    def __init__(self, url: str, namespace: str = "") -> None:
        """Begin to connect; ValueError unless `url` begins with `ws://` or `wss://`, such as `ws://robot:9090`.

        `namespace`: prefix of all topics except `/clock`.
        """
        if not url.startswith(("ws://", "wss://")):
            raise ValueError(f"url must begin with ws:// or wss://, such as ws://robot:9090, got {url!r}")
        self.url, self._namespace = url, f"/{name}" if (name := namespace.strip("/")) else ""
        self.error = "not connected yet"
        """Why there is no connection; empty while connected."""
        self._socket: ClientConnection | None = None
        self._topics: dict[str, dict[str, Any]] = {}
        self._receivers: dict[str, Receive] = {}
        self._latched: dict[str, dict[str, Any]] = {}
        self._is_closed = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="rosbridge", daemon=True)
        self._thread.start()

    def _full(self, topic: str) -> str:
        return topic if topic == "/clock" else self._namespace + topic

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        topic = self._full(topic)
        self._register({"op": "advertise", "topic": topic, "type": kind.replace("/msg/", "/"), "latch": latch})

    def subscribe(self, topic: str, kind: str, receive: Receive) -> None:
        """Call `receive` with each message of a topic, an object with the message's fields, in the client's thread."""
        topic = self._full(topic)
        self._receivers[topic] = receive
        self._register({"op": "subscribe", "topic": topic, "type": kind.replace("/msg/", "/"), "queue_length": 1})

    def publish(self, topic: str, message: Any) -> None:
        """Send a message, from `lidarnaut.envs.logs.messages`; without a connection, only latched ones are kept."""
        topic = self._full(topic)
        is_latched = self._topics[f"advertise {topic}"]["latch"]
        data = {"op": "publish", "topic": topic, "msg": to_json(message), "latch": is_latched}
        if is_latched:
            self._latched[topic] = data
        self._send(data)

    def close(self) -> None:
        """Close the connection and end the thread."""
        self._is_closed.set()
        if (socket := self._socket) is not None:
            socket.close()
        self._thread.join()

    def _register(self, data: dict[str, Any]) -> None:
        self._topics[f"{data['op']} {data['topic']}"] = data
        self._send(data)

    def _send(self, data: dict[str, Any]) -> None:
        with self._lock:
            if self._socket is not None:
                try:
                    self._socket.send(json.dumps(data))
                except (OSError, WebSocketException) as error:
                    self.error = f"{type(error).__name__}: {error}"

    def _run(self) -> None:
        said = ""
        while not self._is_closed.is_set():
            try:
                how: Any = {"ping_interval": PING_PERIOD, "ping_timeout": MAX_SILENCE, "max_size": MAX_BYTES}
                with connect(self.url, open_timeout=2.0, compression=None, **how) as socket:
                    for data in (*self._topics.values(), *self._latched.values()):
                        socket.send(json.dumps(data))
                    self._socket, self.error = socket, ""
                    if self._is_closed.is_set():
                        return
                    said = ""
                    LOGGER.info("connected to %s", self.url)
                    for text in socket:
                        self._receive(text)
                self.error = "the server has closed the connection"
            except (OSError, WebSocketException) as error:
                self.error = f"{type(error).__name__}: {error}"
            self._socket = None
            if not self._is_closed.is_set() and self.error != said:
                LOGGER.warning("no connection to %s: %s", self.url, self.error)
            said = self.error
            self._is_closed.wait(RETRY_PERIOD)

    def _receive(self, text: str | bytes) -> None:
        try:
            data = json.loads(text)
            receive = self._receivers[data["topic"]] if data["op"] == "publish" else None
            message = from_json(data["msg"]) if receive else None
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            LOGGER.warning("a message that is not of the rosbridge protocol: %s: %s", type(error).__name__, error)
            return
        if receive is not None:
            try:
                receive(message)
            except Exception as error:  # other messages are still received
                LOGGER.warning("%s: a message is dropped: %s: %s", data["topic"], type(error).__name__, error)


def to_json(value: Any) -> Any:
    """Return a ROS message as JSON data; numbers that are not finite become null, as rosbridge sends them.

    Stamps have the names of ROS 1, which rosbridge for ROS 2 accepts as well; fields that ROS 1 does not know are left
    out.
    """
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        names = [name for name in names if not (name.startswith("_") or name.isupper() or name in ROS2_ONLY)]
        return {ROS1.get(name, name): to_json(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f":
            return [number if math.isfinite(number) else None for number in value.astype(np.float64).tolist()]
        return value.tolist()
    if isinstance(value, list | tuple):
        return [to_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def from_json(value: Any) -> Any:
    """Return JSON data of a ROS message as an object with the message's fields, with the names of ROS 2."""
    if isinstance(value, dict):
        return SimpleNamespace(**{ROS2.get(str(name), str(name)): from_json(each) for name, each in value.items()})
    is_list = isinstance(value, list) and len(value) > 0 and isinstance(value[0], dict)
    return [from_json(each) for each in value] if is_list else value


class Clock:
    """Time of the robot's messages, between messages and without synchronized computers.

    The offset between stamps and the local clock is the largest one of the last `WINDOW` seconds, which belongs to the
    fastest message; a delay that all messages share cannot be seen.
    """

    WINDOW = 10.0

    def __init__(self) -> None:
        self._offsets: list[tuple[float, float]] = []

    def note(self, stamp: float) -> None:
        """Note the stamp of a message that has just arrived [s]."""
        now = time.monotonic()
        kept = [each for each in self._offsets if now - each[0] < self.WINDOW and each[1] > stamp - now]
        self._offsets = [*kept, (now, stamp - now)]

    @property
    def time(self) -> float:
        """Estimated time of the robot's clock [s]; NaN before the first message."""
        return time.monotonic() + self._offsets[0][1] if self._offsets else math.nan


def run_program(main: Callable[[Any], None], options: type) -> None:
    """Run a program with options of the command line; SIGTERM ends it like Ctrl-C."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    run_command(main, options=options, status=1)
