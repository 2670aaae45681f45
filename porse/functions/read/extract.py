"""Finds the function in a model's reply: prose, fences of any flavour, indented methods, several drafts.

No block structure is assumed. Every line that starts with `def` opens a function, which ends where the indentation says so
or at a fence; the last one with a right name that parses and returns something wins, and what it needs (helpers,
constants, unusual imports) comes along. Line numbers of the reply are kept. Nothing is executed; what only an attack would
write beside the functions is refused, so that it is seen.
"""

import ast
import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass

from porse.functions.contract import FUNCTION_NAMES, HELPERS, MAX_REPLY_CHARACTERS, MAX_SOURCE_LINES, NAME_PATTERN
from porse.functions.read.scan import Block, blocks, plain_lines, unwrapped
from porse.functions.read.source import DEFAULT_MODULES, Import, arguments, constant_of, import_names, is_constant
from porse.functions.verdict import CodeError, Kind, words

_DECORATORS = re.compile(
    r"@\s*((torch\.)?jit\.(script|script_if_tracing|export)|script|staticmethod|classmethod|"
    r"torch\.(no_grad|inference_mode)(\(\s*\))?)\s*(#.*)?"
)
_HOSTILE = words("""
    __import__ breakpoint builtins classes compile connect cpp_extension ctypes delattr eval exec from_file getattr
    globals hub importlib input load load_library locals open ops os pickle popen remove rmtree save setattr shutil
    socket subprocess sys system unlink urllib urlopen vars
    """)


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


def extract(reply: str, kind: Kind) -> Extracted:
    """Returns the code of the last complete function of `kind` in `reply`.

    Raises:
        CodeError: there is none; check "extract" or "syntax", with the line of the reply.
    """
    if len(reply) > MAX_REPLY_CHARACTERS:
        raise CodeError("extract", f"expected a reply of at most {MAX_REPLY_CHARACTERS} characters, found {len(reply)}")
    line, code = unwrapped(reply)
    everything = list(blocks(plain_lines(code or reply)))
    found = [block for block in everything if block.name]
    main = _choose(found, kind)
    beside = [block for block in everything if not block.name]
    beside += [setting for block in found if block.name == "__init__" for setting in _settings(block)]
    parts = _assembled(main, found, sorted(beside, key=lambda block: block.lines[0]))
    if len(parts) > MAX_SOURCE_LINES:
        message = f"expected at most {MAX_SOURCE_LINES} lines of code, found {len(parts)}"
        raise CodeError("extract", message, parts[0][0])
    source = "".join(f"{text}\n" for _, text in parts)
    return Extracted(source, tuple(line if code else number for number, _ in parts), main.name)


def _choose(found: list[Block], kind: Kind) -> Block:
    """Returns the last complete function with a right name, else with the nearest thing to one."""
    other: Kind = "mapping" if kind == "reward" else "reward"
    called = {name for f in found if f.tree for name in _names_read(f.tree)} | {*FUNCTION_NAMES[other], *HELPERS}
    named = [f for f in found if f.name in FUNCTION_NAMES[kind]]
    alike = [f for f in found if re.fullmatch(NAME_PATTERN[kind], f.name)]
    lone = [f for f in found if f.name not in called and not re.fullmatch(NAME_PATTERN[other], f.name)]
    groups = [named, alike, lone if len(lone) == 1 else []]
    for group in groups:
        if complete := [f for f in group if f.complete]:
            return complete[-1]
    broken = next((group[-1] for group in groups if group), None)
    if broken is None:
        wanted = FUNCTION_NAMES[kind][0]
        names = ", ".join(dict.fromkeys(f.name for f in found)) or "no function at all"
        message = (
            f"expected a function named {wanted} in the reply, found {names}; write def {wanted}(...) in one code block"
        )
        raise CodeError("extract", message)
    if broken.error is not None:
        raise CodeError("syntax", f"the function {broken.name} is not valid Python: {broken.error}", broken.error.line)
    raise CodeError("return", f"the function {broken.name} returns nothing", broken.lines[0])


def _names_read(tree: ast.AST | None) -> Iterator[str]:
    """Yields every name and attribute that a tree reads."""
    for node in ast.walk(tree) if tree is not None else ():
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def _settings(init: Block) -> Iterator[Block]:
    """Yields what an `__init__` sets as constants of its class, `X = 2.0` for `self.X = 2.0`, and its other statements.

    Its arguments are constants too, by their defaults, since functions make such a thing without arguments; what has none
    is `None`.
    """
    if not isinstance(init.tree, ast.FunctionDef):
        return
    given = [(name, value or ast.Constant(None)) for name, value in arguments(init.tree).items() if name != "self"]
    found: list[ast.stmt] = [_assignment(name, value, init.tree) for name, value in given]
    for statement in init.tree.body:
        match statement:
            case (
                ast.Assign(targets=[ast.Attribute(value=ast.Name(id="self"), attr=name), *_], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Attribute(value=ast.Name(id="self"), attr=name), value=ast.expr() as value)
            ):
                if not (isinstance(value, ast.Name) and value.id == name):
                    found.append(_assignment(name, value, statement))
            case ast.Expr(ast.Call(ast.Attribute(ast.Call(ast.Name("super")), "__init__"), [], [])):
                pass
            case _:
                found.append(statement)
    for statement in found:
        with contextlib.suppress(ValueError):  # not every f-string can be written anew
            text = tuple(ast.unparse(statement).split("\n"))
            yield Block("", text, (init.lines[statement.lineno - 1],) * len(text), init.region, statement)


def _assignment(name: str, value: ast.expr, where: ast.stmt) -> ast.Assign:
    return ast.copy_location(ast.Assign([ast.Name(name, ast.Store())], value), where)


def _assembled(main: Block, found: list[Block], beside: list[Block]) -> list[tuple[int, str]]:
    """Returns the lines of the main function and of what it reads, directly or not: helpers, constants, unusual imports."""
    imports: list[tuple[Block, set[str]]] = []
    constants: dict[str, list[Block]] = {}
    for block in beside:
        name, value = constant_of(block.tree)
        if block.region == main.region:
            _refuse_hostile(block)
        if isinstance(block.tree, Import):
            imports.append((block, _unusual(block.tree)))
        elif value is not None and is_constant(value, constants):
            before = constants.get(name, []) if name in _names_read(value) else []
            constants[name] = [*before, block]
    by_name = {f.name: f for f in found if f.tree is not None and f.name != main.name}
    needed, names, queue = [main], set[str](), [main]
    while queue:
        read = set(_names_read(queue.pop().tree)) - names
        names |= read
        helpers = [by_name[name] for name in read & by_name.keys()]
        queue += helpers
        needed += helpers
    for name in reversed(constants):
        if name in names:  # each reads only those before it
            names.update(read for block in constants[name] for read in _names_read(block.tree))
    first = [block for block, bound in imports if bound & names]
    first += [block for name, given in constants.items() if name in names for block in given]
    parts = [part for block in first for part in zip(block.lines, block.text, strict=True)]
    for function in [*sorted(needed[1:], key=lambda f: f.lines[0]), main]:
        for number, text in function.decorators:
            if not _DECORATORS.fullmatch(text):
                raise CodeError("static", f"the decorator {text} is not allowed; the function needs none", number)
        parts += [(function.lines[0], "")] if parts else []
        parts += zip(function.lines, function.text, strict=True)
    return parts


def _refuse_hostile(block: Block) -> None:
    """Refuses a statement beside the function that only an attack would write, at its line of the reply."""
    try:
        if isinstance(block.tree, Import):
            import_names(block.tree)
    except CodeError as error:
        raise CodeError(error.check, str(error), block.lines[0]) from None
    hostile = sorted(n for n in _names_read(block.tree) if n in _HOSTILE or n.startswith("__"))
    if hostile:
        raise CodeError("static", f"the name {hostile[0]} is not allowed anywhere in the code", block.lines[0])


def _unusual(node: Import) -> set[str]:
    """Returns the names that an import binds to something of torch, math or numpy, but for the usual ones."""
    try:
        bound = import_names(node)
    except CodeError:  # of another draft
        return set()
    return {name for name, path in bound.items() if DEFAULT_MODULES.get(name) != path and path != "torch.Tensor"}
