"""Small rosbridge server: passes published messages to subscribers."""

import contextlib
import json
import threading

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve


class Broker:
    """Server of advertise, subscribe and publish, with latched topics, in threads of its own."""

    def __init__(self, port=0):
        self._lock, self._subscribers, self._latched, self._sockets = threading.Lock(), {}, {}, set()
        self.log = []
        self._latching = set()
        self._server = serve(self._handle, "localhost", port, compression=None, max_size=2**26)
        self.port = self._server.socket.getsockname()[1]
        self.url = f"ws://localhost:{self.port}"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def _handle(self, socket):
        with self._lock:
            self._sockets.add(socket)
        with contextlib.suppress(ConnectionClosed):
            for text in socket:
                self._take(socket, json.loads(text))
        with self._lock:
            self._sockets.discard(socket)
            for sockets in self._subscribers.values():
                sockets.discard(socket)

    def _take(self, socket, data):
        operation, topic = data["op"], data["topic"]
        with self._lock:
            if operation == "advertise" and data.get("latch"):
                self._latching.add(topic)
            if operation == "subscribe":
                self._subscribers.setdefault(topic, set()).add(socket)
                sent = [(socket, self._latched[topic])] if topic in self._latched else []
            elif operation == "publish":
                if topic in self._latching:
                    self._latched[topic] = data
                sent = [(each, data) for each in self._subscribers.get(topic, ())]
            else:
                sent = []
        for each, message in sent:
            with contextlib.suppress(ConnectionClosed):
                each.send(json.dumps(message))

    def close(self):
        with self._lock:
            sockets = list(self._sockets)
        self._server.shutdown()
        for socket in sockets:
            socket.close()
        self._thread.join()
