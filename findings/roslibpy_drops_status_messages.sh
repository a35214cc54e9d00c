#!/usr/bin/env bash
# roslibpy 2.1.0: a rosbridge server's error messages are lost; the log has an exception without their text instead.
#
# A rosbridge server answers a refused `advertise` or `subscribe`, as with another type than the topic has, with a message
# `{"op": "status", "level": "error", "msg": ...}` (protocol, section 3.2: status messages). roslibpy has no handler for it,
# logs `No handler registered for operation "status"` as a possible bug of the user's code, and drops the reason. The Topic
# stays `is_advertised`. The server's own log has the reason.
#
# Seen: {"logged": true, "reason": false, "is_advertised": true}
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

import roslibpy
from websockets.sync.server import serve

REASON = "the topic has the type TwistStamped"


def handle(socket):
    for text in socket:
        request = json.loads(text)
        if request["op"] == "advertise":
            socket.send(json.dumps({"op": "status", "level": "error", "msg": REASON, "id": request["id"]}))
            socket.send(json.dumps({"op": "publish", "topic": "/end", "msg": {}}))


lines = []


class Keep(logging.Handler):
    def emit(self, record):
        lines.append(logging.Formatter().format(record))


logging.getLogger("roslibpy").addHandler(Keep())
logging.getLogger("websockets").setLevel(logging.CRITICAL)
server = serve(handle, "localhost", 0)
threading.Thread(target=server.serve_forever, daemon=True).start()
ros = roslibpy.Ros("localhost", server.socket.getsockname()[1])
ros.run()
ended = threading.Event()
roslibpy.Topic(ros, "/end", "std_msgs/Empty").subscribe(lambda message: ended.set())
command = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
command.advertise()
assert ended.wait(30)
log = "\n".join(lines)
found = {
    "logged": 'No handler registered for operation "status"' in log,
    "reason": REASON in log,
    "is_advertised": command.is_advertised,
}
print(json.dumps(found))
ros.terminate()
sys.exit(found != {"logged": True, "reason": False, "is_advertised": True})
PYTHON
