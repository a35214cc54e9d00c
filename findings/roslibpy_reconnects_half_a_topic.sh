#!/usr/bin/env bash
# roslibpy 2.1.0: a Topic that subscribes and publishes has no subscription after the connection was lost.
#
# Topics reconnect by themselves (`reconnect_on_close=True`), but each keeps only its last request: a Topic that has
# subscribed and then published sends its `advertise` again, and never its `subscribe`. Its `is_subscribed` stays True, and
# its callback gets no more messages. Two Topics, one for each direction, reconnect both.
#
# Seen: {"one Topic": ["advertise"], "two Topics": ["advertise", "subscribe"], "is_subscribed": true} (sent again)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet roslibpy==2.1.0 autobahn==26.10.2 twisted==26.10.0 websockets==17.4
"$folder/venv/bin/python" - <<'PYTHON'
import json
import logging
import sys
import threading
import time

import roslibpy
from websockets.sync.server import serve

connections = []


def handle(socket):
    requests = []
    connections.append((socket, requests))
    for text in socket:
        request = json.loads(text)
        requests.append((request["topic"], request["op"]))


def wait_for(connection, request):
    end = time.monotonic() + 60
    while len(connections) <= connection or request not in connections[connection][1]:
        assert time.monotonic() < end
        time.sleep(0.01)


logging.getLogger("websockets").setLevel(logging.CRITICAL)
server = serve(handle, "localhost", 0)
threading.Thread(target=server.serve_forever, daemon=True).start()
ros = roslibpy.Ros("localhost", server.socket.getsockname()[1])
ros.run()
both, publisher, subscriber, last = (
    roslibpy.Topic(ros, name, "std_msgs/Empty") for name in ("/one", "/two", "/two", "/last")
)
for topic in (both, subscriber):
    topic.subscribe(lambda message: None)
for topic in (both, publisher):
    topic.publish({})
last.subscribe(lambda message: None)
wait_for(0, ("/last", "subscribe"))
connections[0][0].close()
wait_for(1, ("/last", "subscribe"))
time.sleep(2)
requests = sorted(connections[1][1])
found = {
    "one Topic": [op for name, op in requests if name == "/one"],
    "two Topics": [op for name, op in requests if name == "/two"],
    "is_subscribed": both.is_subscribed,
}
print(json.dumps(found))
ros.terminate()
sys.exit(found != {"one Topic": ["advertise"], "two Topics": ["advertise", "subscribe"], "is_subscribed": True})
PYTHON
