"""Links between the Markdown files, and files, modules and configurations that they name: all of them are there."""

import importlib.util
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[1]
GENERATED = ("docs/environments/", "docs/examples/", "docs/gallery/")
"""Folders that the documentation makes when it is built; Sphinx checks links to them."""
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder, pattern in ((ROOT, "*.md"), (ROOT / "docs", "**/*.md"), (ROOT / "agents", "**/*.md"))
    for path in folder.glob(pattern)
    if not path.relative_to(ROOT).as_posix().startswith(GENERATED)
)


def prose(path):
    """Return a page without code, which may look like links."""
    text = re.sub(r"^(`{3,}|~{3,}).*?^\1", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"(?<!`)`[^`\n]+`(?!`)", lambda code: code[0].replace("](", "] ("), text)


def anchors(path):
    """Return what links to the headings of a page end with, as GitHub makes it."""
    found, text = [], re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for heading in re.findall(r"^#+ +(.+?) *$", text, re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        found.append(f"{slug}-{found.count(slug)}" if slug in found else slug)
    return found


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    path, broken = ROOT / page, []
    for link in re.findall(r"\]\(<?([^)\s>]+)>?(?: \"[^\"]*\")?\)", prose(path)):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = unquote(link).partition("#")
        target = (path.parent / name).resolve() if name else path
        if not target.is_relative_to(ROOT) or target.relative_to(ROOT).as_posix().startswith(GENERATED):
            continue
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def missing(text):
    """Return what a page names in code and what is not there: paths, modules of commands, configurations."""
    paths = re.findall(r"`((?:envs|agents|baselines|benchmarks|configs|tests|docs|examples)/[\w/.]*)`", text)
    modules = re.findall(r"python -m ([\w.]+)", text)
    configs = re.findall(r"--config ([a-z_]+)(?=\s|`)", text)
    found = [path for path in paths if not (ROOT / path).exists() and "my_" not in path]
    found += [name for name in modules if "my_" not in name and not importlib.util.find_spec(name)]
    return found + [name for name in configs if not list((ROOT / "configs").rglob(f"{name}.yaml"))]


@pytest.mark.parametrize("page", [page for page in PAGES if "notes/" not in page and page != "CHANGELOG.md"])
def test_files_modules_and_configurations_are_there(page):
    assert missing((ROOT / page).read_text(encoding="utf-8")) == []


def test_a_broken_link_would_be_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A `head` of [mine](x.md)\n\n```\n# no heading\n[no](link)\n```\n`[no](link)` [yes](#a-head-of-mine)\n"
    )
    assert anchors(page) == ["a-head-of-mine"]
    assert re.findall(r"\]\(([^)]+)\)", prose(page)) == ["x.md", "#a-head-of-mine"]
    assert missing("`envs/x.py` `envs/core.py` `python -m envs.x` --config x ") == ["envs/x.py", "envs.x", "x"]
