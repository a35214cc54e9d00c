"""Run a function of a client: `client.py CLIENT FUNCTION ARGUMENTS...`; keyword arguments and result are JSON."""

import contextlib
import importlib
import json
import math
import sys


def plain(value):
    """Return a message as plain data: fields by name, numbers that are not finite as text."""
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, (str, bool, int, float)):
        return str(value) if isinstance(value, float) and not math.isfinite(value) else value
    names = getattr(value, "__dataclass_fields__", None) or value.__slots__
    fields = {name: getattr(value, name) for name in names if not (name.startswith("_") or name.isupper())}
    if {"secs", "nsecs"} & fields.keys():  # Time of ROS 1
        return {"sec": value.secs, "nanosec": value.nsecs}
    return {name: plain(field) for name, field in fields.items() if name != "seq"}


if __name__ == "__main__":
    client, function, *arguments = sys.argv[1:]
    with contextlib.redirect_stdout(sys.stderr):  # some libraries print
        found = getattr(importlib.import_module(client), function)(*arguments, **json.load(sys.stdin))
    print(json.dumps(found, default=lambda value: value.tolist()))
