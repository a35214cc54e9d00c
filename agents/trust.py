"""Checks that configurations from other users import only trusted code."""

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from lidarnaut.envs.files import SHORT, load_object

_TASKS, _ROBOTS = "lidarnaut.agents.frontiers.tasks", "lidarnaut.agents.robots"
_ACTIVATIONS = ("ELU", "GELU", "LeakyReLU", "Mish", "ReLU", "SiLU", "Tanh")
_EXTRACTORS = ("CombinedExtractor", "FlattenExtractor", "NatureCNN")
_OPTIMIZERS = ("Adam", "AdamW", "RAdam", "RMSprop", "SGD")
REGISTERED = {
    *(f"{_TASKS}:{name}" for name in ("training_world", "sized_training_world")),
    "lidarnaut.agents.frontiers.score:pretrained_rating",
    *(f"{_ROBOTS}:{name}" for name in ("SEES_AHEAD", "SEES_AROUND", "SLOW_SEES_AROUND", "SMALL_SEES_AROUND")),
    *(f"torch.nn:{name}" for name in _ACTIVATIONS),
    *(f"torch.optim:{name}" for name in _OPTIMIZERS),
    *(f"stable_baselines3.common.torch_layers:{name}" for name in _EXTRACTORS),
}
"""Names of code (`module:attribute`) that any configuration or checkpoint may import."""
_PATH_OR_OWN_ID = re.compile(r"[A-Za-z]:[\\/][^:]*|lidarnaut:lidarnaut/[\w-]+")


def named_code(record: Any) -> dict[str, str]:
    """Return all references to Python code in a configuration, such as `module:attribute`, with the key of each.

    Every text with a colon is a reference, except Windows paths and ids of the package's environments.
    """
    texts = ((key, text) for key, text in leaves(record) if isinstance(text, str) and ":" in text)
    return {text: key for key, text in texts if not _PATH_OR_OWN_ID.fullmatch(text)}


def resuming(run: Path, record: Any) -> str:
    """Return the command-line options of `train.py` that resume a run, with `--trust` if needed."""
    trust = sorted(set(named_code(record)) - REGISTERED)
    return " ".join([f"--resume {run}", *(["--trust", *trust] if trust else [])])


def check_names(record: Any, source: str, trust: Iterable[str] = ()) -> None:
    """Raise ValueError if the configuration of a file `source` names code that is not registered or trusted.

    `trust`: modules including submodules, or `module:attribute`. Objects imported by a module are not trusted.
    """
    trusted = {trust} if isinstance(trust, str) else {*trust}
    for name, key in named_code(record).items():
        if not _is_trusted(name, trusted):
            module = name.partition(":")[0]
            remedy = name if any(_covers(one, module) for one in trusted) else module
            raise ValueError(
                f"{source}: {SHORT.repr(key)} names the code {SHORT.repr(name)}, which is not part of the package. "
                f"Records run only trusted code. If you know this code, pass trust=[{SHORT.repr(remedy)}], "
                f"or on the command line --trust {SHORT.repr(remedy)[1:-1]}"
            )


def _is_trusted(name: str, trust: set[str]) -> bool:
    module = name.partition(":")[0]
    if name in trust or name in REGISTERED:
        return True
    roots = [one for one in trust if _covers(one, module)]
    if not roots:
        return False
    try:
        found = load_object(name)
    except ValueError:
        return True
    home = getattr(found, "__module__", None) or type(found).__module__
    is_data = not callable(found) and not inspect.ismodule(found)
    return is_data or any(_covers(root, str(home)) for root in roots)


def _covers(root: str, module: str) -> bool:
    return f"{module}.".startswith(f"{root}.")


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the keys, with dots, and values of nested mappings and lists; names in mappings are values as well."""
    if isinstance(value, Mapping):
        for name, one in value.items():
            below = f"{key}.{name}".lstrip(".")
            yield below, name
            yield from leaves(one, below)
    elif isinstance(value, list | tuple | set | frozenset):
        for index, one in enumerate(value):
            yield from leaves(one, f"{key}.{index}".lstrip("."))
    else:
        yield key, value
