import dataclasses
import json
import re
import typing
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, TypeAdapter, ValidationError

from .archives import read_bytes
from .names import SHORT, explain_unknown, printable

Record = TypeVar("Record")

MAX_BYTES = 8 * 2**20
"""Maximum size of a YAML file [bytes]."""
MAX_JSON_BYTES = 16 * 2**20
"""Maximum size of a JSON file [bytes]."""
MAX_VALUES = 500_000
"""Maximum number of values in a YAML file, with aliases counted each time."""
MAX_DEPTH = 50
"""Maximum nesting depth of a YAML file."""
MAX_DIGITS = 100
"""Maximum length of a number in a YAML file [characters], as parsing takes quadratic time."""
MAX_MISTAKES = 10
"""Maximum number of mistakes listed in an error message."""
_adapter = cache(TypeAdapter)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """YAML loader that reads 3e-4 as a number, rejects duplicate keys and limits the size."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        for name, count in names.items():
            if count > 1:
                mark = node.start_mark
                raise yaml.constructor.ConstructorError(None, None, f"key {SHORT.repr(name)} occurs twice", mark)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: yaml.ScalarNode) -> Any:
        if node.tag.endswith((":int", ":float")) and (size := len(node.value)) > MAX_DIGITS:
            raise ValueError(f"number of {size:,} characters; at most {MAX_DIGITS} are allowed")
        return super().construct_scalar(node)

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        if not -(2**63) <= (value := int(self.construct_yaml_int(node))) < 2**63:
            raise ValueError(f"integer {value} has more than 64 bits")
        return value


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_integer)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d[\d_]*(\.\d*)?|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def read_mapping(path: str | Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises:
        FileNotFoundError: the file does not exist.
        ValueError: the file is not YAML, contains no mapping, or is too large.
    """
    path = Path(path)
    if not path.exists():
        others = ", ".join(sorted(str(other) for other in path.parent.glob("*.yaml")))
        raise FileNotFoundError(f"{path}: no such file" + (f"; there are {others}" if others else ""))
    content = read_bytes(path, MAX_BYTES)
    try:
        text = content.decode()
        _check_size(text)
        values = yaml.load(text, _Loader)
    except Exception as error:  # many types for invalid values
        raise ValueError(f"{path}: not readable as YAML: {printable(' '.join(str(error).split()))}") from error
    return _checked_mapping(values, str(path))


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a JSON file that contains an object.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is not JSON, contains no object, or is too large.
    """
    content = read_bytes(path, MAX_JSON_BYTES)
    try:
        values = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not readable as JSON: {error}") from error
    return _checked_mapping(values, str(path))


def _check_size(text: str) -> None:
    counts, anchors, sizes = [0], list[str | None](), dict[str | None, int]()
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            counts.append(1)
            anchors.append(event.anchor)
            sizes[event.anchor] = MAX_VALUES + 1  # of an alias inside itself
        elif isinstance(event, yaml.CollectionEndEvent):
            sizes[anchors.pop()] = size = counts.pop()
            counts[-1] += size
        elif isinstance(event, yaml.NodeEvent):
            counts[-1] += sizes.get(event.anchor, 1) if isinstance(event, yaml.AliasEvent) else 1
        if len(anchors) > MAX_DEPTH:
            raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
        if counts[-1] > MAX_VALUES:
            raise ValueError(f"more than {MAX_VALUES:,} values, aliases counted each time")


def read_record(path: str | Path, kind: type[Record]) -> Record:
    """Read a YAML file into a pydantic model or dataclass.

    Raises:
        FileNotFoundError: the file does not exist.
        ValueError: the file is not YAML, or keys or values are invalid.
    """
    return parse_record(read_mapping(path), str(path), kind)


def parse_record(content: Any, source: str, kind: type[Record]) -> Record:
    """Convert nested mappings to a pydantic model or dataclass; ValueError if invalid.

    `source`: file name in messages.
    """
    try:
        return _adapter(kind).validate_python(_checked_mapping(content, source))  # type: ignore[arg-type]
    except ValidationError as error:
        raise ValueError("\n".join(f"{source}: {line}" for line in explain_errors(error, kind))) from None


def dump_record(record: BaseModel) -> str:
    """Return a pydantic model as YAML text that `read_record` can read."""
    return yaml.safe_dump(record.model_dump(mode="json"), sort_keys=False)


def explain_errors(error: ValidationError, kind: Any) -> list[str]:
    """Return error messages for invalid data of type `kind`, one line per mistake."""
    lines = []
    faults = error.errors(include_url=False)
    for fault in faults[:MAX_MISTAKES]:
        *parents, name = fault["loc"] or ("",)
        key = ".".join(map(str, fault["loc"]))
        if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            lines.append(f"unknown key {explain_unknown(str(name), _keys(kind, parents), key)}")
        elif fault["type"] in ("missing", "missing_argument"):
            inner = _keys(kind, [*parents, name], required=True)
            lines.append(f"key {key!r} is missing" + (f", with the keys {', '.join(inner)}" if inner else ""))
        else:
            what = fault["msg"].removeprefix("Value error, ")
            what += "" if fault["type"] in ("value_error", "json_invalid") else f", got {SHORT.repr(fault['input'])}"
            lines.append(f"{key}: {what}" if key else what)
    if len(faults) > MAX_MISTAKES:
        lines.append(f"and {len(faults) - MAX_MISTAKES} more mistakes")
    return list(map(printable, lines))


def _checked_mapping(content: Any, source: str) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise ValueError(f"{source}: must be a mapping of keys to values, got {type(content).__name__}")
    return content


def _keys(kind: Any, parents: list[int | str], required: bool = False) -> list[str]:
    for parent in parents:
        if isinstance(parent, str):
            record = _record_in(kind)
            kind = typing.get_type_hints(record).get(parent) if record else None
    record, missing = _record_in(kind), dataclasses.MISSING
    if dataclasses.is_dataclass(record):
        defaults = {field.name: (field.default, field.default_factory) for field in dataclasses.fields(record)}
        needed = {name: given == (missing, missing) for name, given in defaults.items()}
    elif hasattr(record, "_fields"):
        needed = {name: name not in record._field_defaults for name in record._fields}
    else:
        needed = {name: field.is_required() for name, field in record.model_fields.items()} if record else {}
    return [name for name in needed if needed[name] or not required]


def _record_in(kind: Any) -> Any:
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        return kind
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind
    return next(filter(None, map(_record_in, typing.get_args(kind))), None)
