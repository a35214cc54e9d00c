"""Prose of the project against a limit of idioms, with other packages as anchors."""

import importlib.util
from pathlib import Path

import pytest

from tests.language import count

ROOT = Path(__file__).parents[2]
LIMIT = 3.5
"""Maximum number of idioms per 1,000 words."""
# Files of this test contain idioms as data.
TESTS = [path for path in sorted((ROOT / "tests").rglob("*.py")) if path.stem not in ("language", "test_language")]
CODE = ("envs", "agents", "baselines", "benchmarks", "examples", "lidarnaut/__init__.py", "train.py", "evaluate.py")
PAGES = ("docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "PYPI.md")
PAIRS = {
    "What the last scan changed in the map.": "Changes of the map by the last scan.",
    "Return the parts of which a map is made.": "Return the parts of a map.",
    "Cells known to be free, but for ignored ones.": "Free cells, except ignored cells.",
    "Tell whether a pose is free.": "Return True if a pose is collision-free.",
    "Sectors in place of beams.": "Sectors instead of beams.",
    "The map beside the robot's pose.": "The map and the pose of the robot.",
    "Nobody walks into a wall.": "People avoid walls.",
    "None where there is no map.": "None without a map.",
    "A wall is as thick as one.": "Walls have a thickness of one cell.",
    "Turn by how much the path bends.": "Turn by the curvature of the path.",
    "Neither cell is known.": "Both cells are unknown.",
    "People, who see the robot; who does not, walks on.": "People react to the robot, unless they are inattentive.",
}


@pytest.mark.parametrize("group", [CODE, TESTS, PAGES], ids=["code", "tests", "pages"])
def test_prose_stays_below_the_limit(group):
    rate, hits = count(*(ROOT / name for name in group))
    assert rate <= LIMIT, "\n".join(hits[:50])


@pytest.mark.parametrize(
    "package",
    ["gymnasium", *(pytest.param(name, marks=pytest.mark.slow) for name in ("scipy.spatial", "stable_baselines3"))],
)
def test_established_packages_stay_far_below_the_limit(package):
    """The patterns hit idioms, and not the plain English of the field."""
    if importlib.util.find_spec(package.partition(".")[0]) is None:
        pytest.skip(f"{package} is not installed")
    (folder,) = importlib.util.find_spec(package).submodule_search_locations
    rate, hits = count(Path(folder))
    assert 0.0 < rate < 0.4 * LIMIT, "\n".join(hits[:50])


@pytest.mark.parametrize(("idiom", "plain"), PAIRS.items())
def test_idioms_are_hits_and_their_plain_forms_are_not(idiom, plain, tmp_path):
    for text, is_hit in ((idiom, True), (plain, False)):
        for name, content in (("page.md", text), ("module.py", f'"""{text}"""'), ("comment.py", f"x = 1  # {text}")):
            (file := tmp_path / name).write_text(content)
            assert bool(count(file)[1]) == is_hit, (name, text)


def test_code_is_left_out_and_messages_are_counted(tmp_path):
    (page := tmp_path / "page.md").write_text("Call `what(nobody)`.\n```\nwhat is told\n```\n")
    (module := tmp_path / "module.py").write_text('raise ValueError(f"nobody is at {x}")\n')
    assert count(page)[1] == []
    assert len(count(module)[1]) == 1
