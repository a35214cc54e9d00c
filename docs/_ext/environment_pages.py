"""A page per task: registered ids, an animated picture of each, spaces, and the docstring."""

import inspect
from collections.abc import Iterable
from pathlib import Path

import gymnasium
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec, load_env_creator

from envs import LIDAR_ENV

NAMESPACE = "lidarnaut"
PICTURES = Path("images/environments")
"""Folder of the animated pictures, `python -m benchmarks.films`."""
INDEX = """\
# Environments

`import envs` registers these with Gymnasium. `gymnasium.make(id)` makes one, and `gymnasium.make_vec(id, num_envs=n)`
many in worker processes: sub-environment i equals a single one seeded with seed + i. Pages are made from registry and
docstrings when the site is built.

| id | world and task |
|---|---|
{rows}

## Arguments
{arguments}

```{{toctree}}
:hidden:

{names}
```
"""
PAGE = """\
# {title}

{summary}

{picture}

```python
import gymnasium
import envs

env = gymnasium.make("{id}", render_mode="human")
```

| task | `{entry_point}` |
|---|---|
| **action space** | {action} |
| **observation space** | {observation} |

{ids}

{body}
"""


def slug_of(id: str) -> str:
    """Return the file name of an id, without suffix."""
    return id.partition("/")[2].lower()


def groups() -> dict[str, list[EnvSpec]]:
    """Return the registered environments by task, or where an action is a frontier by entry point."""
    found: dict[str, list[EnvSpec]] = {}
    for spec in gymnasium.registry.values():
        if spec.namespace == NAMESPACE:
            found.setdefault(spec.kwargs.get("task", str(spec.entry_point)), []).append(spec)
    return found


def pages(source: Path) -> dict[str, str]:
    """Return the pages by file name."""
    by_class = groups()
    names = {entry_point: slug_of(specs[0].id).rpartition("-")[0] for entry_point, specs in by_class.items()}
    rows = [
        f"| [`{spec.id}`]({names[entry_point]}.md) | {_summary(entry_point)[0]} {_of_arguments(spec)} |"
        for entry_point, specs in by_class.items()
        for spec in specs
    ]
    listed = "\n".join(names.values())
    found = {f"{names[entry_point]}.md": _page(entry_point, specs, source) for entry_point, specs in by_class.items()}
    return {
        "index.md": INDEX.format(
            arguments=_summary(LIDAR_ENV)[1].partition("## Arguments")[2], rows="\n".join(rows), names=listed
        ),
        **found,
    }


def _summary(entry_point: str) -> tuple[str, str]:
    """Return the first line of the docstring and the rest."""
    first, _, rest = (inspect.getdoc(load_env_creator(entry_point)) or "").partition("\n")
    return first, rest.strip()


def _of_arguments(spec: EnvSpec) -> str:
    """Return what arguments an id sets, as Markdown."""
    return ", ".join(f"`{name}={value!r}`" for name, value in spec.kwargs.items() if name != "task")


def _page(entry_point: str, specs: list[EnvSpec], source: Path) -> str:
    summary, body = _summary(entry_point)
    env = gymnasium.make(specs[0].id, physics="kinematic", disable_env_checker=True).unwrapped
    pictures = [spec for spec in specs if (source / PICTURES / f"{slug_of(spec.id)}.webp").exists()]
    text = PAGE.format(
        title=load_env_creator(entry_point).__name__.removesuffix("Env"),
        summary=summary,
        picture=_picture(pictures[0]) if pictures else "",
        id=specs[0].id,
        entry_point=entry_point,
        action=f"`{env.action_space}`",
        observation=_space_rows(env.observation_space),
        ids=_registered(specs, pictures[1:]),
        body=body,
    )
    env.close()
    return text


def _space_rows(space: spaces.Space) -> str:
    """Return a space as one cell of a table, a line for each of its parts."""
    if not isinstance(space, spaces.Dict):
        return f"`{space}`"
    return "<br>".join(f"`{name}`: `{part}`" for name, part in space.items())


def _picture(spec: EnvSpec) -> str:
    return f"![{spec.id}: ground truth, and what the robot estimates](../{PICTURES}/{slug_of(spec.id)}.webp)"


def _registered(specs: list[EnvSpec], pictures: Iterable[EnvSpec]) -> str:
    """Return the ids of a class with what they set, and pictures of some."""
    if len(specs) == 1:
        return ""
    rows = "\n".join(f"| `{spec.id}` | {_of_arguments(spec) or 'any'} |" for spec in specs)
    shown = "\n\n".join(f"`{spec.id}`:\n\n{_picture(spec)}" for spec in pictures)
    return f"## Registered Configurations\n\n| id | arguments |\n|---|---|\n{rows}\n\n{shown}"
