"""A reply to plain lines, and lines to blocks by indentation and brackets: functions, and statements beside them."""

import ast
import html
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass

from porse.functions.read.source import parse_source
from porse.functions.verdict import CodeError

_FENCE = re.compile(r"\s*(`{3,}|~{3,})")
_DEF = re.compile(r"(\s*)(async\s+)?def\s+(\w+)\s*\(")
_OPEN = re.compile("was never closed|unterminated triple-quoted")
"""What Python says of a text that goes on."""
_THINKING = r"(think|thinking|reasoning)>"

_MAX_STATEMENT_LINES = 60


@dataclass(frozen=True)
class Block:
    """The lines of one function, or of one statement.

    Attributes:
        name: the function's name, "" for a statement.
        text: its lines, dedented, from `def` on.
        lines: the number of each line in the reply, counted from 1.
        region: which fenced or unfenced stretch of the reply it stands in.
        tree: what it is, None where it is no Python.
        error: why it is none.
        decorators: number and text of the decorator lines above it.
    """

    name: str
    text: tuple[str, ...]
    lines: tuple[int, ...]
    region: int
    tree: ast.stmt | None
    error: CodeError | None = None
    decorators: tuple[tuple[int, str], ...] = ()

    @property
    def complete(self) -> bool:
        """Whether it parses and returns a value somewhere."""
        return self.tree is not None and any(isinstance(n, ast.Return) and n.value for n in ast.walk(self.tree))


def unwrapped(reply: str) -> tuple[int, str]:
    """Returns the code that stands as a text in a reply's JSON, and the line of the reply that it begins on; "" for none."""
    start, end = reply.find("{"), reply.rfind("}")
    if start < 0 or re.search(r"^\s*(async\s+)?def\s", reply, re.MULTILINE):
        return 0, ""
    try:
        held = json.loads(reply[start : end + 1])
    except (ValueError, RecursionError):
        return 0, ""
    held = held.values() if isinstance(held, dict) else ()
    texts = [text for text in held if isinstance(text, str) and "def " in text]
    return reply.count("\n", 0, start) + 1, max(texts, key=len, default="")


def plain_lines(reply: str) -> list[str]:
    """Returns the lines of the reply with line ends, blanks, tabs, quotes of mail and escapes of HTML made plain."""
    text = _without_thinking(re.sub(r"\r\n?", "\n", reply))
    text = re.sub(r"[\u200b\u200d\u2060\ufeff\u00ad]", "", text).replace("\u00a0", " ")
    if re.search(r"<(pre|code)\b", text):
        text = re.sub(r"</?(pre|code|span)\b[^<>\n]*>", "", text)
    if re.search(r"&(gt|lt|quot|amp|#39);", text):
        text = html.unescape(text)
    lines = [line.rstrip().expandtabs(4) for line in text.split("\n")]
    if any(re.match(r">\s+(def|@)", line) for line in lines):
        lines = [re.sub(r"^>\s?", "", line) for line in lines]
    return lines


def _without_thinking(text: str) -> str:
    """Returns a text with blanks for what a model thought before it answered: drafts are no answer, closed or not."""
    begin = max((match.end() for match in re.finditer(f"</{_THINKING}", text)), default=0)
    start = re.compile(rf"^\s*<{_THINKING}", re.MULTILINE).search(text, begin)
    end = start.start() if start else len(text)
    return re.sub(r"[^\n]", "", text[:begin]) + text[begin:end] + re.sub(r"[^\n]", "", text[end:])


def blocks(lines: list[str]) -> Iterator[Block]:
    """Yields each function that is not inside another one, and each statement beside them, in order."""
    index = region = 0
    while index < len(lines):
        line = lines[index]
        region += bool(_FENCE.match(line))
        match = _DEF.match(line)
        block = _function(lines, index, match, region) if match else _statement(lines, index, region)
        if block is not None:
            yield block
        index += len(block.lines) if block is not None else 1


def _function(lines: list[str], start: int, match: re.Match[str], region: int) -> Block:
    """Returns the function that begins on a line and ends where its indentation does, but not while something is open."""
    indent = len(match[1])
    end, tree, error = start, None, None
    for _ in range(_MAX_STATEMENT_LINES):
        end = _end(lines, end + 1, indent)
        text = tuple(line[min(indent, _depth(line)) :] for line in lines[start:end])
        numbers = tuple(range(start + 1, end + 1))
        try:
            body = parse_source("\n".join(text)).body
            tree = body[0] if len(body) == 1 and isinstance(body[0], ast.FunctionDef) else None
            error = None if tree else CodeError("syntax", "expected one plain function", numbers[0])
        except CodeError as found:
            error = CodeError("syntax", str(found), numbers[min(max(found.line, 1), len(numbers)) - 1])
        if error is None or not _OPEN.search(str(error)) or end == len(lines) or _FENCE.match(lines[end]):
            break
    return Block(match[3], text, numbers, region, tree, error, tuple(_decorators(lines, start)))


def _end(lines: list[str], after: int, indent: int) -> int:
    """Returns the index after the last line, from one on, that is indented deeper, which a fence ends too."""
    end = after
    for index, line in enumerate(lines[after:], start=after):
        if line.strip() and _depth(line) > indent and not _FENCE.match(line):
            end = index + 1
        elif line.strip() and not line.lstrip().startswith("#"):
            break
    return end


def _statement(lines: list[str], start: int, region: int) -> Block | None:
    """Returns the statement that begins on a line and ends where its brackets do, None for prose."""
    if not lines[start].strip() or lines[start].strip().startswith(("#", "@")):
        return None
    for end in range(start + 1, min(start + _MAX_STATEMENT_LINES, len(lines)) + 1):
        text = tuple(line.strip() for line in lines[start:end])
        try:
            body = parse_source("\n".join(text)).body
        except CodeError as error:
            if "was never closed" in str(error):
                continue
            return None
        return Block("", text, tuple(range(start + 1, end + 1)), region, body[0]) if len(body) == 1 else None
    return None


def _depth(line: str) -> int:
    return len(line) - len(line.lstrip())


def _decorators(lines: list[str], index: int) -> list[tuple[int, str]]:
    found: list[tuple[int, str]] = []
    while index > 0 and (lines[index - 1].strip().startswith("@") or (found and not lines[index - 1].strip())):
        index -= 1
        if lines[index].strip():
            found.insert(0, (index + 1, lines[index].strip()))
    return found
