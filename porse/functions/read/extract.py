"""Finds the function in a model's reply: prose, fences of any flavour, indented methods, several drafts.

No block structure is assumed. Every line that starts with `def` opens a function, which ends where the indentation says so
or at a fence; the last one with a right name that parses and returns something wins, and what it needs (helpers,
constants, unusual imports) comes along. Line numbers of the reply are kept. Nothing is executed; what only an attack would
write beside the functions is refused, so that it is seen.
"""

import ast
import contextlib
import re
from collections.abc import Container, Iterator
from dataclasses import dataclass

from porse.functions import contract
from porse.functions.read.scan import Block, blocks, plain_lines, unwrapped
from porse.functions.verdict import CodeError, Kind, words

Import = ast.Import | ast.ImportFrom

_DEFAULT_MODULES = {
    "torch": "torch", "math": "math", "F": "torch.nn.functional", "nn": "torch.nn", "np": "numpy", "numpy": "numpy",
}  # fmt: skip
_DECORATORS = re.compile(
    r"@\s*((torch\.)?jit\.(script|script_if_tracing|export)|script|staticmethod|classmethod|"
    r"torch\.(no_grad|inference_mode)(\(\s*\))?)\s*(#.*)?"
)
_HOSTILE = words("""
    __import__ breakpoint builtins classes compile connect cpp_extension ctypes delattr eval exec from_file getattr
    globals hub importlib input load load_library locals open ops os pickle popen remove rmtree save setattr shutil
    socket subprocess sys system unlink urllib urlopen vars
    """)
_OF_CONSTANTS = (
    ast.Constant, ast.UnaryOp, ast.unaryop, ast.BinOp, ast.operator, ast.BoolOp, ast.boolop, ast.List, ast.Tuple, ast.Dict,
    ast.Subscript, ast.Call, ast.keyword, ast.Name, ast.Attribute, ast.Load,
)  # fmt: skip
"""What a constant may be made of."""
_OF_EVERY_TASK = words("actions device num_envs obs_buf progress_buf")
"""What the tasks have, whatever a class around the function sets when it is made."""
_OFFERED = words("math torch np numpy abs dict float int len list max min round sum tuple")


@dataclass(frozen=True)
class Source:
    """The needed code of a reply: unusual imports, constants, helpers and at last the function itself.

    Attributes:
        text: all that, dedented; the text of a candidate.
        tree: the same, parsed; its nodes have the lines of the reply.
        constants: the names of the module's and the classes' constants.
        modules: dotted path for each name that stands for a module or for something imported from one.
        classes: the names that are read as classes.
    """

    text: str
    tree: ast.Module
    constants: frozenset[str]
    modules: dict[str, str]
    classes: frozenset[str]

    @property
    def functions(self) -> list[ast.FunctionDef]:
        """The functions, in their order."""
        return [node for node in self.tree.body if isinstance(node, ast.FunctionDef)]

    @property
    def main(self) -> ast.FunctionDef:
        """The function itself."""
        return self.functions[-1]

    @property
    def last_line(self) -> int:
        """The line of the last return of the main function."""
        lines = (node.lineno for node in ast.walk(self.main) if isinstance(node, ast.Return))
        return max(lines, default=self.main.lineno)


def arguments(function: ast.FunctionDef) -> dict[str, ast.expr | None]:
    """Returns the arguments of a function by name, each with its default; `self` is one of them."""
    given = function.args
    names = [argument.arg for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]]
    required = len(given.posonlyargs) + len(given.args) - len(given.defaults)
    return dict(zip(names, [*[None] * required, *given.defaults, *given.kw_defaults], strict=True))


def takes_self(function: ast.FunctionDef) -> bool:
    """Whether `self` is a function's first argument."""
    return next(iter(arguments(function)), "") == "self"


def extract(reply: str, kind: Kind) -> Source:
    """Returns the code of the last complete function of `kind` in `reply`.

    Raises:
        CodeError: there is none, or it imports what is not offered; with the line of the reply.
    """
    if len(reply) > (most := contract.MAX_REPLY_CHARACTERS):
        raise CodeError("extract", f"expected a reply of at most {most} characters, found {len(reply)}")
    line, code = unwrapped(reply)
    everything = list(blocks(plain_lines(code or reply)))
    found = [block for block in everything if block.name]
    main = _choose(found, kind)
    beside = [block for block in everything if not block.name]
    beside += [setting for block in found if block.name == "__init__" for setting in _settings(block)]
    first, constants, functions = _needed(main, found, sorted(beside, key=lambda block: block.lines[0]))
    parts = [part for block in first for part in zip(block.lines, block.text, strict=True)]
    for function in functions:
        parts += [(function.lines[0], "")] if parts else []
        parts += zip(function.lines, function.text, strict=True)
    if len(parts) > contract.MAX_SOURCE_LINES:
        message = f"expected at most {contract.MAX_SOURCE_LINES} lines of code, found {len(parts)}"
        raise CodeError("extract", message, parts[0][0])
    text = "".join(f"{text}\n" for _, text in parts)
    tree = ast.Module([block.tree for block in (*first, *functions) if block.tree is not None], [])
    names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
    modules = _DEFAULT_MODULES.copy()
    for node in ast.walk(tree):
        if code and hasattr(node, "lineno"):
            vars(node).update(lineno=line, end_lineno=line)
        if isinstance(node, Import):
            modules |= _bound(node, node.lineno)
    return Source(text, tree, constants, modules, frozenset(node.id for node in names if _is_class(node)))


def _choose(found: list[Block], kind: Kind) -> Block:
    """Returns the last complete function with a right name, else with the nearest thing to one."""
    other: Kind = "mapping" if kind == "reward" else "reward"
    read = {name for f in found for name in _names_read(f.tree)}
    called = read | {*contract.FUNCTION_NAMES[other], *contract.HELPERS}
    named = [f for f in found if f.name in contract.FUNCTION_NAMES[kind]]
    alike = [f for f in found if re.fullmatch(contract.NAME_PATTERN[kind], f.name)]
    lone = [f for f in found if f.name not in called and not re.fullmatch(contract.NAME_PATTERN[other], f.name)]
    groups = [named, alike, lone if len(lone) == 1 else []]
    for group in groups:
        if complete := [f for f in group if f.complete]:
            return complete[-1]
    broken = next((group[-1] for group in groups if group), None)
    if broken is None:
        wanted = contract.FUNCTION_NAMES[kind][0]
        names = ", ".join(dict.fromkeys(f.name for f in found)) or "no function at all"
        message = f"expected a function named {wanted} in the reply, found {names}"
        raise CodeError("extract", f"{message}; write def {wanted}(...) in one code block")
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
            yield Block("", text, (statement.lineno,) * len(text), init.region, statement)


def _assignment(name: str, value: ast.expr, where: ast.stmt) -> ast.Assign:
    return ast.fix_missing_locations(ast.copy_location(ast.Assign([ast.Name(name, ast.Store())], value), where))


def _needed(main: Block, found: list[Block], beside: list[Block]) -> tuple[list[Block], frozenset[str], list[Block]]:
    """Returns what the main function reads, directly or not: imports and constants, the latter's names, and functions."""
    imports: list[tuple[Block, set[str]]] = []
    constants: dict[str, list[Block]] = {}
    for block in beside:
        is_own = block.region == main.region
        if is_own and (hostile := sorted(n for n in _names_read(block.tree) if n in _HOSTILE or n.startswith("__"))):
            raise CodeError("static", f"the name {hostile[0]} is not allowed anywhere in the code", block.lines[0])
        match block.tree:
            case ast.Import() | ast.ImportFrom() as node:
                with contextlib.nullcontext() if is_own else contextlib.suppress(CodeError):
                    bound = _bound(node, block.lines[0]).items() - {*_DEFAULT_MODULES.items()}
                    imports.append((block, {name for name, path in bound if path != "torch.Tensor"}))
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
            ) if name not in _OF_EVERY_TASK and _is_constant(value, constants):
                before = constants.get(name, []) if name in _names_read(value) else []
                constants[name] = [*before, block]
    by_name = {f.name: f for f in found if f.tree is not None and f.name != main.name}
    functions, names, queue = list[Block](), set[str](), [main]
    while queue:
        read = set(_names_read(queue.pop().tree)) - names
        names |= read
        queue += (helpers := [by_name[name] for name in read & by_name.keys()])
        functions += helpers
    for name in reversed(constants):
        if name in names:  # each reads only those before it
            names.update(read for block in constants[name] for read in _names_read(block.tree))
    functions = [*sorted(functions, key=lambda f: f.lines[0]), main]
    for number, text in (decorator for function in functions for decorator in function.decorators):
        if not _DECORATORS.fullmatch(text):
            raise CodeError("static", f"the decorator {text} is not allowed; the function needs none", number)
    first = [block for block, bound in imports if bound & names]
    first += [block for name, given in constants.items() if name in names for block in given]
    return first, frozenset(constants.keys() & names), functions


def _bound(node: Import, line: int) -> dict[str, str]:
    """Returns what an import line would bind of torch, math and numpy: local name to dotted path. Nothing is imported."""
    names = {}
    module = "." * node.level + (node.module or "") if isinstance(node, ast.ImportFrom) else ""
    for alias in node.names:
        path = f"{module}.{alias.name}" if module else alias.name
        root = path.split(".")[0]
        if root not in contract.MODULES:
            message = f"the import of {module or path} is not allowed; only torch, math and typing are offered"
            raise CodeError("static", message, line)
        if root in ("torch", "math", "numpy") and alias.name != "*":
            is_whole = module or alias.asname
            names[alias.asname or (alias.name if module else root)] = path if is_whole else root
    return names


def _is_constant(value: ast.expr, known: Container[str]) -> bool:
    """Whether a value beside the functions may be offered to them: written out, or computed from constants that are known.

    That is its form alone: where it is used it is held against the same lists as the function.
    """
    for node in ast.walk(value) if not _is_class(value) else ():
        match node:
            case ast.Name(id=name) if name not in _OFFERED and name not in known:
                return False
            case ast.Attribute(value=owner) if not isinstance(owner, ast.Name):
                return False
            case ast.Call(func=called) if not isinstance(called, ast.Name | ast.Attribute):
                return False
        if not isinstance(node, _OF_CONSTANTS):
            return False
    return True


def _is_class(value: ast.expr) -> bool:
    """Whether a value is a class, by its capital letter, or made of one without arguments."""
    made = value.func if isinstance(value, ast.Call) and not value.args and not value.keywords else value
    if not isinstance(made, ast.Name) or made.id in contract.ERRORS:
        return False
    return made.id[:1].isupper() and not made.id.isupper()
