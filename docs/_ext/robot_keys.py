"""Tables of all keys of a robot file, from the JSON schema of `RobotParams` and the docstrings of its fields."""

import math
import re
from typing import Any

from pydantic import TypeAdapter

from lidarnaut.envs.robots import RobotParams, robot_params

TABLE = """\
{heading}{about}

| key | type | unit | default | meaning |
|---|---|---|---|---|
{rows}
"""
LIMITS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
"""Signs of limits by their names in a schema."""
NAMES = {"number": "number", "integer": "integer", "boolean": "`true` or `false`", "string": "text"}
"""Names of types by their names in a schema."""


def tables() -> str:
    """Return a table for each mapping of a robot file, outermost first."""
    schema = TypeAdapter(RobotParams).json_schema()
    text = "\n".join(_tables(schema, "", schema["$defs"]))
    for name, field in schema["properties"].items():
        text = text.replace(f"`{_record_of(field)}`", f"`{name}`")  # the name in a file
    return text


def _tables(record: dict[str, Any], path: str, records: dict[str, Any]) -> list[str]:
    rows, inner, texts = [], [], vars(robot_params)[record["title"]].__slots__
    for key, field in record["properties"].items():
        text = " ".join(texts[key].split())
        if nested := records.get(_record_of(field)):
            inner += _tables(nested, f"{path}{key}{'[]' * ('items' in field)}.", records)
        found = re.search(r" ?\[([^\]]+)\]", text)
        unit, meaning = (found[1].replace("s2", "s²"), text.replace(found[0], "", 1)) if found else ("", text)
        default = "**required**" if key in record.get("required", ()) else _default(field["default"])
        rows.append(f"| `{key}` | {_type(field)} | {unit} | {default} | {meaning} |")
    heading = f"### {'Each of ' * path.endswith('[].')}`{path.rstrip('.[]')}`\n\n" if path else ""
    about = " ".join(record["description"].partition("\n\n")[0].split())
    return [TABLE.format(heading=heading, about=about, rows="\n".join(rows)), *inner]


def _record_of(field: dict[str, Any]) -> str:
    """Return the name of the class of a mapping or of the members of a list; empty for other types."""
    return field.get("items", field).get("$ref", "").rpartition("/")[2]


def _type(field: dict[str, Any]) -> str:
    """Return a type in words, with limits of numbers except those that only exclude typing errors."""
    if "$ref" in field:
        return "mapping"
    if "anyOf" in field:
        return _type(field["anyOf"][0])  # the second one is null
    if "prefixItems" in field:
        kinds = dict.fromkeys(map(_type, field["prefixItems"]))
        return f"list of {len(field['prefixItems'])}: {' or '.join(kinds)}"
    if "items" in field:
        return f"list of {_type(field['items'])}s"
    if "enum" in field:
        return " or ".join(f"`{value}`" for value in field["enum"])
    known = {name: field[name] for name in LIMITS if abs(field.get(name, math.inf)) < robot_params.MAX_NUMBER}
    limits = ", ".join(f"{LIMITS[name]}\N{NO-BREAK SPACE}{_number(value)}" for name, value in known.items())
    return "\N{NO-BREAK SPACE}".join(filter(None, (NAMES[field["type"]], limits)))


def _default(value: Any) -> str:
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, dict):
        return "the defaults below"
    if isinstance(value, str) and value:
        return f"`{value}`"
    return "`[]`" if value == [] else {None: "none", "": "empty", True: "`true`", False: "`false`"}[value]


def _number(value: float) -> str:
    return "2π" if math.isclose(value, 2.0 * math.pi) else f"{value:g}"
