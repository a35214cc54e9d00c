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
GENERATED = "<!-- generated: "
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if GENERATED in path.read_text(encoding="utf-8")]
NUMBER = re.compile(r" *[\d.]+")
REWRITE = "python docs/_ext/page_parts.py writes these parts anew"


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
            row = rf"^\| !\[{spec.id}\]\(\.\./\.\./(\S+)\) \| \[`{spec.id}`\]\((\w+)\.md\)<br>"
            ((film, name),) = re.findall(row, pages["index.md"], re.MULTILINE)
            assert f"`{spec.id}`" in pages[f"{name}.md"] or f'make("{spec.id}"' in pages[f"{name}.md"]
            assert (DOCS / film).stat().st_size < 500_000
    for name in set(pages) - {"index.md"}:
        (picture, *_) = re.findall(r"!\[[^\]]*\]\(\.\./\.\./(\S+)\)", pages[name])
        assert (DOCS / picture).stat().st_size < 500_000, name
        for part in ("**action space**", "**observation space**", "## Rewards", "## Episode End", "## Arguments"):
            assert part in pages[name], (name, part)
    texts = re.findall(r"\[`(lidarnaut/Explore\w*-v0)`\]\(\w+\.md\)<br>(.*?)<br>", pages["index.md"])
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


def test_help_lists_the_shared_quantities_and_the_fields_of_candidates():
    listed = re.findall(r"^ *- (`.+`): ", Rewards.__doc__, re.MULTILINE)
    assert sorted(re.findall(r"`(\w+)`", " ".join(listed))) == sorted(SHARED_QUANTITIES)
    fields = re.findall(r"^ *- `(\w+)`: ", Candidates.__doc__, re.MULTILINE)
    assert fields == [*CANDIDATE.names[: CANDIDATE.names.index("goal")]]


def test_all_keys_of_robot_files_have_type_and_meaning():
    import robot_keys

    tables = robot_keys.tables()
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \| (.*?) \| (.+?) \| (.+?) \|$", tables, re.MULTILINE)
    assert len(rows) == len(re.findall(r"^\| `", tables, re.MULTILINE)) > 50


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


def test_committed_pages_of_environments_are_those_of_the_code(pages):
    found = {path.name: path.read_text(encoding="utf-8") for path in (DOCS / "reference/environments").glob("*.md")}
    assert found == pages, REWRITE


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_generated_parts_of_pages_are_those_of_the_code(page, environment_pages):
    import page_parts

    text = page.read_text(encoding="utf-8")
    if "<!-- generated: policies" in text:
        pytest.importorskip("torch")
    assert text.count(GENERATED) == len(page_parts.PART.findall(text))
    assert page_parts.filled(text, without=("printed",)) == text, REWRITE


def test_pages_show_what_their_examples_print(environment_pages):
    pytest.importorskip("torch")  # whose policies examples name
    import page_parts

    pages = [path.read_text(encoding="utf-8") for path in sorted(DOCS.glob("guides/customize/*.md"))]
    printed = [text for text in pages if "<!-- generated: printed" in text]
    assert len(printed) == 8
    for text in printed:  # numbers may differ between processors
        assert NUMBER.sub("#", page_parts.filled(text)) == NUMBER.sub("#", text), REWRITE


def test_a_changed_part_would_be_found(environment_pages):
    import page_parts

    text = "a\n<!-- generated: source examples/own_robot.py -->\n\nold\n\n<!-- end -->\nb\n"
    filled = page_parts.filled(text)
    assert filled.startswith("a\n<!-- generated: source examples/own_robot.py -->\n\n```python\n")
    assert filled.endswith("\n```\n\n<!-- end -->\nb\n")
    assert page_parts.filled(filled) == filled
