"""Server of the rosbridge protocol that notes what it receives."""

import contextlib
import json
import threading
import time

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from lidarnaut.driver.rosbridge import to_json


class Recorder:
    """Server that notes what it receives, and answers with given texts."""

    def __init__(self, answer=lambda data: None, max_size=2**26):
        self.data, self.sockets, self._answer = [], [], answer
        self.timed_commands = []
        """Time of arrival [s], v and w of each command."""
        self._subscribers = {}
        self._server = serve(self._handle, "127.0.0.1", 0, compression=None, max_size=max_size)
        self.url = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _handle(self, socket):
        self.sockets.append(socket)
        with contextlib.suppress(ConnectionClosed):
            for text in socket:
                self.data.append(data := json.loads(text))
                if data["op"] == "publish" and data["topic"] == "/cmd_vel":
                    twist = data["msg"].get("twist", data["msg"])
                    self.timed_commands.append((time.monotonic(), twist["linear"]["x"], twist["angular"]["z"]))
                if data["op"] == "subscribe":
                    self._subscribers.setdefault(data["topic"], []).append(socket)
                if (told := self._answer(data)) is not None:
                    socket.send(json.dumps(told))

    def publish(self, topic, message):
        """Send a message to its subscribers."""
        text = json.dumps({"op": "publish", "topic": topic, "msg": to_json(message)})
        for socket in list(self._subscribers.get(topic, ())):
            try:
                socket.send(text)
            except (ConnectionClosed, OSError):
                self._subscribers[topic].remove(socket)

    @property
    def commands(self):
        return [each[1:] for each in self.timed_commands]

    def advertised(self, topic):
        return [each["type"] for each in self.data if each["op"] == "advertise" and each["topic"] == topic]

    def close(self):
        self._server.shutdown()
        for socket in self.sockets:
            socket.close()
