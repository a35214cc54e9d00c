import difflib
import importlib
import inspect
import os
import re
import reprlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

Entry = TypeVar("Entry")
SHORT = reprlib.Repr()
"""Formatter that shortens long values in error messages."""
SHORT.maxstring = SHORT.maxother = 200


def printable(text: object) -> str:
    """Return a text with escaped control characters, except newlines and tabs."""
    return "".join(c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in str(text))


def explain_unknown(name: str, allowed: Iterable[str], shown: str | None = None) -> str:
    """Return a message about an unknown name, with the closest match and the allowed names.

    `shown`: text printed for `name`.
    """
    allowed = list(allowed)
    parts = [one for one in allowed if len(name) > 2 and name in one]
    close = difflib.get_close_matches(name, allowed, n=1) or parts[:1]
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    return f"{SHORT.repr(shown or name)}{hint}; allowed are {', '.join(allowed)}"


def split_parameters(name: str) -> tuple[str, dict[str, Any]]:
    """Split `NAME?KEY=VALUE,KEY=VALUE` into the name and its parameters, with values in YAML.

    Raises:
        ValueError: a parameter is not of the form KEY=VALUE, or occurs twice.
    """
    base, _, text = name.partition("?")
    values: dict[str, Any] = {}
    for word in re.split(r",(?=\w+=)", text) if "?" in name else ():
        key, sign, value = word.partition("=")
        if not (sign and key.isidentifier()):
            raise ValueError(f"{SHORT.repr(name)}: parameters have the form NAME?KEY=VALUE,KEY=VALUE, got {word!r}")
        if key in values:
            raise ValueError(f"{SHORT.repr(name)}: parameter {key} is given twice")
        try:
            values[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ValueError(f"{SHORT.repr(name)}: value of {key} is not valid: {value!r}") from error
    return base, values


def load_object(name: str) -> Any:
    """Import and return `module:attribute`, also from the current directory; both parts may contain dots.

    Raises:
        ValueError: the form is invalid, or the module or attribute does not exist.
    """
    module_name, _, attribute = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), *attribute.split("."))):
        raise ValueError(f"{SHORT.repr(name)} is not of the form module:attribute, such as my_package.explorers:Mine")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise
        places = f"in {os.getcwd()} or among the installed packages"
        raise ValueError(f"{SHORT.repr(name)}: there is no module {SHORT.repr(error.name)} {places}") from error
    for part in attribute.split("."):
        if not hasattr(found, part):
            inside = getattr(found, "__dict__", {}).items()
            own = [key for key, value in inside if key[:1] != "_" and not _is_imported(value, module_name)]
            own = getattr(found, "__all__", own)
            unknown = explain_unknown(part, own, attribute)
            raise ValueError(f"{SHORT.repr(name)}: {module_name!r} has no attribute {unknown}")
        found = getattr(found, part)
    return found


def _is_imported(value: Any, module: str) -> bool:
    knows = inspect.isclass(value) or inspect.isroutine(value)
    return inspect.ismodule(value) or (knows and not str(value.__module__).startswith(module))


def resolve(value: Any, table: Mapping[str, Entry], what: str, *, files: bool = False) -> Entry | Any:
    """Return the object with a given name: an entry of `table`, or the imported `module:attribute`.

    Other objects are returned unchanged. `what`: kind of object, for messages; `files=True`: return the path of a YAML
    file as a `Path`.

    Raises:
        ValueError: the name is unknown, or the import failed.
    """
    if not isinstance(value, str):
        return value
    if value in table:
        return table[value]
    if files and value.endswith((".yaml", ".yml")):
        return Path(value)
    if ":" in value:
        return load_object(value)
    further = ", paths of YAML files" if files else ""
    if not table:
        raise ValueError(f"unknown {what} {value!r}; allowed is module:attribute of your own code")
    raise ValueError(f"unknown {what} {explain_unknown(value, table)}{further}, and module:attribute of your own code")


def with_defaults(value: Any, base: type) -> Any:
    """Add the attributes and methods of a class `base` that an object lacks, by a subclass of its class and `base`.

    Raises:
        ValueError: if the object does not allow this.
    """
    kind = type(value)
    if not issubclass(kind, base):
        members: dict[str, Any] = {"__module__": kind.__module__}
        if kind.__reduce_ex__ is object.__reduce_ex__ and kind.__reduce__ is object.__reduce__:
            members["__reduce__"] = lambda self: (_new_with_defaults, (kind, base), self.__getstate__())  # for pickle
        try:
            value.__class__ = type(kind.__name__, (kind, base), members)
        except TypeError:
            raise ValueError(f"{SHORT.repr(value)} must be a subclass of {base.__module__}.{base.__name__}") from None
    return value


def _new_with_defaults(kind: Any, base: type) -> Any:
    return with_defaults(kind.__new__(kind), base)
