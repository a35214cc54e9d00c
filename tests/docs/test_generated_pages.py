import importlib
import re
from pathlib import Path

import gymnasium
import pytest
from gymnasium.envs.registration import load_env_creator

from lidarnaut.envs.navigation import CANDIDATE, Candidates
from lidarnaut.envs.robots import ROBOT_NAMES
from lidarnaut.envs.task import SHARED_QUANTITIES, Rewards
from lidarnaut.envs.worlds import BARN_NAMES

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module", autouse=True)
def environment_pages():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS / "_ext")
        yield importlib.import_module("environment_pages")


@pytest.fixture(scope="module")
def pages(environment_pages):
    return environment_pages.pages(DOCS)


def test_environments_have_a_page_with_picture_spaces_and_docstring(pages):
    for spec in gymnasium.registry.values():
        if spec.namespace == "lidarnaut":
            card = rf":link: (\w+)\n.*\n:img-top: \.\./\.\./(\S+)\n:img-alt: {spec.id}\n"
            ((name, film),) = re.findall(card, pages["index.md"])
            assert f"`{spec.id}`" in pages[f"{name}.md"] or f'make("{spec.id}"' in pages[f"{name}.md"]
            assert (DOCS / film).stat().st_size < 500_000
    for name in set(pages) - {"index.md"}:
        (picture, *_) = re.findall(r"!\[[^\]]*\]\(\.\./\.\./(\S+)\)", pages[name])
        assert (DOCS / picture).stat().st_size < 500_000, name
        for part in ("**action space**", "**observation space**", "## Rewards", "## Episode End", "## Arguments"):
            assert part in pages[name], (name, part)
    texts = re.findall(r":img-alt: (lidarnaut/Explore\w*-v0)\n\n(.*)\n", pages["index.md"])
    assert len(texts) >= 8
    assert len({text for _, text in texts}) == len(texts)
    assert len([text for _, text in texts if re.search(r"Free area: \d+( to \d+)?\sm²\.", text)]) == 7


@pytest.mark.parametrize("task", sorted({s.kwargs["task"] for s in gymnasium.registry.values() if "task" in s.kwargs}))
def test_docstrings_of_tasks_list_the_terms_of_their_rewards(task, environment_pages):
    kind = load_env_creator(task)
    terms = environment_pages.terms(kind)
    assert {name: float(terms[name][0]) for name in kind.weights} == dict(kind.weights)
    assert set(terms) - set(kind.weights) <= {"returned"}
    assert all(meaning and unit in ("", "m2", "m", "s", "m and s") for _, unit, meaning in terms.values())


def test_the_tables_of_quantities_show_each_task_once(environment_pages):
    text = environment_pages.quantities()
    assert re.findall(r"^`lidarnaut/(\w+)-v0`:$", text, re.MULTILINE) == [
        *("Explore", "ExploreTeam", "Navigate", "Dock", "Sweep", "ReachGoal", "Track")
    ]
    assert "| `swept` | m² | 1 | newly swept floor |" in text
    assert "| `completed` | 1 | 10 | once, at `target_swept` |" in text
    assert "| `deviation` | m s | -2 | away from the route |" in text


def test_help_lists_the_shared_quantities_and_the_fields_of_candidates():
    listed = re.findall(r"^ *- (`.+`): ", Rewards.__doc__, re.MULTILINE)
    assert sorted(re.findall(r"`(\w+)`", " ".join(listed))) == sorted(SHARED_QUANTITIES)
    fields = re.findall(r"^ *- `(\w+)`: ", Candidates.__doc__, re.MULTILINE)
    assert fields == [*CANDIDATE.names[: CANDIDATE.names.index("goal")]]


def test_all_keys_of_robot_files_have_type_and_meaning():
    pytest.importorskip("sphinx")  # comes with `make docs`
    import robot_keys

    tables = robot_keys.tables()
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \| (.*?) \| (.+?) \| (.+?) \|$", tables, re.MULTILINE)
    assert len(rows) == len(re.findall(r"^\| `", tables, re.MULTILINE)) > 50
    about = "Maximum forward and backward speed."
    assert ("max_v", "number\N{NO-BREAK SPACE}>\N{NO-BREAK SPACE}0", "m/s", "**required**", about) in rows
    gyro = next(row for row in rows if row[0] == "uses_gyro")
    assert gyro[1:4] == ("`true` or `false`", "", "`false`")
    assert "gyroscope" in gyro[4]


def test_the_gallery_shows_worlds_with_sizes_and_sources_and_robots(tmp_path, monkeypatch):
    """Of a few worlds: `make docs` draws all."""
    import gallery

    worlds = "turtlebot3_world", "pimouse_arena"
    for name, names in (("WORLD_NAMES", worlds), ("BARN_NAMES", BARN_NAMES[:1]), ("ROBOT_NAMES", ROBOT_NAMES[:2])):
        monkeypatch.setattr(gallery, name, names)
    monkeypatch.setattr(gallery, "FAMILIES", {"rooms": gallery.FAMILIES["rooms"]})
    pages = gallery.pages(tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == sum(text.count(".png") for text in pages.values())
    assert all(f"- `{name}`: " in pages["worlds.md"] for name in worlds)
    assert "8.0 m x 6.8 m; free area 19.7 m² and 13.1 m²; licence: Apache-2.0" in pages["worlds.md"]


def test_the_page_of_examples_shows_all_of_them():
    pytest.importorskip("sphinx")  # comes with `make docs`
    import generated_pages

    page = generated_pages.example_page(DOCS.parent / "examples")
    assert page.count("{literalinclude}") == len(list(DOCS.parent.glob("examples/*.py")))
