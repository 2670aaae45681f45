"""Finds the function in a model's reply: prose, fences of any flavour, indented methods, several drafts.

No block structure is assumed. Every line that starts with `def` opens a chunk, which ends where the indentation says so
or at a fence; the last chunk with a right name that parses and returns something wins, and what it needs (helpers,
constants, unusual imports) comes along. Line numbers of the reply are kept. Nothing is executed.
"""

import ast
import html
import json
import re
from dataclasses import dataclass

from porse.functions.contract import (
    FUNCTION_NAMES,
    HELPERS,
    MAX_REPLY_CHARACTERS,
    MAX_SOURCE_LINES,
    MAX_TREE_NODES,
    NAME_PATTERN,
)
from porse.functions.read.scan import Chunk, chunks, parse_source, text_of
from porse.functions.read.source import all_arguments, defaults
from porse.functions.read.surroundings import Surroundings, names_read, refuse_decorators, refuse_hostile, surroundings
from porse.functions.verdict import CodeError, Kind

_SUPER = re.compile(r"super\((\w+, self)?\)\.__init__\(\)")


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

    def line_of(self, line: int) -> int:
        """Returns the line of the reply for one of the source, 0 for none."""
        return self.lines[line - 1] if 0 < line <= len(self.lines) else 0


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
    if len(reply) > MAX_REPLY_CHARACTERS:
        raise CodeError("extract", f"expected a reply of at most {MAX_REPLY_CHARACTERS} characters, found {len(reply)}")
    line, code = _wrapped(reply)
    if code:
        found = _extracted(code, kind)
        return Extracted(found.source, tuple(line for _ in found.lines), found.name)
    return _extracted(reply, kind)


def _extracted(reply: str, kind: Kind) -> Extracted:
    lines = _clean_lines(reply)
    functions = [_parse_chunk(chunk) for chunk in chunks(lines)]
    main = _choose(functions, kind)
    settings = {number: text for f in functions if f.chunk.name == "__init__" for number, text in _settings(f).items()}
    beside = [settings.get(number, line) for number, line in enumerate(lines, start=1)]
    around = surroundings(beside, {number for f in functions for number in f.chunk.lines} - settings.keys())
    refuse_hostile(main.chunk.region, around)
    return _assemble(main, functions, around)


def _clean_lines(reply: str) -> list[str]:
    """Returns the lines of the reply with line ends, blanks, quotes of mail and escapes of HTML made plain."""
    text = _without_thinking(re.sub(r"\r\n?", "\n", reply))
    text = re.sub(r"[\u200b\u200d\u2060\ufeff\u00ad]", "", text).replace("\u00a0", " ")
    if re.search(r"<(pre|code)\b", text):
        text = re.sub(r"</?(pre|code|span)\b[^<>\n]*>", "", text)
    if re.search(r"&(gt|lt|quot|amp|#39);", text):
        text = html.unescape(text)
    lines = [line.rstrip() for line in text.split("\n")]
    if any(re.match(r">\s+(def|@)", line) for line in lines):
        lines = [re.sub(r"^>\s?", "", line) for line in lines]
    return lines


def _without_thinking(text: str) -> str:
    """Returns a text with blanks for what a model thought before it answered: drafts are no answer, closed or not."""
    end = max((match.end() for match in re.finditer(r"</(think|thinking|reasoning)>", text)), default=0)
    before, rest = text[:end], text[end:]
    start = re.search(r"^\s*<(think|thinking|reasoning)>", rest, re.MULTILINE)
    cut = start.start() if start else len(rest)
    return re.sub(r"[^\n]", "", before) + rest[:cut] + re.sub(r"[^\n]", "", rest[cut:])


def _wrapped(reply: str) -> tuple[int, str]:
    """Returns the code that stands as a text in a reply's JSON, and the line of the reply that it begins on; "" for none."""
    start, end = reply.find("{"), reply.rfind("}")
    if start < 0 or re.search(r"^\s*(async\s+)?def\s", reply, re.MULTILINE):
        return 0, ""
    try:
        held = json.loads(reply[start : end + 1])
    except (ValueError, RecursionError):
        return 0, ""
    texts = (
        [text for text in held.values() if isinstance(text, str) and "def " in text] if isinstance(held, dict) else []
    )
    return reply.count("\n", 0, start) + 1, max(texts, key=len, default="")


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


def _settings(init: _Function) -> dict[int, str]:
    """Returns the lines of an `__init__`, by number, with `X = 2.0` for `self.X = 2.0`: constants of the class.

    An argument stands for its default, since functions make such a thing without arguments; what has none is `None`.
    """
    found = dict(zip(init.chunk.lines, init.chunk.text, strict=True))
    if init.tree is None:
        return found
    given = _short_defaults(init.tree)
    missing = {argument.arg for argument in all_arguments(init.tree)} - given.keys()
    for statement in init.tree.body:
        name, value = _own(statement)
        if value is not None:
            is_known = missing.isdisjoint(names_read(value))
            text = f"{name} = {text_of(_WithDefaults(given).visit(value)) if is_known else None}"
        elif _SUPER.fullmatch(text_of(statement)):
            text = ""
        else:
            continue
        numbers = init.chunk.lines[statement.lineno - 1 : statement.end_lineno]
        found |= {number: text if number == numbers[0] else "" for number in numbers}
    return found


def _own(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    """Returns `X` and the value of `self.X = value`, an empty name for anything else."""
    if not isinstance(statement, ast.Assign | ast.AnnAssign):
        return "", None
    target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
    is_own = isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self"
    return (target.attr, statement.value) if is_own and isinstance(target, ast.Attribute) else ("", None)


def _short_defaults(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the defaults of arguments by name; none of them where all that read them would grow out of bounds."""
    given = defaults(function)
    sizes = {name: sum(1 for _ in ast.walk(value)) for name, value in given.items()}
    reads = (node.id for node in ast.walk(function) if isinstance(node, ast.Name))
    return given if sum(sizes.get(name, 0) for name in reads) <= MAX_TREE_NODES else {}


class _WithDefaults(ast.NodeTransformer):
    """Writes the default of an argument for its name."""

    def __init__(self, given: dict[str, ast.expr]) -> None:
        self._given = given

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self._given.get(node.id, node)


def _choose(functions: list[_Function], kind: Kind) -> _Function:
    """Returns the last complete function with a right name, else with the nearest thing to one."""
    other: Kind = "mapping" if kind == "reward" else "reward"
    named = [f for f in functions if f.chunk.name in FUNCTION_NAMES[kind]]
    alike = [f for f in functions if re.fullmatch(NAME_PATTERN[kind], f.chunk.name)]
    foreign = {*FUNCTION_NAMES[other]}
    called = {name for f in functions if f.tree for name in names_read(f.tree)}
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


def _assemble(main: _Function, functions: list[_Function], around: Surroundings) -> Extracted:
    """Returns the main function with the helpers, constants and unusual imports that it reads, directly or not."""
    by_name = {f.chunk.name: f for f in functions if f.tree is not None}
    needed: dict[str, _Function] = {}
    names: set[str] = set()
    queue = [main]
    while queue:
        tree = queue.pop().tree
        assert tree is not None  # chosen and looked-up functions have parsed
        for name in names_read(tree):
            names.add(name)
            helper = by_name.get(name)
            if helper is not None and name != main.chunk.name and name not in needed:
                needed[name] = helper
                queue.append(helper)
    for name in reversed(around.constants):
        if name in names:  # each reads only those before it
            names |= around.read[name]
    parts = [(number, text) for number, text, _ in around.imports_of(names)]
    parts += [line for name, block in around.constants.items() if name in names for line in block]
    for function in [*sorted(needed.values(), key=lambda f: f.chunk.lines[0]), main]:
        refuse_decorators(function.chunk)
        if parts:
            parts.append((function.chunk.lines[0], ""))
        parts.extend(zip(function.chunk.lines, function.chunk.text, strict=True))
    if len(parts) > MAX_SOURCE_LINES:
        message = f"expected at most {MAX_SOURCE_LINES} lines of code, found {len(parts)}"
        raise CodeError("extract", message, parts[0][0])
    source = "".join(f"{text}\n" for _, text in parts)
    return Extracted(source, tuple(number for number, _ in parts), main.chunk.name)
