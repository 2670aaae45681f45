"""Pages in a headless Chromium that reaches no host: what they show, how wide they are, and that nothing complains.

`PORSE_CHROMIUM` names the browser, or one is on the `PATH`; without one these tests are skipped.
"""

import io

import pytest
from PIL import Image

import kills
from at_once import run_at_once
from browser import CHROMIUM, browser
from porse.config import parse_params
from porse.generation.states import checker
from porse.report.page import MOST_BYTES, Film, page_of, render
from porse.report.results import read_results

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser: set PORSE_CHROMIUM, or have chromium on the PATH")

SHAPES = {"desktop": (1280, 900, False), "phone": (390, 844, True)}


@pytest.fixture(scope="module")
def page(tmp_path_factory, root):
    """The page of a tiny run, with a film of two grey frames."""
    folder = tmp_path_factory.mktemp("browser") / "run"
    with checker(parse_params(kills.tiny_params(), "a test")) as check:
        run_at_once(folder, kills.tiny_params(), check)
    film = io.BytesIO()
    frames = [Image.new("L", (320, 240), level) for level in (90, 60)]
    frames[0].save(film, "GIF", save_all=True, append_images=frames[1:], duration=40, loop=0)
    path = folder / "report.html"
    path.write_text(
        render(page_of(read_results(folder), Film(film.getvalue(), 320, 240, "two frames"))), encoding="utf-8"
    )
    return path


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.mark.parametrize("shape", SHAPES)
def test_the_report_fits_the_window_asks_for_nothing_and_nothing_complains(page, window, shape):
    width, height, phone = SHAPES[shape]
    window.open(page, width, height, phone=phone)
    # All that is folded, too.
    window.value("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert window.value("document.documentElement.scrollWidth") <= width
    assert window.complaints == []
    assert window.requests == [page.resolve().as_uri()]
    assert page.stat().st_size <= MOST_BYTES


@pytest.mark.parametrize("shape", SHAPES)
def test_charts_tree_film_and_code_are_drawn(page, window, tmp_path, shape):
    width, height, phone = SHAPES[shape]
    window.open(page, width, height, phone=phone)
    window.value("document.querySelectorAll('details').forEach(each => each.open = true)")
    parts = {
        "figure svg": 12, "svg.tree": 1, "figure.film img": 1, "details pre": 3, "dl.answers": 1, "table.beside": 1,
    }  # fmt: skip
    for selector, least in parts.items():
        found = window.value(f"document.querySelectorAll('{selector}').length")
        assert found >= least, selector
        box = window.value(
            f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
            " return [b.left + scrollX, b.top + scrollY, b.width, b.height].map(Math.round) })()"
        )
        assert min(box[2:]) >= 20, f"{selector} is {box[2]} x {box[3]}"
        target = tmp_path / "part.png"
        window.picture(target, (*box[:2], min(box[2], width), min(box[3], 2000)))
        with Image.open(target) as shown:
            assert shown.size == (min(box[2], width), min(box[3], 2000))
            levels = shown.convert("L").getextrema()
        # A grey film is one level; of all else the ink is dark and the paper white.
        assert levels[0] < 130, f"{selector} is blank: {levels}"
        if "img" not in selector:
            assert levels[1] > 240, f"{selector} has no paper: {levels}"


def test_a_film_is_an_image_that_the_browser_can_read(page, window):
    window.open(page, 1280, 900)
    assert window.value("document.querySelector('.film img').naturalWidth") == 320


def test_the_report_is_printed_on_some_sheets(page, window, tmp_path):
    window.open(page, 1280, 900)
    window.paper(tmp_path / "page.pdf")
    paper = (tmp_path / "page.pdf").read_bytes()
    assert paper.startswith(b"%PDF")
    assert 2 <= paper.count(b"/Type /Page\n") <= 30
    assert window.complaints == []


def test_a_page_that_asks_for_something_or_fails_is_noticed(window, tmp_path):
    """The tests above would be worth nothing if the browser told nobody."""
    bad = tmp_path / "bad.html"
    bad.write_text(
        "<p style='width: 900px'>x<script>throw Error('no')</script><img src='https://an.invalid/picture.png'>"
    )
    window.open(bad, 390, 844, phone=True)
    assert window.value("document.documentElement.scrollWidth") > 390
    assert "https://an.invalid/picture.png" in window.requests
    assert any("no" in complaint for complaint in window.complaints)
    window.complaints.clear()
