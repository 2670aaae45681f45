"""Finds the function in a model's reply: prose, fences of any flavour, indented methods, several drafts.

No block structure is assumed. Every line that starts with `def` opens a chunk, which ends where the indentation says so
or at a fence; the last chunk with a right name that parses and returns something wins, and what it needs (helpers,
constants, unusual imports) comes along. Line numbers of the reply are kept. Nothing is executed.
"""

import ast
import html
import re
import textwrap
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

from porse.code.contract import (
    FUNCTION_NAMES,
    HELPERS,
    MAX_REPLY_CHARACTERS,
    MAX_SOURCE_LINES,
    MODULES,
    NAME_PATTERN,
    Kind,
    words,
)
from porse.code.scan import Chunk, chunks, parse_source
from porse.code.verdict import CodeError

_DECORATORS = re.compile(
    r"@\s*(torch\.jit\.(script|script_if_tracing|export|_script_if_tracing)|torch\.(no_grad|inference_mode)(\(\s*\))?|"
    r"jit\.script|script|staticmethod|classmethod)\s*(#.*)?"
)
_USUAL_IMPORTS = {
    ("torch", "torch"),
    ("math", "math"),
    ("torch.nn.functional", "F"),
    ("torch.nn", "nn"),
    ("numpy", "np"),
}
_FORBIDDEN = words("exec eval open compile __import__ globals locals vars getattr setattr delattr input breakpoint")


@dataclass(frozen=True)
class Extracted:
    """The needed code of a reply.

    Attributes:
        source: unusual imports, constants, helpers and at last the function itself, dedented; the text of a candidate.
        lines: for each line of `source`, the line of the reply, counted from 1.
        name: the function's name.
    """

    source: str
    lines: tuple[int, ...]
    name: str


@dataclass(frozen=True)
class _Function:
    chunk: Chunk
    tree: ast.FunctionDef | None
    error: str
    error_line: int

    @property
    def complete(self) -> bool:
        """Whether it parses and returns a value somewhere."""
        return self.tree is not None and any(isinstance(n, ast.Return) and n.value for n in ast.walk(self.tree))


def extract(reply: str, kind: Kind) -> Extracted:
    """Returns the code of the last complete function of `kind` in `reply`.

    Raises:
        CodeError: there is none; check "extract" or "syntax", with the line of the reply.
    """
    lines = _clean_lines(reply)
    functions = [_parse_chunk(chunk) for chunk in chunks(lines)]
    main = _choose(functions, kind)
    outside = _outside(lines, functions, main.chunk.region)
    _refuse_hostile(main, outside)
    return _assemble(main, functions, outside)


def _clean_lines(reply: str) -> list[str]:
    """Returns the lines of the reply with line ends, tabs, quotes of mail and escapes of HTML made plain."""
    if len(reply) > MAX_REPLY_CHARACTERS:
        raise CodeError("extract", f"expected a reply of at most {MAX_REPLY_CHARACTERS} characters, found {len(reply)}")
    text = reply.replace("\r\n", "\n").replace("\r", "\n").replace("\ufeff", "").replace("\u00a0", " ")
    if re.search(r"-&gt;|&lt;|&gt;|&quot;|&#39;", text):
        text = html.unescape(text)
    lines = [line.rstrip() for line in text.split("\n")]
    if any(re.match(r">\s+(def|@)", line) for line in lines):
        lines = [re.sub(r"^>\s?", "", line) for line in lines]
    for number, line in enumerate(lines, start=1):
        bad = next((c for c in line if c != "\t" and not c.isprintable()), None)
        if bad is not None and re.match(r"\s", line[:1] or " "):
            raise CodeError(
                "extract", f"line {number} holds the invisible character U+{ord(bad):04X}; write plain text", number
            )
    return lines


def _parse_chunk(chunk: Chunk) -> _Function:
    """Returns the chunk with its tree, or with the syntax error at its line of the reply."""
    try:
        tree = parse_source("\n".join(chunk.text))
    except CodeError as error:
        line = chunk.lines[min(max(error.line, 1), len(chunk.lines)) - 1]
        return _Function(chunk, None, str(error), line)
    body = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    if len(body) != 1 or len(tree.body) != 1:
        return _Function(chunk, None, "expected one plain function", chunk.lines[0])
    return _Function(chunk, body[0], "", 0)


def _choose(functions: list[_Function], kind: Kind) -> _Function:
    """Returns the last complete function with a right name, else with the nearest thing to one."""
    other: Kind = "mapping" if kind == "reward" else "reward"
    named = [f for f in functions if f.chunk.name in FUNCTION_NAMES[kind]]
    alike = [f for f in functions if re.fullmatch(NAME_PATTERN[kind], f.chunk.name)]
    foreign = {*FUNCTION_NAMES[other]}
    called = {name for f in functions if f.tree for name in _names(f.tree)}
    lone = [
        f
        for f in functions
        if f.chunk.name not in called
        and f.chunk.name not in foreign
        and f.chunk.name not in HELPERS
        and not re.fullmatch(NAME_PATTERN[other], f.chunk.name)
    ]
    groups = [named, alike, lone if len(lone) == 1 else []]
    for group in groups:
        complete = [f for f in group if f.complete]
        if complete:
            return complete[-1]
    broken = next((group[-1] for group in groups if group), None)
    wanted = FUNCTION_NAMES[kind][0]
    if broken is None:
        found = ", ".join(dict.fromkeys(f.chunk.name for f in functions)) or "no function at all"
        raise CodeError(
            "extract",
            f"expected a function named {wanted} in the reply, found {found}; write def {wanted}(...) in one code block",
        )
    if broken.tree is None:
        raise CodeError(
            "syntax", f"the function {broken.chunk.name} is not valid Python: {broken.error}", broken.error_line
        )
    raise CodeError("return", f"the function {broken.chunk.name} returns nothing", broken.chunk.lines[0])


def _names(tree: ast.AST) -> Iterator[str]:
    """Yields every name and attribute that a tree reads."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


@dataclass(frozen=True)
class _Outside:
    """What stands beside the functions: single-line imports and constants, and the statements of the winning block."""

    imports: list[tuple[int, str, ast.Import | ast.ImportFrom]]
    constants: dict[str, tuple[int, str]]
    hostile: list[tuple[int, str]]


def _outside(lines: list[str], functions: list[_Function], region: int) -> _Outside:
    inside = {number for f in functions for number in f.chunk.lines}
    from porse.code.scan import regions

    found = _Outside([], {}, [])
    for number, (line, where) in enumerate(zip(lines, regions(lines), strict=True), start=1):
        text = line.strip()
        if number in inside or not text or text.startswith(("#", "@")):
            continue
        node = _single_statement(text)
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.imports.append((number, text, node))
        elif isinstance(node, ast.Assign | ast.AnnAssign) and _constant_name(node):
            found.constants[_constant_name(node)] = (number, text)
        if node is not None and where == region:
            names = set(_names(node))
            bad = sorted(n for n in names if n in _FORBIDDEN or n.startswith("__"))
            if bad:
                found.hostile.append((number, bad[0]))
    return found


def _single_statement(text: str) -> ast.stmt | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            body = ast.parse(text[:500]).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    return body[0] if len(body) == 1 else None


def _constant_name(node: ast.Assign | ast.AnnAssign) -> str:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    if len(targets) != 1 or not isinstance(targets[0], ast.Name) or node.value is None:
        return ""
    allowed = (ast.Constant, ast.UnaryOp, ast.USub, ast.List, ast.Tuple, ast.Load, ast.BinOp, ast.operator)
    return targets[0].id if all(isinstance(n, allowed) for n in ast.walk(node.value)) else ""


def _modules(node: ast.Import | ast.ImportFrom) -> list[str]:
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or "."]


def _refuse_hostile(main: _Function, outside: _Outside) -> None:
    """Refuses decorators, imports and statements beside the function that a reward has no use for."""
    for number, text in main.chunk.decorators:
        if not _DECORATORS.fullmatch(text.strip()):
            raise CodeError("static", f"the decorator {text.strip()} is not allowed; the function needs none", number)
    for number, text, node in outside.imports:
        if any(name.split(".")[0] not in MODULES for name in _modules(node)):
            raise CodeError(
                "static", f"the import line {text!r} is not allowed; only torch, math and typing are offered", number
            )
    for number, name in outside.hostile:
        raise CodeError("static", f"the name {name} is not allowed anywhere in the code", number)


def _assemble(main: _Function, functions: list[_Function], outside: _Outside) -> Extracted:
    """Returns the main function with the helpers, constants and unusual imports that it reads, directly or not."""
    by_name = {f.chunk.name: f for f in functions if f.tree is not None}
    needed: dict[str, _Function] = {}
    names: set[str] = set()
    queue = [main]
    while queue:
        tree = queue.pop().tree
        assert tree is not None  # chosen and looked-up functions have parsed
        for name in _names(tree):
            names.add(name)
            helper = by_name.get(name)
            if helper is not None and name != main.chunk.name and name not in needed:
                needed[name] = helper
                queue.append(helper)
    parts: list[tuple[int, str]] = []
    for number, text, node in outside.imports:
        unusual = isinstance(node, ast.Import) and any(
            a.asname and (a.name, a.asname) not in _USUAL_IMPORTS and a.asname in names for a in node.names
        )
        chosen = isinstance(node, ast.ImportFrom) and any(
            (a.asname or a.name) in names
            and (f"{node.module}.{a.name}", a.asname or a.name) not in _USUAL_IMPORTS
            and (node.module or "").split(".")[0] in ("torch", "math", "numpy")
            and a.name != "Tensor"
            for a in node.names
        )
        if unusual or chosen:
            parts.append((number, text))
    for name, (number, text) in outside.constants.items():
        if name in names:
            parts.append((number, text))
    chosen_functions = sorted(needed.values(), key=lambda f: f.chunk.lines[0])
    for function in [*chosen_functions, main]:
        if parts:
            parts.append((function.chunk.lines[0], ""))
        parts.extend(zip(function.chunk.lines, function.chunk.text, strict=True))
    if len(parts) > MAX_SOURCE_LINES:
        raise CodeError(
            "extract", f"expected at most {MAX_SOURCE_LINES} lines of code, found {len(parts)}", parts[0][0]
        )
    source = "\n".join(text for _, text in parts) + "\n"
    return Extracted(textwrap.dedent(source), tuple(number for number, _ in parts), main.chunk.name)
