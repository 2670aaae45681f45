"""Lines of a reply to chunks of code, one for each function, by indentation and brackets; and safe parsing."""

import ast
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

from porse.functions.contract import MAX_TREE_DEPTH, MAX_TREE_NODES
from porse.functions.verdict import CodeError

_FENCE = re.compile(r"\s*(`{3,}|~{3,})")
_DEF = re.compile(r"(\s*)(async\s+)?def\s+(\w+)\s*\(")
_TOKEN = re.compile(r"\"\"\"|'''|\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'|#.*|[()\[\]{}]")

_MAX_STATEMENT_LINES = 60


@dataclass(frozen=True)
class Chunk:
    """The lines of one function.

    Attributes:
        name: the function's name.
        text: its lines, dedented, from `def` on.
        lines: the number of each line in the reply, counted from 1.
        decorators: number and text of the decorator lines above it.
        region: which fenced or unfenced stretch of the reply it stands in.
    """

    name: str
    text: tuple[str, ...]
    lines: tuple[int, ...]
    decorators: tuple[tuple[int, str], ...]
    region: int


def regions(lines: list[str]) -> list[int]:
    """Returns for each line the number of fences before it."""
    numbers, region = [], 0
    for line in lines:
        region += bool(_FENCE.match(line))
        numbers.append(region)
    return numbers


def chunks(lines: list[str]) -> Iterator[Chunk]:
    """Yields each function that is not inside another one, in order."""
    where = regions(lines)
    index = 0
    while index < len(lines):
        match = _DEF.match(lines[index].expandtabs(4))
        if match is None:
            index += 1
            continue
        end = _end(lines, index, len(match[1]))
        block = [line.expandtabs(4) for line in lines[index:end]]
        indent = len(match[1])
        text = tuple(line[min(indent, len(line) - len(line.lstrip())) :] for line in block)
        numbers = tuple(range(index + 1, end + 1))
        yield Chunk(match[3], text, numbers, tuple(_decorators(lines, index)), where[index])
        index = end


def _end(lines: list[str], start: int, indent: int) -> int:
    """Returns the index after the last line of the function that starts at `start`."""
    depth, quote, end = 0, "", start + 1
    for index in range(start, len(lines)):
        line = lines[index].expandtabs(4)
        if _FENCE.match(line) and index > start:
            break
        open_line = depth > 0 or quote
        blank = not line.strip() or line.lstrip().startswith("#")
        if index > start and not open_line and not blank and len(line) - len(line.lstrip()) <= indent:
            break
        depth, quote = _advance(line, depth, quote)
        if not blank or open_line or len(line) - len(line.lstrip()) > indent:
            end = index + 1 if line.strip() else end
    return end


def bracketed(lines: list[str], start: int) -> list[str]:
    """Returns the line at index `start`, stripped, and those after it until its brackets are closed; few at most."""
    depth, quote, block = 0, "", []
    for line in lines[start : start + _MAX_STATEMENT_LINES]:
        block.append(line.strip())
        depth, quote = _advance(line, depth, quote)
        if not depth or quote:
            break
    return block


def _advance(line: str, depth: int, quote: str) -> tuple[int, str]:
    """Returns bracket depth and open triple quote after `line`."""
    position = 0
    while position < len(line):
        if quote:
            close = line.find(quote, position)
            if close < 0:
                return depth, quote
            position, quote = close + 3, ""
            continue
        match = _TOKEN.search(line, position)
        if match is None:
            break
        position, token = match.end(), match[0]
        if token in ('"""', "'''"):
            quote = token
        elif token in "([{":
            depth += 1
        elif token in ")]}":
            depth = max(depth - 1, 0)
    return depth, quote


def _decorators(lines: list[str], index: int) -> list[tuple[int, str]]:
    found: list[tuple[int, str]] = []
    while index > 0 and (lines[index - 1].strip().startswith("@") or (found and not lines[index - 1].strip())):
        index -= 1
        if lines[index].strip():
            found.insert(0, (index + 1, lines[index]))
    return found


def parse_source(source: str) -> ast.Module:
    """Returns the syntax tree of `source`, at most so large and so deep.

    Raises:
        CodeError: it is no Python, or too large; check "syntax" with the line of `source`.
    """
    hidden = next((c for c in source if c != "\n" and not c.isprintable()), "")
    if hidden:
        line = source[: source.index(hidden)].count("\n") + 1
        raise CodeError("syntax", f"the code holds the invisible character U+{ord(hidden):04X}; write plain text", line)
    return _parse(source)


def text_of(tree: ast.AST) -> str:
    """Returns a tree as Python text, "" where it has none: not every f-string can be written anew."""
    try:
        return ast.unparse(tree)
    except ValueError:
        return ""


def _parse(text: str) -> ast.Module:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except SyntaxError as error:
        message = f"{error.msg}: {(error.text or '').strip()[:200]}"
        raise CodeError("syntax", message, error.lineno or 1) from None
    except (ValueError, RecursionError, MemoryError):
        raise CodeError("syntax", "it is too deeply nested, or holds a null character", 1) from None
    _bound(tree)
    return tree


def _bound(tree: ast.AST) -> None:
    """Refuses a tree that is too large or too deep, without recursion."""
    count = 0
    level: list[tuple[ast.AST, int]] = [(tree, 0)]
    while level:
        node, depth = level.pop()
        count += 1
        if count > MAX_TREE_NODES or depth > MAX_TREE_DEPTH:
            raise CodeError("syntax", "the code is too large or too deeply nested", getattr(node, "lineno", 1))
        level.extend((child, depth + 1) for child in ast.iter_child_nodes(node))
