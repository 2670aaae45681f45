"""A reply to plain lines, and lines to blocks by indentation and brackets: functions, and statements beside them."""

import ast
import contextlib
import html
import json
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from porse.functions.contract import MAX_TREE_DEPTH, MAX_TREE_NODES
from porse.functions.verdict import CodeError

_FENCE = re.compile(r"\s*(`{3,}|~{3,})")
_DEF = re.compile(r"(\s*)(async\s+)?def\s+(\w+)\s*\(")
_OPEN = {True: re.compile("was never closed|unterminated triple-quoted"), False: re.compile("was never closed")}
"""What Python says of a function that goes on, and of a statement, beside which quotes may be those of prose."""
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
        tree: what it is, with the reply's lines; None where it is no Python.
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
    with contextlib.suppress(ValueError, RecursionError):
        if start >= 0 and not re.search(r"^\s*(async\s+)?def\s", reply, re.MULTILINE):
            held = json.loads(reply[start : end + 1]).values()
            texts = [text for text in held if isinstance(text, str) and "def " in text]
            return reply.count("\n", 0, start) + 1, max(texts, key=len, default="")
    return 0, ""


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
    decorators: tuple[tuple[int, str], ...] = ()
    while index < len(lines):
        line = lines[index].strip()
        region += bool(_FENCE.match(line))
        block = _block(lines, index, region, decorators) if line and line[0] not in "#@" else None
        decorators = (*decorators, (index + 1, line)) if line.startswith("@") else ()
        if block is not None:
            yield block
        index += len(block.lines) if block is not None else 1


def _block(lines: list[str], start: int, region: int, decorators: tuple[tuple[int, str], ...]) -> Block | None:
    """Returns the function, or the statement, that begins on a line, None for prose.

    A function goes on where it is indented deeper, a statement ends with its line; but not while something is open.
    """
    match = _DEF.match(lines[start])
    indent = len(match[1]) if match else 0
    end, tree, error = start, None, None
    for _ in range(_MAX_STATEMENT_LINES):
        end = _end(lines, end + 1, indent) if match else end + 1
        text = tuple(line[min(indent, _depth(line)) :] if match else line.strip() for line in lines[start:end])
        numbers = tuple(range(start + 1, end + 1))
        try:
            body = _statements(text, numbers)
            tree = body[0] if len(body) == 1 and (isinstance(body[0], ast.FunctionDef) or not match) else None
            error = None if tree else CodeError("syntax", "expected one plain function", numbers[0])
        except CodeError as found:
            error = found
        if error is None or not _OPEN[bool(match)].search(str(error)) or end == len(lines) or _FENCE.match(lines[end]):
            break
    return Block(match[3] if match else "", text, numbers, region, tree, error, decorators) if match or tree else None


def _end(lines: list[str], after: int, indent: int) -> int:
    """Returns the index after the last line, from one on, that is indented deeper, which a fence ends too."""
    end = after
    for index, line in enumerate(lines[after:], start=after):
        if line.strip() and _depth(line) > indent and not _FENCE.match(line):
            end = index + 1
        elif line.strip() and not line.lstrip().startswith("#"):
            break
    return end


def _depth(line: str) -> int:
    return len(line) - len(line.lstrip())


def _statements(text: Sequence[str], lines: Sequence[int]) -> list[ast.stmt]:
    """Returns the statements of a text, at most so many and so deep; their nodes have the reply's lines, which are given."""
    joined = "\n".join(text)
    hidden = next((c for c in joined if c != "\n" and not c.isprintable()), "")
    if hidden:
        line = lines[joined[: joined.index(hidden)].count("\n")]
        raise CodeError("syntax", f"the code holds the invisible character U+{ord(hidden):04X}; write plain text", line)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(joined)
    except SyntaxError as error:
        line = lines[min(max(error.lineno or 1, 1), len(lines)) - 1]
        raise CodeError("syntax", f"{error.msg}: {(error.text or '').strip()[:200]}", line) from None
    except (ValueError, RecursionError, MemoryError):
        raise CodeError("syntax", "it is too deeply nested, or holds a null character", lines[0]) from None
    count = 0
    rest: list[tuple[ast.AST, int]] = [(tree, 0)]
    while rest:  # without recursion, which could go too deep itself
        node, depth = rest.pop()
        count += 1
        if isinstance(node, ast.stmt | ast.expr | ast.arg | ast.keyword | ast.alias):
            node.lineno, node.end_lineno = lines[node.lineno - 1], lines[(node.end_lineno or node.lineno) - 1]
        if count > MAX_TREE_NODES or depth > MAX_TREE_DEPTH:
            line = getattr(node, "lineno", lines[0])
            raise CodeError("syntax", "the code is too large or too deeply nested", line)
        rest += [(child, depth + 1) for child in ast.iter_child_nodes(node)]
    return tree.body
