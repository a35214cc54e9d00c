import functools
import html
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import lidarnaut
from tests.browser import needs_browser, visit

SITE = Path(os.environ.get("LIDARNAUT_SITE", ""))
"""Folder of the site; set by `make docs` after the build."""
needs_site = pytest.mark.skipif(not os.environ.get("LIDARNAUT_SITE"), reason="`make docs` builds the site")
PLAYER = "episode.html"
NOTEBOOKS = sorted(Path(__file__).parents[2].glob("docs/start/tutorials/*.ipynb"))


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.anchors, self.targets = {"", "top"}, []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.anchors |= {values[key] for key in ("id", "name") if values.get(key)}
        self.targets += [values[key] for key in ("href", "src", "data", "poster") if values.get(key) is not None]
        self.targets += [part.split()[0] for part in (values.get("srcset") or "").split(",") if part.strip()]


@functools.cache
def read_page(path):
    return Page(path.read_text(encoding="utf-8"))


def broken_links(page):
    """Return the targets of a page or stylesheet within the site that do not exist."""
    if page.suffix == ".css":
        targets = re.findall(r"url\([\"']?([^\"')]+)", page.read_text(encoding="utf-8"))
    else:
        targets = read_page(page).targets
    broken = []
    for target in targets:
        address = urlsplit(target)
        if address.scheme or address.netloc:
            continue
        path = (page.parent / unquote(address.path)).resolve() if address.path else page
        if not path.is_file() or (path.suffix == ".html" and unquote(address.fragment) not in read_page(path).anchors):
            broken.append(target)
    return broken


@needs_site
def test_links_images_styles_and_downloads_lead_somewhere():
    pages = [path for pattern in ("*.html", "*.css") for path in sorted(SITE.resolve().rglob(pattern))]
    assert len(pages) > 40
    assert {str(page): broken for page in pages if (broken := broken_links(page))} == {}


@needs_site
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_tutorials_show_their_figures_and_offer_their_notebook(notebook):
    cells = ["".join(c["source"]) for c in json.loads(notebook.read_text())["cells"] if c["cell_type"] == "code"]
    num_plots = sum("plt." in cell for cell in cells)
    assert num_plots > 0
    targets = read_page(SITE / "start/tutorials" / f"{notebook.stem}.html").targets
    figures = [target for target in targets if re.search(r"_images/[0-9a-f]{64}\.png$", target)]  # of cells
    assert len(figures) >= num_plots
    (target,) = [target for target in targets if target.endswith(notebook.name)]
    assert json.loads((SITE / "start/tutorials" / target).read_text())["cells"]


@needs_site
def test_what_tutorials_train_is_better_than_untrained():
    explorer, people, own = (
        (SITE / "start/tutorials" / f"{name}.html").read_text(encoding="utf-8")
        for name in ("train_an_explorer", "learn_among_people", "own_world_to_robot")
    )
    untrained = int(re.search(r"untrained: +\d+ % explored, (\d+) s", explorer).group(1))
    trained = int(re.search(r"^trained: +\d+ % explored, (\d+) s; nearest: \d+ s", explorer, re.M).group(1))
    assert trained < untrained  # with six seeds 12 to 19 s after training, 40 to 47 s before
    untrained, trained = map(float, re.findall(r"trained.*: \d+ %.*, SCT ([\d.]+)", people))
    assert trained > untrained  # with four seeds 0.27 to 0.40 after training, 0 to 0.08 before
    assert people.count('<iframe class="episode" title="A recorded episode" srcdoc=') == 1
    untrained, trained = map(float, re.findall(r"trained: \d+ % of the goals, .* ([\d.]+)$", own, re.M))
    assert trained > untrained  # with five seeds 0.77 to 0.88 after training, 0.02 to 0.52 before
    assert "report.html" in own
    assert re.search(r"\d+ kB, sees_around, every 0.1 s", own)
    assert re.search(r"(reached|wall|person|time_limit) after [\d.]+ s and [\d.]+ m", own)
    assert len(re.findall(r"goal \(.*\): (?:reached|not reached) at [\d.]+ s$", own, re.M)) == 3


@pytest.fixture(scope="module")
def answer():
    paths = ",".join(path.relative_to(SITE).as_posix() for path in sorted(SITE.rglob("*.html")))
    return visit(SITE, Path(__file__).with_name("site.html"), f"widths=1280,390&pages={paths}")


@needs_site
@needs_browser
def test_nothing_lies_out_of_reach_and_code_is_not_cut(answer):
    for width, pages in answer["pages"].items():
        assert {name: page for name, page in pages.items() if page["page"] > 0 or page["cut"]} == {}, width
        for name, page in pages.items():
            assert [what for what in page["scrolled"] if width == "1280" or what.startswith("pre")] == [], (width, name)


@needs_site
@needs_browser
def test_the_sidebar_unfolds_the_section_of_the_open_page_beside_text_and_contents_at_1280_pixels(answer):
    pages = {name: page["navigation"] for name, page in answer["pages"]["1280"].items() if name != PLAYER}
    assert sum(page["hasContents"] for page in pages.values()) > 40
    assert pages["index.html"]["open"] == pages["genindex.html"]["open"] == ["Get started"]
    assert pages["reference/environments/reachgoal.html"]["open"] == ["Reference"]
    assert pages["guides/customize/robot.html"]["open"] == ["Guides"]
    for name, page in pages.items():
        assert page["sections"] >= 6, name
        assert len(page["open"]) == 1, name
        assert page["links"] < 25, name
        assert page["isContentsInView"] or not page["hasContents"], name
        assert page["text"] > 700, name


@needs_site
@needs_browser
@pytest.mark.parametrize("size", [(1280, 800), (784, 736)], ids=["window", "frame"])
def test_the_recorded_episode_fits_its_window_and_frame(size):
    harness = Path(__file__).parents[1] / "player" / "harness.html"
    answer = visit(SITE, harness, f"page={PLAYER}&width={size[0]}&height={size[1]}&brief=1")
    assert answer["errors"] == []
    assert answer["layout"]["scrolled"] <= 0
    assert answer["layout"]["controls"]["bottom"] <= size[1]


@needs_site
def test_the_api_page_documents_the_public_names_with_types():
    page = (SITE / "reference/api" / "index.html").read_text(encoding="utf-8")
    for name in set(lidarnaut.__all__) - {"__version__"}:
        assert f'id="lidarnaut.{name}"' in page, name
    signature = page[page.index('id="lidarnaut.evaluate"') :]
    text = re.sub(r"<[^>]+>", "", signature[: signature.index("</dt>")])
    assert re.search(r"id:\s+str\s+=\s+'lidarnaut/Explore-v0'", html.unescape(text))
    for path in sorted((SITE / "reference/api").glob("*.html")):
        assert "FieldInfo(" not in path.read_text(encoding="utf-8"), path.name


def test_a_broken_link_would_be_found(tmp_path):
    (tmp_path / "b.html").write_text('<p id="here"><a name="there"></a></p>')
    page = tmp_path / "a.html"
    page.write_text(
        '<a href="b.html#here">1</a><a href="b.html#there">2</a><a href="https://example.org/x">3</a><a href="#">4</a>'
        '<a href="b.html#away">5</a><img src="c.png"><link href="d.css?v=1">'
    )
    assert broken_links(page) == ["b.html#away", "c.png", "d.css?v=1"]
    style = tmp_path / "e.css"
    style.write_text("p { background: url(f.svg) } a { background: url('data:image/svg+xml;x') }")
    assert broken_links(style) == ["f.svg"]
