"""Generate one page per task: registered ids with animated pictures, spaces, and the docstring."""

import inspect
import re
from pathlib import Path

import gymnasium
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec, load_env_creator

from lidarnaut.envs import LIDAR_ENV

PICTURES = Path("images/environments")
"""Folder of the animated pictures, `python -m lidarnaut.benchmarks.films`."""
INDEX = """\
# Environments

`import lidarnaut` registers these ids with Gymnasium. `gymnasium.make(id)` makes one environment, and
`gymnasium.make_vec(id, num_envs=n)` a vector environment with worker processes: sub-environment i equals a single
environment with seed + i. The films show ground truth on the left, and map and pose estimate on the right.

{sections}

## Arguments
{arguments}

```{{toctree}}
:hidden:

{names}
```
"""
SECTIONS = {
    "^explore$": "Explore",
    "^explore": "Explore as a team, or by choosing frontiers",
    "": "Reach goals, follow routes",
}
"""Section titles of the gallery by pattern of page names; the first match applies."""
SECTION = "## {title}\n\n::::{{grid}} 1 2 2 3\n:gutter: 2\n\n{cards}\n\n::::"
CARD = """\
:::{{grid-item-card}} `{id}`
:link: {name}
:link-type: doc
:img-top: ../{picture}
:img-alt: {id}

{summary}

{arguments}
:::"""
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
    """Return the pages by file name: one per task, or per entry point at decision level."""
    groups: dict[str, list[EnvSpec]] = {}
    for spec in gymnasium.registry.values():
        if spec.namespace == "lidarnaut":
            groups.setdefault(spec.kwargs.get("task", str(spec.entry_point)), []).append(spec)
    names = {entry_point: _slug(specs[0]).rpartition("-")[0] for entry_point, specs in groups.items()}
    cards: dict[str, list[str]] = {title: [] for title in SECTIONS.values()}
    for entry_point, specs in groups.items():
        title = next(title for pattern, title in SECTIONS.items() if re.match(pattern, names[entry_point]))
        cards[title] += [_card(spec, entry_point, names[entry_point]) for spec in specs]
    sections = [SECTION.format(title=title, cards="\n\n".join(texts)) for title, texts in cards.items()]
    arguments = _docstring(LIDAR_ENV)[1].partition("## Arguments")[2]
    index = INDEX.format(arguments=arguments, sections="\n\n".join(sections), names="\n".join(names.values()))
    found = {f"{names[entry_point]}.md": _page(entry_point, specs, source) for entry_point, specs in groups.items()}
    return {"index.md": index, **found}


def _card(spec: EnvSpec, entry_point: str, page: str) -> str:
    """Return a card of the gallery: film, task and arguments of an id."""
    return CARD.format(
        id=spec.id,
        name=page,
        picture=PICTURES / f"{_slug(spec)}.webp",
        summary=_docstring(entry_point)[0],
        arguments=_arguments(spec) or "In any world.",
    )


def _page(entry_point: str, specs: list[EnvSpec], source: Path) -> str:
    summary, body = _docstring(entry_point)
    env = gymnasium.make(specs[0].id, physics="kinematic", disable_env_checker=True).unwrapped
    parts = env.observation_space.items() if isinstance(env.observation_space, spaces.Dict) else ()
    shown = [spec for spec in specs if (source / PICTURES / f"{_slug(spec)}.webp").exists()]
    pictures = [
        f"![{spec.id}: ground truth, and estimates of the robot](../{PICTURES}/{_slug(spec)}.webp)" for spec in shown
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
    """Return the file name of an id without suffix."""
    return spec.id.partition("/")[2].lower()


def _docstring(entry_point: str) -> tuple[str, str]:
    """Return the first line of the docstring, and the rest with links to pages of the site."""
    first, _, rest = (inspect.getdoc(load_env_creator(entry_point)) or "").partition("\n")
    return first, re.sub(r"\bdocs/(\w+)\.md", r"[\1](../\1.md)", rest.strip())


def _arguments(spec: EnvSpec) -> str:
    """Return the arguments of an id as Markdown."""
    return ", ".join(f"`{name}={value!r}`" for name, value in spec.kwargs.items() if name != "task")
