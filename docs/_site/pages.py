"""A hook of MkDocs: the documentation site is made of the Markdown that a code host shows, and of what it links to.

README.md, CONTRIBUTING.md and CHANGELOG.md are pages of the site. So is every file or folder of the project that a page
links to: a file as its text, a folder as the list of what is in it. Nothing is copied by hand, no address of a code host is
needed, and a link that leads nowhere ends the build (`mkdocs build --strict`).
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
DOCS = "docs/"
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
SOURCES = "source"
"""Folder of the site for what lies outside `docs/`."""

LEXERS = {".py": "python", ".yaml": "yaml", ".sh": "sh", ".toml": "toml", ".cff": "yaml", ".jinja": "jinja"}

_FENCE = re.compile(r"^(```+).*?^\1$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]*)?\)")
_INFO = re.compile(r"^(```+\w+) .*$", re.MULTILINE)
_INDENT = re.compile(r"^  (?=\S)", re.MULTILINE)
_PIPE = re.compile(r"`([^`\n]*\\\|[^`\n]*)`")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that lie outside `docs/`, and what any page links to."""
    waiting = [*PAGES, *(DOCS + file.src_uri for file in files.documentation_pages())]
    seen = set(waiting)
    while waiting:
        path = waiting.pop()
        text = _text(path)
        if not _is_document(path):
            files.append(File.generated(config, _uri(path), content=text))
        if not path.endswith(".md") and not (ROOT / path).is_dir():
            continue
        for target in _targets(path, text):
            if target not in seen and not _is_document(target):
                seen.add(target)
                waiting.append(target)
    files.append(
        File.generated(config, "assets/iframe-worker.js", abs_src_path=str(Path(__file__).with_name("search.js")))
    )
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Returns a page's Markdown with links as the site has them, and in the dialect that MkDocs reads."""
    path = _place(page.file.src_uri)
    if not path.endswith(".md") and not (ROOT / path).is_dir():
        return markdown
    start = page.file.src_uri

    def link(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        if not target or "://" in target:
            return match[0]
        return f"]({posixpath.relpath(_uri(_absolute(path, target)), posixpath.dirname(start) or '.')}{anchor})"

    def prose(text: str) -> str:
        # A code host takes two spaces for what belongs to a list's item, MkDocs four; and it escapes no bar in code.
        text = _INDENT.sub("    ", _LINK.sub(link, text))
        return _PIPE.sub(lambda match: f"<code>{match[1].replace(chr(92) + '|', '&#124;')}</code>", text)

    parts, end = [], 0
    for fence in _FENCE.finditer(markdown):
        parts += [prose(markdown[end : fence.start()]), _INFO.sub(r"\1", fence[0])]
        end = fence.end()
    return "".join([*parts, prose(markdown[end:])])


def _targets(path: str, text: str) -> set[str]:
    found = {match[1] for match in _LINK.finditer(_FENCE.sub("", text))}
    return {_absolute(path, target) for target in found if target and "://" not in target}


def _absolute(path: str, target: str) -> str:
    """Returns the path of a link's target from the project's root."""
    folder = path if (ROOT / path).is_dir() else posixpath.dirname(path)
    found = posixpath.normpath(posixpath.join(folder, target))
    if found.startswith("..") or not (ROOT / found).exists():
        raise PluginError(
            f"Expected a file or a folder of the project at {target}, which {path} links to; there is none."
        )
    return found


def _is_document(path: str) -> bool:
    return path.startswith(DOCS) and not (ROOT / path).is_dir()


def _uri(path: str) -> str:
    """Returns where the site has a file or a folder of the project."""
    if _is_document(path):
        return path.removeprefix(DOCS)
    if path in PAGES:
        return PAGES[path]
    if (ROOT / path).is_dir():
        return f"{SOURCES}/{path}/contents.md"
    return f"{SOURCES}/{path}" + ("" if path.endswith(".md") else ".md")


def _place(uri: str) -> str:
    """Returns which file or folder of the project a page of the site is."""
    for path, its in PAGES.items():
        if uri == its:
            return path
    if not uri.startswith(f"{SOURCES}/"):
        return DOCS + uri
    path = uri.removeprefix(f"{SOURCES}/")
    if path.endswith("/contents.md"):
        return path.removesuffix("/contents.md")
    return path if (ROOT / path).is_file() else path.removesuffix(".md")


def _text(path: str) -> str:
    """Returns the Markdown of a page, of a file's page, or of a folder's page."""
    file = ROOT / path
    if file.is_dir():
        about = file / "README.md"
        head = about.read_text(encoding="utf-8") if about.is_file() else f"# {path}\n"
        names = sorted(f"- `{each.name}{'/' if each.is_dir() else ''}`" for each in file.iterdir() if _shown(each))
        return "\n".join([head, "## Files", "", *names, ""])
    text = file.read_text(encoding="utf-8")
    if path.endswith(".md"):
        return text
    return f"# {path}\n\n`````{LEXERS.get(file.suffix, 'text')}\n{text}\n`````\n"


def _shown(path: Path) -> bool:
    return not path.name.startswith((".", "__pycache__"))
