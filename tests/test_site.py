"""The documentation site: every page is built from the Markdown of the project, and no page needs a network."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest
import yaml

from browser import CHROMIUM, browser
from tiny import ROOT

BUILD = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--config-file", str(ROOT / "mkdocs.yml")]


class Parts(HTMLParser):
    """Collects what a page loads, its links and its anchors."""

    def __init__(self, text):
        super().__init__()
        self.loads, self.links, self.anchors = [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if "id" in found:
            self.anchors.add(found["id"])
        if tag == "a":
            self.links.append(found.get("href") or "")
        elif tag in ("script", "img", "iframe") and found.get("src"):
            self.loads.append(found["src"])
        elif tag == "link" and found.get("rel") in ("stylesheet", "preload", "preconnect"):
            self.loads.append(found["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "site"
    done = subprocess.run(
        [*BUILD, "--site-dir", str(folder)],
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def parts(site):
    return {path.relative_to(site).as_posix(): Parts(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


def test_every_page_of_the_project_is_a_page_of_the_site(parts):
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert {"index.html", "contributing.html", "changelog.html", *pages} <= {*parts}


def test_every_page_of_docs_is_in_the_navigation():
    # Tags of YAML in the file are MkDocs' own.
    text = re.sub(r"!!python/\S+ ", "", (ROOT / "mkdocs.yml").read_text())
    named = set(re.findall(r"'([\w-]+\.md)'", str(yaml.safe_load(text)["nav"])))
    assert {path.name for path in (ROOT / "docs").glob("*.md")} <= named


def test_a_page_loads_nothing_from_elsewhere(parts):
    for name, page in parts.items():
        assert [address for address in page.loads if "//" in address] == [], name


def test_a_link_leads_to_a_page_and_an_anchor_of_the_site(site, parts):
    for name, page in parts.items():
        if name == "404.html":
            continue
        for link in page.links:
            target, _, anchor = link.partition("#")
            if "//" in target:
                continue
            path = (site / name).parent.joinpath(target).resolve() if target else site / name
            path = path / "index.html" if path.is_dir() else path
            assert path.is_file(), f"{name}: {link}"
            if anchor and path.suffix == ".html":
                assert anchor in parts[path.relative_to(site).as_posix()].anchors, f"{name}: {link}"


def test_a_source_file_that_a_page_links_to_is_shown_as_its_text(site):
    page = (site / "source" / "porse" / "iteration.py.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", "", page)
    assert "The algorithm in one place" in text
    assert 'href="source/porse/iteration.py.html"' in (site / "index.html").read_text(encoding="utf-8")


@pytest.mark.skipif(CHROMIUM is None, reason="no browser: set PORSE_CHROMIUM, or have chromium on the PATH")
@pytest.mark.parametrize(("width", "height", "phone"), [(1280, 900, False), (390, 844, True)], ids=["desktop", "phone"])
def test_a_page_fits_the_window_and_asks_no_host(site, tmp_path, width, height, phone):
    with browser(tmp_path / "profile") as window:
        for page in ("index.html", "tasks.html", "data.html", "source/porse/iteration.py.html"):
            window.open(site / page, width, height, phone=phone)
            assert window.value("document.documentElement.scrollWidth") <= width, page
            assert [address for address in window.requests if not address.startswith("file:")] == []
            assert window.complaints == [], page
