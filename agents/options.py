"""Options of the command line for configurations whose keys are partly free: every key, with dots between the names."""

import copy
import typing
from collections.abc import Mapping, Sequence
from typing import Any

import yaml
from pydantic import BaseModel

from agents.config import EvolutionConfig, TrainingConfig

WORDS = {"None": None, "True": True, "False": False}


def read_changes(arguments: Sequence[str]) -> dict[str, Any]:
    """Return the values of options such as `--network.speed 0.6` by their keys, with underscores; several are a list.

    Raises:
        ValueError: a value stands before the first option, or is not readable as YAML.
    """
    found: dict[str, list[Any]] = {}
    key = None
    for argument in arguments:
        if argument.startswith("--"):
            key, equals, value = argument[2:].partition("=")
            key = key.replace("-", "_")
            found[key] = [_read(value)] if equals else []
        elif key is None:
            raise ValueError(f"unknown argument {argument!r}; options begin with --")
        else:
            found[key].append(_read(argument))
    return {key: values[0] if len(values) == 1 else values or True for key, values in found.items()}


def change(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested mappings with other values at some keys, names with dots between them.

    Raises:
        ValueError: a key leads through a value that is no mapping.
    """
    changed: dict[str, Any] = copy.deepcopy(dict(data))
    for key, value in changes.items():
        *parents, name = key.split(".")
        place = changed
        for parent in parents:
            if place.get(parent) is None:
                place[parent] = {}
            place = place[parent]
            if not isinstance(place, dict):
                raise ValueError(f"--{key}: {parent} is {place!r}, and holds no keys")
        place[name] = value
    return changed


def describe_keys(kinds: Sequence[type[BaseModel]] = (TrainingConfig, EvolutionConfig), prefix: str = "--") -> str:
    """Return a line for each key of configurations: option, default and meaning."""
    lines = []
    for kind in kinds:
        lines += [f"\n{kind.__doc__}\n"] if prefix == "--" else []
        for name, field in kind.model_fields.items():
            option = prefix + name.replace("_", "-")
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
                lines.append(describe_keys([field.annotation], f"{option}."))
                continue
            default = "needed" if field.is_required() else f"default {field.get_default()!r}"
            choices = f"; one of {', '.join(typing.get_args(field.annotation))}" if _is_choice(field.annotation) else ""
            lines.append(f"  {option} ({default}{choices})\n      {' '.join((field.description or '').split())}")
    return "\n".join(lines)


def _is_choice(annotation: Any) -> bool:
    return typing.get_origin(annotation) is typing.Literal


def _read(text: str) -> Any:
    """Return what a word of the command line stands for: a number, also 1e-3 and 60_000, a truth, or YAML."""
    if text in WORDS:
        return WORDS[text]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    try:
        return yaml.safe_load(text) if text[:1] in "[{'\"" else text
    except yaml.YAMLError as error:
        raise ValueError(f"{text!r} is not readable as YAML: {error}") from error
