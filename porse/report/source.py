"""Generated code as HTML: highlighted, and what differs from an earlier version. The text is hostile: it is escaped."""

import difflib

from markupsafe import Markup
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexer import Lexer
from pygments.lexers.diff import DiffLexer
from pygments.lexers.python import PythonLexer

from porse.printing import visible

_FORMATTER = HtmlFormatter(nowrap=True)
_CONTEXT = 3
"""Equal lines that are shown around a difference."""


def style_sheet() -> str:
    """Returns the style sheet that `listing` and `differences` are coloured by."""
    return str(_FORMATTER.get_style_defs("pre"))


def listing(source: str) -> Markup:
    """Returns Python source, whatever is in it, as escaped and highlighted HTML."""
    return _marked(source, PythonLexer())


def differences(before: str, after: str) -> Markup:
    """Returns what differs between two sources as escaped HTML; empty where nothing does."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=_CONTEXT, lineterm="")
    # The first two lines name files, and there are none.
    return _marked("\n".join(list(lines)[2:]), DiffLexer())


def _marked(text: str, lexer: Lexer) -> Markup:
    # Safe: the formatter escapes every token (`<`, `>`, `&` and both quotes), and adds only its own spans.
    return Markup(highlight(visible(text), lexer, _FORMATTER).strip("\n"))
