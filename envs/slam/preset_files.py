"""Presets of SLAMs: parameters in YAML files."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from envs.files import parse_record, read_mapping, resolve

Params = TypeVar("Params")


def find_presets(folder: str = ".") -> dict[str, Path]:
    """Return the files in a folder of `presets` by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "presets" / folder).glob("*.yaml"))}


def load_preset(
    kind: type[Params],
    preset: Any,
    presets: Mapping[str, Path],
    noun: str,
    changes: Mapping[str, Any] | None,
    rename: Callable[[dict[str, Any]], dict[str, Any]] = dict,
) -> Params:
    """Return params by the name of a preset, by the path of a YAML file, by `module:attribute`, or as they are.

    Args:
        kind: class of the params.
        preset: what stands for them.
        presets: files by name.
        noun: what messages call a preset.
        changes: values to replace; text that reads as a number is taken for it.
        rename: returns values with the keys of today for those of before.

    Raises:
        ValueError: the name is unknown, or the file has an unknown key or a value that makes no sense; the message
            names file and key.
        FileNotFoundError: there is no file at the path.
    """
    found = resolve(preset, dict(presets), noun, files=True)
    values = read_mapping(found) if isinstance(found, Path) else asdict(found)
    source = str(found) if isinstance(found, Path) else "params"
    return parse_record(rename({**values, **(changes or {})}), source, kind)
