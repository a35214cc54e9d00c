"""Generate one page per task: registered ids with animated pictures, spaces, and the docstring."""

import functools
import inspect
import re
from collections.abc import Mapping
from pathlib import Path

import gymnasium
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec, load_env_creator

from lidarnaut.envs import ENVIRONMENTS, LIDAR_ENV
from lidarnaut.envs.worlds import FAMILIES, free_area, load_world

PICTURES = Path("images/environments")
"""Folder of the animated pictures, `python -m lidarnaut.benchmarks.films`."""
EXPLORE = "lidarnaut.envs.tasks.explore:Explore"
"""Task whose docstring others refer to."""
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
    "": "Reach goals, dock, sweep, follow routes",
}
"""Section titles of the gallery by pattern of page names; the first match applies."""
REWARDS = re.compile(r"## Rewards\n(.+?)\n\n", re.DOTALL)
TERM = re.compile(r"`(\w+)` \((-?[\d.]+)(?: per (m2|m and s|m|s))?,?(?: of)? ?([^)]*)\)")
WORLDS = {
    "ExploreTurtleBot3World": "A hexagon with nine pillars: most of it is in view from anywhere.",
    "ExploreHouse": "Six rooms and a yard, joined by doors: a room that is left out costs a long way back.",
    "ExploreWarehouse": "A hall of 30 m x 50 m with shelves up to 18 m long: distances are large, aisles are hidden.",
    "ExploreRooms": "A new flat or office in each episode: furnished rooms behind doors of 0.9 m and more.",
    "ExploreMaze": "A new maze in each episode: corridors of 0.9 to 1.6 m with dead ends; little is in view at once.",
    "ExploreAisles": "A new warehouse in each episode: aisles between racks, and a loading zone full of pallets.",
    "ExploreCaves": "New caves in each episode: rounded walls without corners, and passages as narrow as 0.7 m.",
    "ReachClutter": "A new field of cylinders in each episode, as in BARN: gaps little wider than the robot.",
    "ReachCrowd": "A new hall with pillars and boxes in each episode, dense with walking people.",
    "ReachHouse": "Goals in other rooms of a house, at least 5 m away: the straight way is mostly blocked.",
}
"""World and difficulty of environments that set a world, by id without namespace and version."""
NUM_SAMPLES = 12
"""Number of sampled worlds of a family, for the range of its area."""
SECTION = "## {title}\n\n| film | environment |\n|---|---|\n{rows}"
ROW = "| ![{id}](../../{picture}) | [`{id}`]({name}.md)<br>{summary}<br>{arguments} |"
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
    rows: dict[str, list[str]] = {title: [] for title in SECTIONS.values()}
    for entry_point, specs in groups.items():
        title = next(title for pattern, title in SECTIONS.items() if re.match(pattern, names[entry_point]))
        rows[title] += [_row(spec, entry_point, names[entry_point]) for spec in specs]
    sections = [SECTION.format(title=title, rows="\n".join(texts)) for title, texts in rows.items()]
    arguments = _docstring(LIDAR_ENV)[1].partition("## Arguments")[2]
    index = INDEX.format(arguments=arguments, sections="\n\n".join(sections), names="\n".join(names.values()))
    found = {
        f"{names[task]}.md": _linked(_page(task, specs, source), names[task], names) for task, specs in groups.items()
    }
    return {"index.md": index, **found}


def quantities() -> str:
    """Return a table of the reward quantities of each task, with default weights."""
    ids = {given["task"]: id for id, (_, given) in reversed(ENVIRONMENTS.items()) if "task" in given}
    rows = []
    for task in reversed(ids):
        rows += [f"\n`{ids[task]}`:\n\n| quantity | unit | default weight | meaning |\n|---|---|---|---|"]
        found = terms(load_env_creator(task)).items()
        rows += [f"| `{name}` | {unit or 1} | {weight} | {text} |" for name, (weight, unit, text) in found]
    return "\n".join(rows).replace("m2", "m²").replace("m and s", "m s")


def terms(task: type) -> dict[str, list[str]]:
    """Return weight, unit and meaning of each term by name, from the docstrings of a task and its base classes."""
    texts = [part for kind in reversed(task.__mro__) for part in REWARDS.findall(vars(kind)["__doc__"] or "")]
    found = {name: rest for name, *rest in TERM.findall(" ".join(" ".join(texts).split()))}
    return {name: rest for name, rest in found.items() if name in task.weights or not task.is_team}


def _row(spec: EnvSpec, entry_point: str, page: str) -> str:
    """Return a row of the gallery: film, task or world, and arguments of an id."""
    default = getattr(load_env_creator(entry_point), "world", None)
    name = _name(spec)
    area = _area(spec.kwargs.get("world")) if name.startswith("Explore") else ""
    return ROW.format(
        id=spec.id,
        name=page,
        picture=PICTURES / f"{_slug(spec)}.webp",
        summary=f"{WORLDS.get(name) or _docstring(entry_point)[0]} {area}".strip(),
        arguments=_arguments(spec) or f"In any world{f', by default `{default}`' if isinstance(default, str) else ''}.",
    )


@functools.cache
def _area(world: str | None) -> str:
    """Return the free area of a world, or of a family the range over some of its worlds, as a sentence."""
    if world is None:
        return ""
    worlds = [FAMILIES[world](seed, None) for seed in range(NUM_SAMPLES)] if world in FAMILIES else [load_world(world)]
    areas = sorted(round(free_area(one, radius=0.0)) for one in worlds)
    return f"Free area: {' to '.join(map(str, dict.fromkeys((areas[0], areas[-1]))))}\N{NO-BREAK SPACE}m²."


def _page(entry_point: str, specs: list[EnvSpec], source: Path) -> str:
    summary, body = _docstring(entry_point)
    env = gymnasium.make(specs[0].id, physics="kinematic", disable_env_checker=True).unwrapped
    parts = env.observation_space.items() if isinstance(env.observation_space, spaces.Dict) else ()
    shown = [spec for spec in specs if (source / PICTURES / f"{_slug(spec)}.webp").exists()]
    pictures = [
        f"![{spec.id}: ground truth, and estimates of the robot](../../{PICTURES}/{_slug(spec)}.webp)" for spec in shown
    ]
    ids = ""
    if len(specs) > 1:
        rows = "\n".join(f"| `{spec.id}` | {_arguments(spec) or 'any'} |" for spec in specs)
        others = "\n\n".join(f"`{spec.id}`:\n\n{picture}" for spec, picture in zip(shown[1:], pictures[1:]))
        ids = f"## Registered Configurations\n\n| id | arguments |\n|---|---|\n{rows}\n\n{others}"
    text = PAGE.format(
        title=_name(specs[0]),
        summary=summary,
        picture="".join(pictures[:1]),
        id=specs[0].id,
        entry_point=entry_point,
        action=env.action_space,
        observation="<br>".join(f"`{name}`: `{part}`" for name, part in parts) or f"`{env.observation_space}`",
        ids=ids,
        body=_spell_out(body),
    )
    env.close()
    return text


def _name(spec: EnvSpec) -> str:
    """Return an id without namespace and version."""
    return spec.id.partition("/")[2].rpartition("-")[0]


def _slug(spec: EnvSpec) -> str:
    """Return the file name of an id without suffix."""
    return spec.id.partition("/")[2].lower()


def _docstring(entry_point: str) -> tuple[str, str]:
    """Return the first line of the docstring, and the rest with links to pages of the site."""
    first, _, rest = (inspect.getdoc(load_env_creator(entry_point)) or "").partition("\n")
    return first, re.sub(r"\bdocs/(\w+)/(\w+)\.md", r"[\2](../../\1/\2.md)", rest.strip())


def _linked(text: str, own: str, names: Mapping[str, str]) -> str:
    """Return the text of a page with links to the pages of other tasks that it names."""

    def link(found: re.Match[str]) -> str:
        page = found[1].lower()
        return f"[{found[0]}]({page}.md)" if page in names.values() and page != own else found[0]

    return re.sub(r"`(\w+?)(?:-v0|Env)?`(?!\])", link, text)


def _spell_out(body: str) -> str:
    """Replace "as in `Explore`" by the text of that task's docstring."""
    rest = _docstring(EXPLORE)[1]
    rows = dict(re.findall(r"^\| `(\w+)`[^|]*\| `Box[^|]*\| (.*) \|$", rest, re.MULTILINE))
    channels = re.search(r"^Map channels: .*?(?=\n\n)", rest, re.MULTILINE | re.DOTALL)
    body = re.sub(
        r"^(\| `(\w+)`[^|]*\|[^|]*\| )as in `Explore`", lambda row: row[1] + rows[row[2]], body, flags=re.MULTILINE
    )
    return body.replace("Map channels as in `Explore`.", channels[0] if channels else "")


def _arguments(spec: EnvSpec) -> str:
    """Return the arguments of an id as Markdown."""
    return ", ".join(f"`{name}={value!r}`" for name, value in spec.kwargs.items() if name != "task")
