"""Configurations as YAML files, with errors that name the key and what is allowed."""

import re
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from agents.config import TrainingConfig, explain_name

Config = TypeVar("Config", bound=BaseModel)


class ConfigError(ValueError):
    """A configuration is wrong; the message says where and what is allowed."""


def load_config(path: str | Path, kind: type[Config] = TrainingConfig) -> Config:  # type: ignore[assignment]
    """Read a configuration from a YAML file.

    Args:
        path: of the file.
        kind: what it configures.

    Raises:
        ConfigError: if the file cannot be read, is no YAML, or has a wrong or unknown key.
    """
    path = Path(path)
    try:
        data = yaml.load(path.read_text(), Loader=_Loader)
    except FileNotFoundError:
        there = sorted(str(other) for other in path.parent.glob("*.yaml"))
        raise ConfigError(f"{path}: no such file" + (f"; there are {', '.join(there)}" if there else "")) from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: {error}") from error
    return parse_config(data, str(path), kind)


def parse_config(data: Any, source: str, kind: type[Config] = TrainingConfig) -> Config:  # type: ignore[assignment]
    """Check a configuration given as nested mappings.

    Args:
        data: the mappings.
        source: where they come from, for messages.
        kind: what is configured.

    Raises:
        ConfigError: naming `source`, each offending key, and what is allowed there.
    """
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: must hold keys and values, got {type(data).__name__}")
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(f"{source}: {line}" for line in explain(error, kind))) from error


def dump_config(config: BaseModel) -> str:
    """Return the YAML that `load_config` reads back as the same configuration."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def explain(error: ValidationError, kind: type[BaseModel] = TrainingConfig) -> list[str]:
    """Say in a line per mistake which key is wrong and what is allowed."""
    lines = []
    for detail in error.errors():
        *parents, name = detail["loc"] or ("",)
        key = ".".join(map(str, detail["loc"]))
        if detail["type"] == "extra_forbidden":
            lines.append(f"unknown key {explain_name(key, _allowed(kind, parents), str(name))}")
        elif detail["type"] == "missing":
            lines.append(f"{key} is missing")
        else:
            what = detail["msg"].removeprefix("Value error, ")
            lines.append(f"{key}: {what}, got {detail['input']!r}" if key else what)
    return lines


def _allowed(section: type[BaseModel], parents: list[int | str]) -> list[str]:
    for parent in parents:
        section = section.model_fields[str(parent)].annotation  # type: ignore[assignment]
    return list(section.model_fields)


class _Loader(yaml.SafeLoader):
    """YAML in which 3e-4 is a number, as in YAML 1.2, and a key cannot stand twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value]
        for name in names:
            if names.count(name) > 1:
                raise yaml.constructor.ConstructorError(None, None, f"key {name!r} stands twice", node.start_mark)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d[\d_]*\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)
