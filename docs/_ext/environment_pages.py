"""A page per task: registered ids, an animated picture of each, spaces, and the docstring."""

import inspect
from pathlib import Path

import gymnasium
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec, load_env_creator

from lidarnaut.envs import LIDAR_ENV

PICTURES = Path("images/environments")
"""Folder of the animated pictures, `python -m lidarnaut.benchmarks.films`."""
INDEX = """\
# Environments

`import lidarnaut` registers these with Gymnasium. `gymnasium.make(id)` makes one, and
`gymnasium.make_vec(id, num_envs=n)` many in worker processes: sub-environment i equals a single one seeded with
seed + i. Pages are made from registry and docstrings when the site is built.

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
import lidarnaut

env = gymnasium.make("{id}", render_mode="human")
```

| task | `{entry_point}` |
|---|---|
| **action space** | `{action}` |
| **observation space** | {observation} |

{ids}

{body}
"""


def pages(source: Path) -> dict[str, str]:
    """Return the pages by file name: one per task, or where an action is a frontier per entry point."""
    groups: dict[str, list[EnvSpec]] = {}
    for spec in gymnasium.registry.values():
        if spec.namespace == "lidarnaut":
            groups.setdefault(spec.kwargs.get("task", str(spec.entry_point)), []).append(spec)
    names = {entry_point: _slug(specs[0]).rpartition("-")[0] for entry_point, specs in groups.items()}
    rows = [
        f"| [`{spec.id}`]({names[entry_point]}.md) | {_docstring(entry_point)[0]} {_arguments(spec)} |"
        for entry_point, specs in groups.items()
        for spec in specs
    ]
    arguments = _docstring(LIDAR_ENV)[1].partition("## Arguments")[2]
    index = INDEX.format(arguments=arguments, rows="\n".join(rows), names="\n".join(names.values()))
    found = {f"{names[entry_point]}.md": _page(entry_point, specs, source) for entry_point, specs in groups.items()}
    return {"index.md": index, **found}


def _page(entry_point: str, specs: list[EnvSpec], source: Path) -> str:
    summary, body = _docstring(entry_point)
    env = gymnasium.make(specs[0].id, physics="kinematic", disable_env_checker=True).unwrapped
    parts = env.observation_space.items() if isinstance(env.observation_space, spaces.Dict) else ()
    shown = [spec for spec in specs if (source / PICTURES / f"{_slug(spec)}.webp").exists()]
    pictures = [
        f"![{spec.id}: ground truth, and what the robot estimates](../{PICTURES}/{_slug(spec)}.webp)" for spec in shown
    ]
    ids = ""
    if len(specs) > 1:
        rows = "\n".join(f"| `{spec.id}` | {_arguments(spec) or 'any'} |" for spec in specs)
        others = "\n\n".join(f"`{spec.id}`:\n\n{picture}" for spec, picture in zip(shown[1:], pictures[1:]))
        ids = f"## Registered Configurations\n\n| id | arguments |\n|---|---|\n{rows}\n\n{others}"
    text = PAGE.format(
        title=load_env_creator(entry_point).__name__.removesuffix("Env"),
        summary=summary,
        picture="".join(pictures[:1]),
        id=specs[0].id,
        entry_point=entry_point,
        action=env.action_space,
        observation="<br>".join(f"`{name}`: `{part}`" for name, part in parts) or f"`{env.observation_space}`",
        ids=ids,
        body=body,
    )
    env.close()
    return text


def _slug(spec: EnvSpec) -> str:
    """Return the file name of an id, without suffix."""
    return spec.id.partition("/")[2].lower()


def _docstring(entry_point: str) -> tuple[str, str]:
    """Return the first line of the docstring and the rest."""
    first, _, rest = (inspect.getdoc(load_env_creator(entry_point)) or "").partition("\n")
    return first, rest.strip()


def _arguments(spec: EnvSpec) -> str:
    """Return what arguments an id sets, as Markdown."""
    return ", ".join(f"`{name}={value!r}`" for name, value in spec.kwargs.items() if name != "task")
