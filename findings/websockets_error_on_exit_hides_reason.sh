#!/usr/bin/env bash
# websockets 17.4 (asyncio, Python 3.11): `async with connect(...)` ends with AttributeError if the server refuses a
# message of many megabytes, instead of ConnectionClosedError or of the exception of its own body.
#
# The server closes with 1009 (message too big), while much of the message is still to be sent. `recv` then raises
# ConnectionClosedError with this reason, but the exit of the block closes the connection again and raises
# `'NoneType' object has no attribute 'call_soon'`: an `except ConnectionClosed` around the block, as in a loop that
# reconnects, does not catch it. An exception of the body is replaced in the same way. Both remain as `__context__`.
# Messages that fit into the buffers of the sockets do not show it. Programs catch exceptions within the block.
#
# Seen: {"recv, 1.1 MB": ["ConnectionClosedError"], "recv, 30 MB": ["AttributeError"], "own, 1.1 MB": ["ValueError"],
#        "own, 30 MB": ["AttributeError"], "inside, 30 MB": ["ConnectionClosedError"]} (exceptions of 20 runs each)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet websockets==17.4
"$folder/venv/bin/python" - <<'PYTHON'
import asyncio
import json
import logging
import sys

from websockets.asyncio.client import connect
from websockets.asyncio.server import serve

logging.disable(logging.CRITICAL)


async def receive(socket):
    async for _ in socket:
        pass


async def run(port, size, body):
    inside = None
    try:
        async with connect(f"ws://localhost:{port}", compression=None) as socket:
            try:
                await socket.send(b"x" * size)
                if body == "own":
                    raise ValueError("of the body")
                await socket.recv()
            except Exception as error:
                inside = type(error).__name__
                if body != "inside":
                    raise
    except Exception as error:
        return inside if body == "inside" else type(error).__name__
    return inside


async def main():
    found = {}
    async with serve(receive, "localhost", 0) as server:
        port = server.sockets[0].getsockname()[1]
        for body, size in (("recv", 1.1), ("recv", 30), ("own", 1.1), ("own", 30), ("inside", 30)):
            names = [await run(port, int(size * 1e6), body) for _ in range(20)]
            found[f"{body}, {size} MB"] = sorted(set(names))
    return found


found = asyncio.run(main())
print(json.dumps(found))
expected = {
    "recv, 1.1 MB": ["ConnectionClosedError"],
    "recv, 30 MB": ["AttributeError"],
    "own, 1.1 MB": ["ValueError"],
    "own, 30 MB": ["AttributeError"],
    "inside, 30 MB": ["ConnectionClosedError"],
}
sys.exit(found != expected)
PYTHON
