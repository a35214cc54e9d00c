"""Messages as plain data: fields by name, numbers that are not finite as text."""

import dataclasses
import math


def plain(value):
    if isinstance(value, (str, bool)):
        return value
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return (
            value if math.isfinite(value) else {True: "nan", False: "inf" if value > 0 else "-inf"}[math.isnan(value)]
        )
    if isinstance(value, int):
        return value
    is_record = dataclasses.is_dataclass(value)
    names = [one.name for one in dataclasses.fields(value)] if is_record else value.__slots__
    fields = {name: getattr(value, name) for name in names if not (name.startswith("_") or name.isupper())}
    if {"secs", "nsecs"} & fields.keys():  # Time of ROS 1
        return {"sec": value.secs, "nanosec": value.nsecs}
    return {name: plain(field) for name, field in fields.items() if name != "seq"}
