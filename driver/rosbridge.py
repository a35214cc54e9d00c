"""Client of the rosbridge protocol, version 2: ROS topics as JSON over a websocket, for ROS 1 and ROS 2."""

import asyncio
import contextlib
import dataclasses
import json
import logging
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from types import SimpleNamespace
from typing import Any

import numpy as np

from lidarnaut.envs.files import printable

try:
    from websockets.asyncio.client import ClientConnection, connect
    from websockets.exceptions import ConnectionClosed
    from websockets.frames import CloseCode
except ImportError as error:
    raise ImportError("rosbridge needs websockets: pip install 'lidarnaut[ros]'") from error

LOGGER = logging.getLogger(__name__)
RETRY_PERIOD = 1.0
"""Time between attempts to connect [s]."""
PING_PERIOD, MAX_SILENCE = 0.5, 2.0
"""Time between pings, and maximum time without an answer before the connection counts as lost [s]."""
CLOSE_TIMEOUT = 1.0
"""Maximum time for the server's half of closing a connection [s]."""
PATIENCE, ASK_PERIOD = 3.0, 0.5
"""Topics without a message for this time after a connection are named, and time between them [s]."""
MAX_BYTES = 16 * 2**20
"""Maximum size of a received message."""
MAX_WAITING, MAX_SIZE = 2000, 2 * MAX_BYTES
"""Maximum number of messages that wait for their receiver, or of one topic to be sent, and size of all that wait for
their receiver; the oldest are dropped."""
MAX_SAID, MAX_TEXT, QUIET = 100, 300, 5.0
"""Maximum number of different warnings, length of a text of the server, and time without a warning until it is given
again [s]."""
ROS1 = {"sec": "secs", "nanosec": "nsecs"}
"""Names of ROS 1 for fields of times and durations of ROS 2."""
ROS2 = {other: name for name, other in ROS1.items()}
ROS2_ONLY = {"texture_resource", "texture", "uv_coordinates", "mesh_file"}
"""Unused fields of `visualization_msgs/Marker` that ROS 1 does not have."""
Receive = Callable[[Any], None]


class Rosbridge:
    """Connection to a rosbridge server, in a thread of its own; a lost connection is opened again.

    Topics are advertised and subscribed to anew after each connection, and latched messages are sent again. Received
    messages wait for `spin`, whose thread calls their receivers.
    """

    def __init__(
        self,
        url: str,
        namespace: str = "",
        *,
        expected: Collection[str] = (),
        is_ready: Callable[[], bool] = lambda: True,
        on_status: Callable[[str], None] | None = None,
    ) -> None:
        """Begin to connect.

        Args:
            url: address of the server, such as `ws://robot:9090`.
            namespace: prefix of all topics except `/clock`.
            expected: subscribed topics that are named if no message arrives.
            is_ready: whether the connection may be opened; asked again until it may.
            on_status: called with errors and warnings that the server sends; by default, they are logged.

        Raises:
            ValueError: the URL does not begin with `ws://` or `wss://`.
        """
        if not url.startswith(("ws://", "wss://")):
            raise ValueError(f"url must begin with ws:// or wss://, such as ws://robot:9090, got {url!r}")
        self.url, self._namespace = url, f"/{name}" if (name := namespace.strip("/")) else ""
        self.error = "not connected yet"
        """Why there is no connection; empty while connected."""
        self._expected, self._is_ready = {self._full(topic) for topic in expected}, is_ready
        self._unheard, self._patience_ends = set[str](), math.inf
        self._warn = said_once(LOGGER.warning)
        self._on_status = on_status or (lambda text: self._warn(f"the rosbridge server says: {text}"))
        self._receivers: dict[str, Receive] = {}
        self._inbox, self._inbox_size, self._lock = deque[str | bytes](), 0, threading.Lock()
        # The rest is used by the thread alone.
        self._topics: dict[tuple[str, str], dict[str, Any]] = {}
        self._latched: dict[str, dict[str, Any]] = {}
        self._outgoing: dict[str, deque[dict[str, Any]]] = {}
        self._refused, self._largest = set[str](), (0, "")
        self._loop, self._wake, self._closing = asyncio.new_event_loop(), asyncio.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def advertise(self, topic: str, kind: str, latch: bool = False) -> None:
        """Announce a topic of a type such as `std_msgs/msg/Bool`; of a latched one, the newest message is kept."""
        self._register(op="advertise", topic=self._full(topic), type=kind.replace("/msg/", "/"), latch=latch)

    def subscribe(self, topic: str, kind: str, receive: Receive) -> None:
        """Let `spin` call `receive` with each message of a topic, an object with the message's fields."""
        self._receivers[self._full(topic)] = receive
        self._register(op="subscribe", topic=self._full(topic), type=kind.replace("/msg/", "/"))

    def publish(self, topic: str, message: Any) -> None:
        """Send a message, from `lidarnaut.envs.logs.messages`, later and in order; never waits.

        A function is called when its turn comes, and returns the message. Without a connection, only latched messages
        are kept. The message must not change afterwards.
        """
        self._call(self._put, self._full(topic), message)

    def ask(self, service: str, args: dict[str, str], receive: Receive) -> None:
        """Call a service of the server; `receive` gets the values of its answer, if there is one."""
        self._receivers[service] = receive
        self._call(self._send, {"op": "call_service", "service": service, "args": args, "id": service})

    def spin(self) -> None:
        """Call the receivers of the messages that have arrived, which may take their time; never waits."""
        with self._lock:
            texts, self._inbox, self._inbox_size = self._inbox, deque(), 0
        for text in texts:
            self._receive(text)
        if self._unheard and not self.error and time.monotonic() > self._patience_ends:
            self._patience_ends += ASK_PERIOD
            self._name(min(self._unheard))

    def close(self) -> None:
        """Send what waits to be sent, for at most a second, close the connection and end the thread."""
        self._call(self._closing.set)
        self._thread.join(4.0 * CLOSE_TIMEOUT)

    def _full(self, topic: str) -> str:
        return topic if topic == "/clock" else self._namespace + topic

    def _call(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Let the thread call a function."""
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *arguments)
            self._loop.call_soon_threadsafe(self._wake.set)

    def _register(self, **data: Any) -> None:
        self._call(self._keep, data)
        self._call(self._send, data)

    def _keep(self, data: dict[str, Any]) -> None:
        self._topics[data["op"], data["topic"]] = data
        if data["op"] == "subscribe" and data["topic"] in self._expected and not self.error:
            self._patience_ends = time.monotonic() + PATIENCE
            self._unheard.add(data["topic"])

    def _send(self, data: dict[str, Any]) -> None:
        if not self.error:
            self._outgoing.setdefault("", deque()).append(data)

    def _put(self, topic: str, message: Any) -> None:
        if topic in self._refused:
            return
        is_latched = self._topics["advertise", topic]["latch"]  # rosbridge warns if messages do not repeat it
        data = {"op": "publish", "topic": topic, "msg": message, "latch": is_latched}
        if is_latched:
            self._latched[topic] = data
        if not self.error:
            self._outgoing.setdefault(topic, deque(maxlen=1 if is_latched else MAX_WAITING)).append(data)

    def _take(self) -> dict[str, Any]:
        """Return what is to be sent next: operations first, then one message of each topic in turn."""
        topic = "" if "" in self._outgoing else next(iter(self._outgoing))
        waiting = self._outgoing.pop(topic)
        data = waiting.popleft()
        if waiting:
            self._outgoing[topic] = waiting
        return data | {"msg": data["msg"]()} if callable(data.get("msg")) else data

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._connect())
        self._loop.close()

    async def _connect(self) -> None:
        inform, pause = said_once(LOGGER.info), 0.05
        how: Any = {"open_timeout": 2.0, "close_timeout": CLOSE_TIMEOUT, "compression": None, "max_size": MAX_BYTES}
        how |= {"ping_interval": PING_PERIOD, "ping_timeout": MAX_SILENCE}
        while not self._closing.is_set():
            if self._is_ready():
                try:
                    async with connect(self.url, **how) as socket:
                        if self._receivers:
                            inform(f"connected to {self.url}")
                        await self._use(socket)
                    reason = "the server has closed the connection"
                except Exception as error:  # also those of a connection that is reset while it closes
                    reason = f"{type(error).__name__}: {shortened(error)}"
                    if _is_too_big(error):
                        size, topic = self._largest
                        reason = f"messages of {size} bytes are too large for the server"
                        self._refused.add(topic)
                        self._latched.pop(topic, None)
                self.error = reason
                self._outgoing.clear()
                if not self._closing.is_set():
                    self._warn(f"no connection to {self.url}: {reason}")
                pause = RETRY_PERIOD
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), pause)

    async def _use(self, socket: ClientConnection) -> None:
        self._outgoing = {topic: deque([data], maxlen=1) for topic, data in self._latched.items()}
        if self._topics:
            self._outgoing[""] = deque(self._topics.values())
        self._patience_ends = time.monotonic() + PATIENCE
        self._unheard = {topic for topic in self._expected if ("subscribe", topic) in self._topics}
        self._largest, self.error = (0, ""), ""
        reading = asyncio.create_task(self._read(socket))
        reading.add_done_callback(_take_error)
        reading.add_done_callback(lambda _: self._wake.set())
        while not reading.done() and (self._outgoing or not self._closing.is_set()):
            while self._outgoing:
                await self._write(socket, self._take())
            await self._wake.wait()
            self._wake.clear()
        if reading.done():
            reading.result()

    async def _read(self, socket: ClientConnection) -> None:
        async for text in socket:
            with self._lock:
                self._inbox.append(text)
                self._inbox_size += len(text)
                while len(self._inbox) > MAX_WAITING or self._inbox_size > MAX_SIZE:
                    self._inbox_size -= len(self._inbox.popleft())

    async def _write(self, socket: ClientConnection, data: dict[str, Any]) -> None:
        """Send a message; end the connection if nothing of it leaves for `MAX_SILENCE`."""
        try:
            text = json.dumps(to_json(data))
        except (TypeError, ValueError, RecursionError) as error:
            LOGGER.warning("%s: a message cannot be sent: %s", data.get("topic"), error)
            return
        self._largest = max(self._largest, (len(text), data.get("topic", "")))
        sending, left = asyncio.ensure_future(socket.send(text)), math.inf
        sending.add_done_callback(_take_error)
        while not (await asyncio.wait({sending}, timeout=0.75 * MAX_SILENCE))[0]:
            if (size := socket.transport.get_write_buffer_size()) >= left:
                socket.transport.abort()
                raise ConnectionError(f"the server takes no data, with {size} bytes left")
            left = size
        sending.result()

    def _receive(self, text: str | bytes) -> None:
        try:
            data, name, content = json.loads(text), "", None
            if data["op"] == "publish":
                name, content = data["topic"], data["msg"]
            elif data["op"] == "service_response":
                name, content = data["service"], data.get("values")
            elif data["op"] == "status" and data.get("level") in ("error", "warning"):
                self._on_status(shortened(data.get("msg")))
            receive = self._receivers.get(name)
            message = from_json(content) if receive else None
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            self._warn(f"a message that is not of the rosbridge protocol: {type(error).__name__}: {shortened(error)}")
            return
        if receive is None:
            return
        self._unheard.discard(name)
        try:
            receive(message)
        except Exception as error:  # other messages are still received
            self._warn(f"{printable(name)}: messages are dropped: {type(error).__name__}: {shortened(error)}")

    def _name(self, topic: str) -> None:
        """Say that a topic has no messages, and which topics have its type."""
        self._unheard.discard(topic)
        kind = self._topics["subscribe", topic]["type"]
        LOGGER.warning("no message on %s (%s) for %g s", topic, kind, PATIENCE)

        def say(found: Any) -> None:
            names = getattr(found, "topics", None) or ()
            told = found if isinstance(found, str) else ", ".join(map(str, names)) or "none"  # a text is an error
            self._warn(f"topics of type {kind}: {shortened(told)}")

        self.ask("/rosapi/topics_for_type", {"type": kind}, say)


def _take_error(task: asyncio.Future[None]) -> None:
    """Keep asyncio from printing the error of a task that nobody waits for."""
    _ = task.cancelled() or task.exception()


def _is_too_big(error: BaseException | None) -> bool:
    """Return whether a server has closed the connection because of a message's size.

    Leaving the context of websockets 17.4 may raise AttributeError, with the reason as its context alone.
    """
    while error is not None:
        if isinstance(error, ConnectionClosed) and error.rcvd and error.rcvd.code == CloseCode.MESSAGE_TOO_BIG:
            return True
        error = error.__context__
    return False


def shortened(text: object) -> str:
    """Return the first characters of a text, printable and in one line."""
    return printable(" ".join(str(text)[:MAX_TEXT].split()))[:MAX_TEXT]


def without_numbers(text: str) -> str:
    """Return a text without digits, signs and points, to compare texts."""
    return re.sub(r"[-+.\d]", "", text)


def said_once(say: Callable[[str], None]) -> Callable[[str], None]:
    """Return a function that says a text, unless one that differs only by numbers came in the last `QUIET` seconds."""
    last = dict[str, float]()

    def say_once(text: str) -> None:
        key, now = without_numbers(text), time.monotonic()
        if (before := last.get(key, -math.inf if len(last) < MAX_SAID else math.inf)) < math.inf:
            last[key] = now
        if now - before > QUIET:
            say(text)

    return say_once


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
    if isinstance(value, dict):
        return {name: to_json(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def from_json(value: Any) -> Any:
    """Return JSON data of a ROS message as an object with the message's fields, with the names of ROS 2."""
    if isinstance(value, dict):
        return SimpleNamespace(**{ROS2.get(str(name), str(name)): from_json(each) for name, each in value.items()})
    is_list = isinstance(value, list) and len(value) > 0 and isinstance(value[0], dict)
    return [from_json(each) for each in value] if is_list else value
