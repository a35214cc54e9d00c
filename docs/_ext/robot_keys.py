"""Tables of all keys of a robot file, from the dataclasses of `envs/robots/robot_params.py` and their docstrings."""

import ast
import dataclasses
import inspect
import itertools
import math
import re
import types
import typing
from typing import Any

import annotated_types
from pydantic.fields import FieldInfo

from lidarnaut.envs.robots import RobotParams, robot_params

TABLE = """\
{heading}{about}

| key | type | unit | default | meaning |
|---|---|---|---|---|
{rows}
"""
LIMITS = (
    (annotated_types.Gt, "gt", ">"),
    (annotated_types.Ge, "ge", "≥"),
    (annotated_types.Lt, "lt", "<"),
    (annotated_types.Le, "le", "≤"),
)
"""Limits of numbers: class, attribute and sign."""
NAMES = {float: "number", int: "integer", bool: "`true` or `false`", str: "text"}
"""What types are called."""


def tables() -> str:
    """Return a table for each mapping of a robot file, outermost first."""
    text = "\n".join(_tables(RobotParams, ""))
    for name, kind in typing.get_type_hints(RobotParams).items():
        text = text.replace(f"`{getattr(kind, '__name__', '')}`", f"`{name}`")  # the name in a file
    return text


def _tables(record: type, path: str) -> list[str]:
    docstrings, hints = _docstrings(record), typing.get_type_hints(record, include_extras=True)
    rows, inner = [], []
    for field in dataclasses.fields(record):
        text, kind = docstrings.get(field.name, ""), hints[field.name]
        nested = next((one for one in (kind, *typing.get_args(kind)) if dataclasses.is_dataclass(one)), None)
        if nested:
            name = f"{path}{field.name}"
            inner += _tables(nested, f"{name}{'[]' if nested is not kind else ''}.")
            text = text or inspect.getdoc(nested).split("\n")[0]
        found = re.search(r" ?\[([^\]]+)\]", text)
        unit, meaning = (found[1].replace("s2", "s²"), text.replace(found[0], "", 1)) if found else ("", text)
        rows.append(f"| `{field.name}` | {_type(kind)} | {unit} | {_default(field)} | {' '.join(meaning.split())} |")
    heading = f"### {'Each of ' * path.endswith('[].')}`{path.rstrip('.[]')}`\n\n" if path else ""
    about = " ".join(inspect.getdoc(record).partition("\n\n")[0].split())
    return [TABLE.format(heading=heading, about=about, rows="\n".join(rows)), *inner]


def _type(kind: Any) -> str:
    """Return a type in words, with limits."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        return "mapping"
    if origin is typing.Annotated:
        return f"{_type(arguments[0])}{_limits(arguments[1:])}"
    if origin in (types.UnionType, typing.Union):
        return _type(next(one for one in arguments if one is not type(None)))
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return f"list of {_type(arguments[0])}s"
        kinds = dict.fromkeys(map(_type, arguments))
        return f"list of {len(arguments)}: {' or '.join(kinds)}"
    return NAMES[kind]


def _limits(metadata: tuple[Any, ...]) -> str:
    """Return limits of a number, except those that only exclude typing errors."""
    parts = []
    for one in (each for item in metadata for each in (item.metadata if isinstance(item, FieldInfo) else (item,))):
        for kind, name, sign in LIMITS:
            if isinstance(one, kind) and abs(value := getattr(one, name)) < robot_params.MAX_NUMBER:
                parts.append(f"{sign}\N{NO-BREAK SPACE}{'2π' if math.isclose(value, 2 * math.pi) else f'{value:g}'}")
    return f"\N{NO-BREAK SPACE}{', '.join(parts)}" if parts else ""


def _default(field: Any) -> str:
    if field.default is dataclasses.MISSING:
        return "**required**"
    if dataclasses.is_dataclass(field.default):
        return "the defaults below"
    if field.default is None:
        return "none"
    if field.default == 2.0 * math.pi:
        return "2π"
    text = {(): "`[]`", "": "empty", True: "`true`", False: "`false`"}
    return text[field.default] if field.default in ((), "") or isinstance(field.default, bool) else f"{field.default:g}"


def _docstrings(record: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class, from its source."""
    (body,) = (
        node.body
        for node in ast.parse(inspect.getsource(robot_params)).body
        if getattr(node, "name", "") == record.__name__
    )
    found = {}
    for field, below in itertools.pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            found[field.target.id] = inspect.cleandoc(below.value.value)
    return found
