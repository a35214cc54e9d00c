#!/usr/bin/env bash
# roslibpy 2.1.0: `unsubscribe` of one Topic silences every other Topic of this name.
#
# Two parts of a program that listen to `/odom` have a Topic each, with a callback each. If one unsubscribes, the callbacks
# of both are removed, since callbacks are kept by the name of the topic. The request to the server carries the id of the
# first subscription alone, so that messages for the second still arrive, and are dropped. Its `is_subscribed` is True.
# A program has one Topic for each name, and passes its messages on itself.
#
# Seen: {"before": [1, 1], "after": [1, 1], "is_subscribed": [false, true]}
#       (messages that the two Topics have got; one is sent before, and one after)
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

sockets, received = [], []


def handle(socket):
    sockets.append(socket)
    for text in socket:
        received.append(json.loads(text))


def publish(topic):
    sockets[0].send(json.dumps({"op": "publish", "topic": topic, "msg": {}}))


def wait(condition):
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


logging.getLogger("websockets").setLevel(logging.CRITICAL)
server = serve(handle, "localhost", 0)
threading.Thread(target=server.serve_forever, daemon=True).start()
ros = roslibpy.Ros("localhost", server.socket.getsockname()[1])
ros.run()
one, two = (roslibpy.Topic(ros, "/odom", "nav_msgs/Odometry") for _ in range(2))
end = roslibpy.Topic(ros, "/end", "std_msgs/Empty")
counts = {one: [], two: [], end: []}
for topic, messages in counts.items():
    topic.subscribe(messages.append)
wait(lambda: len(received) == 3)
publish("/odom")
publish("/end")
wait(lambda: len(counts[end]) == 1)
found = {"before": [len(counts[one]), len(counts[two])]}
one.unsubscribe()
wait(lambda: len(received) == 4)
publish("/odom")
publish("/end")
wait(lambda: len(counts[end]) == 2)
found["after"] = [len(counts[one]), len(counts[two])]
found["is_subscribed"] = [one.is_subscribed, two.is_subscribed]
print(json.dumps(found))
ros.terminate()
sys.exit(found != {"before": [1, 1], "after": [1, 1], "is_subscribed": [False, True]})
PYTHON
