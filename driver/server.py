"""Server of the rosbridge protocol, version 2 (RobotWebTools): topics as JSON over a websocket, without ROS."""

import asyncio
import contextlib
import json
import logging
import math
import re
import threading
import time
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from lidarnaut.envs.files import printable

LOGGER = logging.getLogger(__name__)
MAX_BYTES = 10_000_000
"""Maximum size of a received message, as of rosbridge, whose sender is disconnected, and of what waits for a client."""
QUEUE, MAX_STALL = 1000, 10.0
"""Maximum number of messages that wait for a client (the newest), and maximum time in which it takes none [s]."""
OPERATIONS = ("advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "set_level")
KIND = re.compile(r"(\w+)/(?:msg/)?(\w+)", re.ASCII)


class Client:
    """Connection, and the texts that wait for it."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection, self.level = connection, "error"
        self._waiting: asyncio.Queue[str] = asyncio.Queue()
        self._size = 0

    def put(self, text: str, topic: str = "") -> None:
        """Send a text, or the text of a message of a topic, when the connection takes it."""
        if topic:
            text = f'{{"op": "publish", "topic": {json.dumps(topic)}, "msg": {text}}}'
        self._waiting.put_nowait(text)
        self._size += len(text)
        while self._waiting.qsize() > 1 and (self._waiting.qsize() > QUEUE or self._size > MAX_BYTES):
            self._size -= len(self._waiting.get_nowait())

    def answer(self, data: dict[str, Any], **fields: Any) -> None:
        """Send an object, with the id of the client's one."""
        self.put(json.dumps(fields | {name: data[name] for name in ("id",) if name in data}))

    async def send(self) -> None:
        """Send what waits, until the connection ends or stalls."""
        try:
            while text := await self._waiting.get():
                self._size -= len(text)
                async with asyncio.timeout(MAX_STALL):
                    await self.connection.send(text)
        except TimeoutError:
            LOGGER.warning("client %s takes no messages: disconnected", self.connection.remote_address)
            self.connection.transport.abort()
        except ConnectionClosed:
            pass


class RosbridgeServer:
    """Server of topics, and of `/rosapi/topics`, `topic_type` and `topics_for_type`, in a thread of its own.

    Messages are passed on as they are, but numbers that are not finite become null, and times get the names of ROS 2.
    """

    def __init__(self, port: int = 0, bind: str = "127.0.0.1") -> None:
        """Listen at a port (0: a free one) of a local address; OSError if that is not possible."""
        self._registered: dict[tuple[Client, str, str, str], dict[str, Any]] = {}
        """Type, minimum period and time of the last message [s] by client, operation, topic as it is given, and id."""
        self._latched: dict[tuple[Client, str], str] = {}
        """Last messages, empty before the first, by client and topic."""
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(self._listen(port, bind))
        except (OSError, OverflowError) as error:
            raise OSError(f"port {port} of {bind} cannot be opened: {error}") from None
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(bind, f"[{bind}]" if ":" in bind else bind)
        self.port = self._server.sockets[0].getsockname()[1]
        self.url = f"ws://{host}:{self.port}"
        """Address for clients on this computer."""
        self._thread = threading.Thread(target=self._loop.run_forever, name="rosbridge server", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Disconnect all clients."""
        if self._loop.is_closed():
            return
        self._loop.call_soon_threadsafe(self._server.close)
        with contextlib.suppress(TimeoutError):  # a client that does not answer
            asyncio.run_coroutine_threadsafe(self._server.wait_closed(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _listen(self, port: int, bind: str) -> Server:
        quiet = logging.Logger("websockets", logging.CRITICAL)  # no tracebacks of wrong handshakes
        how: Any = {"compression": None, "max_size": MAX_BYTES, "close_timeout": 1.0, "logger": quiet}
        return await serve(self._handle, bind, port, **how)

    async def _handle(self, connection: ServerConnection) -> None:
        client = Client(connection)
        sending = asyncio.create_task(client.send())
        try:
            async for text in connection:
                self._take(client, text)
        except ConnectionClosed as error:
            LOGGER.info("client %s has left: %s", connection.remote_address, printable(error))
        finally:
            sending.cancel()
            self._registered = {key: each for key, each in self._registered.items() if key[0] is not client}
            self._latched = {key: each for key, each in self._latched.items() if key[0] is not client}

    def _take(self, client: Client, text: str | bytes) -> None:
        data: Any = {}
        try:
            data = json.loads(text, parse_constant=lambda _: None)
            if not isinstance(data, dict) or data.get("op") not in OPERATIONS:
                raise ValueError(f"expected an object with an op of {', '.join(OPERATIONS)}")
            getattr(self, f"_{data['op']}")(client, data)
        except Exception as error:  # the connection stays
            data = data if isinstance(data, dict) else {}
            told = printable(f"{data.get('op', 'message')!s:.40}: {error}")[:500]
            LOGGER.info("client %s: %s", client.connection.remote_address, told)
            if client.level != "none":
                client.answer(data, op="status", level="error", msg=told)

    def _set_level(self, client: Client, data: dict[str, Any]) -> None:
        if data.get("level") in ("none", "error", "warning", "info"):  # others are dropped, by the protocol
            client.level = data["level"]

    def _types(self) -> dict[str, str]:
        return {_full(name): each["kind"] for (_, _, name, _), each in self._registered.items()}

    def _register(self, client: Client, data: dict[str, Any]) -> None:
        name, kind, period = _get(data, "topic", str), _get(data, "type", str, ""), _get(data, "throttle_rate", int, 0)
        if kind and not KIND.fullmatch(kind):
            raise ValueError(f"{kind} is not a valid type string")
        topic, kind = _full(name), KIND.sub(r"\1/msg/\2", kind)
        if not (known := self._types().get(topic, kind)):
            raise ValueError(f"Cannot infer topic type for topic {topic} as it is not yet advertised")
        if kind not in ("", known):
            told = "Tried to register topic {} with type {} but it is already established with type {}"
            raise ValueError(told.format(topic, kind, known))
        key = client, data["op"], name, str(data.get("id"))
        self._registered[key] = {"kind": known, "period": 1e-3 * period, "sent": -math.inf}
        if data["op"] == "advertise" and data.get("latch"):
            self._latched.setdefault((client, topic), "")
        for (_, latched), message in self._latched.items():
            if data["op"] == "subscribe" and latched == topic and message:
                client.put(message, name)

    _advertise = _subscribe = _register

    def _unregister(self, client: Client, data: dict[str, Any]) -> None:
        name, operation = _get(data, "topic", str), data["op"].removeprefix("un")
        for key in [key for key in self._registered if key[:3] == (client, operation, name)]:
            if "id" not in data or key[3] == str(data["id"]):
                del self._registered[key]
        if operation == "advertise":
            self._latched.pop((client, _full(name)), None)

    _unadvertise = _unsubscribe = _unregister

    def _publish(self, client: Client, data: dict[str, Any]) -> None:
        topic, now = _full(_get(data, "topic", str)), time.monotonic()
        message = json.dumps(_get(data, "msg", dict, {}), allow_nan=False)
        message = message.replace('"secs":', '"sec":').replace('"nsecs":', '"nanosec":')
        if topic not in self._types():
            raise ValueError(f"Cannot infer topic type for topic {topic} as it is not yet advertised")
        if data.get("latch") or (client, topic) in self._latched:
            self._latched[client, topic] = message
        due = {}
        for key, each in self._registered.items():
            if key[1] == "subscribe" and _full(key[2]) == topic and now - each["sent"] >= each["period"]:
                each["sent"], due[key[0], key[2]] = now, True
        for subscriber, name in due:
            subscriber.put(message, name)

    def _call_service(self, client: Client, data: dict[str, Any]) -> None:
        service, types, args = _get(data, "service", str), self._types(), data.get("args") or {}
        given = str([*(args.values() if isinstance(args, dict) else args), ""][0])
        of_type = [name for name in types if types[name] == KIND.sub(r"\1/msg/\2", given)]
        answers = {
            "/rosapi/topics": {"topics": [*types], "types": [*types.values()]},
            "/rosapi/topic_type": {"type": types.get(_full(given), "")},
            "/rosapi/topics_for_type": {"topics": of_type},
        }
        values = answers.get(_full(service), f"Service {service} does not exist")
        client.answer(data, op="service_response", service=service, values=values, result=_full(service) in answers)


def _full(name: str) -> str:
    return "/" + name.lstrip("/")


def _get(data: dict[str, Any], name: str, kind: type, default: Any = None) -> Any:
    if not isinstance(value := data.get(name, default), kind):
        raise ValueError(f"expected a field {name} of type {kind.__name__}, got {value!r:.80}")
    return value
