"""Python's short forms as the longer ones that TorchScript knows: they compute the same.

A comprehension with a condition becomes a loop; a tuple that is gone through with others, a list; `zip(*rows)`, a list of
each column; `f(*parts)`, a call with the parts by their numbers; `sorted(terms)` of a dictionary, of its keys; and another
name for a function, that function. `getattr(self, f"{side}_hand_pos")` in a loop over texts that are written out becomes the
variables themselves.
"""

import ast
import copy
from collections import Counter
from collections.abc import Callable, Container, Iterator
from typing import TypeVar

from porse.code.scan import text_of

Node = TypeVar("Node", bound=ast.AST)
Comprehension = ast.ListComp | ast.GeneratorExp | ast.DictComp

_MAX_NODES = 2_000
"""Most nodes that loops over texts are written out to."""
_MAX_PARTS = 16
"""Most parts that a star is written out to."""


def write_plainly(function: ast.FunctionDef) -> None:
    """Rewrites a function in place."""
    _Unrolled(_fixed_values(function)).visit(function)
    _call_by_own_name(function)
    _replace(function, _columns)
    _Calls(_fixed_values(function)).visit(function)
    _list_what_is_gone_through(function)
    _Loops(function).run()


def start_apart(function: ast.FunctionDef) -> None:
    """Makes an assignment for each name, in place, of `values, names = [], []` and its like."""
    _replace(function, _starts)


def _replace(function: ast.FunctionDef, parts: Callable[[ast.stmt], list[ast.stmt]]) -> None:
    """Replaces every statement below a function by its parts."""
    for node in ast.walk(function):
        for name, value in ast.iter_fields(node):
            if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                setattr(node, name, [part for statement in value for part in parts(statement)])


def _starts(statement: ast.stmt) -> list[ast.stmt]:
    if not isinstance(statement, ast.Assign) or len(statement.targets) != 1:
        return [statement]
    target, value = statement.targets[0], statement.value
    if not isinstance(target, ast.Tuple) or not isinstance(value, ast.Tuple) or len(target.elts) != len(value.elts):
        return [statement]
    if any(isinstance(node, ast.Name) for node in ast.walk(value)):  # which one of the others may change
        return [statement]
    return [
        _at(statement, ast.Assign(targets=[name], value=start))
        for name, start in zip(target.elts, value.elts, strict=True)
    ]


def call_without_self(function: ast.FunctionDef, methods: Container[str]) -> None:
    """Writes `h(x)` for `h(self, x)`, in place, where `h` takes `self` first: whoever calls it has the same one."""
    for node in ast.walk(function):
        is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in methods
        if is_method and isinstance(node, ast.Call) and node.args and text_of(node.args[0]) == "self":
            node.args = node.args[1:]


def single_values(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the value of each name that a function binds once, by a plain assignment."""
    bound = Counter(
        node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    )
    bound.update(node.arg for node in ast.walk(function) if isinstance(node, ast.arg))
    found: dict[str, ast.expr] = {}
    for node in ast.walk(function):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        for target in targets:
            if isinstance(target, ast.Name) and bound[target.id] == 1 and value is not None:
                found[target.id] = value
    return found


def _fixed_values(function: ast.FunctionDef) -> dict[str, ast.expr]:
    """Returns the single values that stay what they are: of lists, those that are only gone through."""
    through = set()
    for node in ast.walk(function):
        if isinstance(node, ast.For | ast.comprehension):
            through.add(id(node.iter))
        elif isinstance(node, ast.Call) and text_of(node.func) in ("zip", "enumerate", "len", "sorted"):
            through.update(map(id, node.args))
        elif isinstance(node, ast.Starred):
            through.add(id(node.value))
    changed = {
        node.id
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and id(node) not in through
    }
    values = single_values(function).items()
    return {name: value for name, value in values if not isinstance(value, ast.List) or name not in changed}


def _call_by_own_name(function: ast.FunctionDef) -> None:
    """Takes `d = self.dist` away and writes `self.dist(...)` for `d(...)`, where `d` is only ever called."""
    called = [id(node.func) for node in ast.walk(function) if isinstance(node, ast.Call)]
    read = [node for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)]
    values = {
        name: value
        for name, value in single_values(function).items()
        if isinstance(value, ast.Attribute | ast.Name)
        and any(node.id == name for node in read)
        and all(id(node) in called for node in read if node.id == name)
    }
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in values:
            node.func = values[node.func.id]
    for node in ast.walk(function):
        body = getattr(node, "body", None)
        if isinstance(body, list) and values:
            kept = [s for s in body if not (isinstance(s, ast.Assign) and s.value in values.values())]
            node.body = kept or body  # type: ignore[attr-defined]


def _columns(statement: ast.stmt) -> list[ast.stmt]:
    """Returns `x, up, names = zip(*rows)` as a list of each column, and any other statement as it is."""
    if not isinstance(statement, ast.Assign) or len(statement.targets) != 1:
        return [statement]
    target, value = statement.targets[0], statement.value
    if isinstance(value, ast.Call) and text_of(value.func) == "map" and len(value.args) == 2:
        value = value.args[1] if text_of(value.args[0]) in ("list", "tuple") else value
    is_zip = isinstance(value, ast.Call) and text_of(value.func) == "zip" and len(value.args) == 1
    rows = value.args[0] if isinstance(value, ast.Call) and is_zip else None
    held = rows.value if isinstance(rows, ast.Starred) else None
    if not isinstance(held, ast.Name) or not isinstance(target, ast.Tuple | ast.List):
        return [statement]
    texts = [f"[row[{number}] for row in {held.id}]" for number in range(len(target.elts))]
    return [
        _at(statement, ast.Assign(targets=[name], value=_parsed(text, statement)))
        for name, text in zip(target.elts, texts, strict=True)
    ]


class _Unrolled(ast.NodeTransformer):
    """Writes loops over written-out texts once for each text, where these name what is read from `self`."""

    def __init__(self, values: dict[str, ast.expr]) -> None:
        self._values = values
        self._left = _MAX_NODES

    def visit_For(self, node: ast.For) -> ast.AST | list[ast.stmt]:
        texts = self._texts(node.target, node.iter)
        leaves = any(isinstance(part, ast.Break | ast.Continue) for part in ast.walk(node))
        if texts is None or leaves or not any(map(_reads_by_name, node.body)) or not self._affords(node, texts):
            self.generic_visit(node)
            return node
        copies = [_With(node.target, text).visit(copy.deepcopy(part)) for text in texts for part in node.body]
        return [part for made in map(self.visit, copies) for part in (made if isinstance(made, list) else [made])]

    def visit_ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> ast.AST:
        first = node.generators[0]
        texts = self._texts(first.target, first.iter)
        is_plain = len(node.generators) == 1 and not first.ifs
        if texts is None or not is_plain or not _reads_by_name(node.elt) or not self._affords(node, texts):
            self.generic_visit(node)
            return node
        parts = [self.visit(_With(first.target, text).visit(copy.deepcopy(node.elt))) for text in texts]
        return _at(node, ast.List(elts=parts, ctx=ast.Load()))

    visit_GeneratorExp = visit_ListComp  # noqa: N815 their names are ast's

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        name = _text(node.args[1]) if _is_read_by_name(node) and len(node.args) == 2 and not node.keywords else ""
        return _at(node, ast.Attribute(value=node.args[0], attr=name, ctx=ast.Load())) if name.isidentifier() else node

    def _affords(self, node: ast.AST, texts: list[str]) -> bool:
        """Whether there may be so many copies of a loop; loops in loops would grow without bounds."""
        self._left -= len(texts) * sum(1 for _ in ast.walk(node))
        return self._left > 0

    def _texts(self, target: ast.expr, through: ast.expr) -> list[str] | None:
        """Returns the texts that a loop goes through, None where it is about anything else."""
        held = self._values.get(through.id) if isinstance(through, ast.Name) else through
        parts = held.elts if isinstance(held, ast.Tuple | ast.List) else []
        texts = [_text(part) for part in parts]
        return texts if isinstance(target, ast.Name) and texts and all(texts) else None


class _With(ast.NodeTransformer):
    """Writes a text for the name that stands for it."""

    def __init__(self, target: ast.expr, text: str) -> None:
        self._name = target.id if isinstance(target, ast.Name) else ""
        self._text = text

    def visit_Name(self, node: ast.Name) -> ast.AST:
        is_it = node.id == self._name and isinstance(node.ctx, ast.Load)
        return ast.copy_location(ast.Constant(value=self._text), node) if is_it else node


def _reads_by_name(tree: ast.AST) -> bool:
    """Whether `getattr(self, ...)` stands somewhere in a tree."""
    return any(isinstance(node, ast.Call) and _is_read_by_name(node) for node in ast.walk(tree))


def _is_read_by_name(call: ast.Call) -> bool:
    is_getattr = isinstance(call.func, ast.Name) and call.func.id == "getattr"
    return is_getattr and bool(call.args) and isinstance(call.args[0], ast.Name) and call.args[0].id == "self"


def _text(node: ast.expr) -> str:
    """Returns a text that is written out, in parts or as one, "" for anything else."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = _text(node.left), _text(node.right)
        return left + right if left and right else ""
    if isinstance(node, ast.JoinedStr):
        parts = [_text(part.value if isinstance(part, ast.FormattedValue) else part) for part in node.values]
        is_plain = all(not isinstance(part, ast.FormattedValue) or part.format_spec is None for part in node.values)
        return "".join(parts) if is_plain and all(parts) else ""
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


class _Calls(ast.NodeTransformer):
    """Writes out the stars of calls, and sorts the keys of dictionaries."""

    def __init__(self, values: dict[str, ast.expr]) -> None:
        self._values = values

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        node.args = [part for argument in node.args for part in self._parts(argument)]
        if len(node.args) == 1 and isinstance(node.args[0], ast.Starred):
            node.args = _spread(node.args[0], getattr(node.func, "attr", ""))
        first = node.args[0] if len(node.args) == 1 else None
        if isinstance(node.func, ast.Name) and node.func.id == "sorted" and isinstance(first, ast.Name):
            value = self._values.get(first.id)
            if isinstance(value, ast.Dict | ast.DictComp) or (value is not None and text_of(value).startswith("dict(")):
                keys = ast.Call(func=ast.Attribute(value=first, attr="keys", ctx=ast.Load()), args=[], keywords=[])
                node.args = [_at(node, keys)]
        return node

    def _parts(self, argument: ast.expr) -> list[ast.expr]:
        if not isinstance(argument, ast.Starred):
            return [argument]
        value = argument.value
        if isinstance(value, ast.List | ast.Tuple):
            return value.elts
        held = self._values.get(value.id) if isinstance(value, ast.Name) else None
        if not isinstance(held, ast.List | ast.Tuple) or not isinstance(value, ast.Name) or len(held.elts) > _MAX_PARTS:
            return [argument]
        return [_parsed(f"{value.id}[{number}]", argument) for number in range(len(held.elts))]


def _spread(argument: ast.Starred, function: str) -> list[ast.expr]:
    """Returns the arguments that the only one, with a star, stands for, where the function tells."""
    if function in ("zeros", "ones", "view", "reshape", "expand", "repeat", "permute", "tile"):
        return [argument.value]  # sizes, which may come as a list
    if function in ("minimum", "maximum") and isinstance(argument.value, ast.Name):
        return [_parsed(f"{argument.value.id}[{number}]", argument) for number in range(2)]
    return [argument]


def _list_what_is_gone_through(function: ast.FunctionDef) -> None:
    """Makes lists of tuples that `zip` and `enumerate` go through, and of tuples of rows, where they are not taken apart."""
    values = single_values(function)
    apart = {
        node.value.id
        for node in ast.walk(function)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name) and isinstance(node.targets[0], ast.Tuple)
    }
    through: list[tuple[ast.expr, bool]] = []
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("zip", "enumerate"):
            through += [(argument, True) for argument in node.args]
        elif isinstance(node, ast.For | ast.comprehension):
            through.append((node.iter, False))
    listed = set()
    for value, always in through:
        named = values.get(value.id) if isinstance(value, ast.Name) and value.id not in apart else None
        held = named if named is not None else value
        rows = held.elts if isinstance(held, ast.Tuple) else []
        if rows and (always or all(isinstance(row, ast.Tuple | ast.List) for row in rows)):
            listed.add(id(held))
    _Lists(listed).visit(function)


class _Lists(ast.NodeTransformer):
    def __init__(self, which: set[int]) -> None:
        self._which = which

    def visit_Tuple(self, node: ast.Tuple) -> ast.AST:
        is_listed = id(node) in self._which
        self.generic_visit(node)
        return ast.copy_location(ast.List(elts=node.elts, ctx=ast.Load()), node) if is_listed else node


class _Loops:
    """Writes comprehensions that have a condition, or go through several things, as loops before their statement."""

    def __init__(self, function: ast.FunctionDef) -> None:
        self._function = function
        self._names = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
        self._names |= {node.arg for node in ast.walk(function) if isinstance(node, ast.arg)}

    def run(self) -> None:
        self._function.body = self._body(self._function.body)

    def _body(self, body: list[ast.stmt]) -> list[ast.stmt]:
        return [part for statement in body for part in self._statement(statement)]

    def _statement(self, statement: ast.stmt) -> Iterator[ast.stmt]:
        for inner in ("body", "orelse"):
            if isinstance(getattr(statement, inner, None), list):
                setattr(statement, inner, self._body(getattr(statement, inner)))
        for name, value in ast.iter_fields(statement):
            if isinstance(value, ast.expr):
                taken = _Taken(self._new_name)
                setattr(statement, name, taken.visit(value))
                for kept, node in taken.found:
                    yield from self._body(self._loop(kept, node))
        yield statement

    def _new_name(self, stem: str) -> str:
        number = 1
        while f"{stem}_{number}" in self._names:
            number += 1
        self._names.add(f"{stem}_{number}")
        return f"{stem}_{number}"

    def _loop(self, kept: str, node: Comprehension) -> list[ast.stmt]:
        """Returns the statements that fill `kept` with what a comprehension gives."""
        bound = {
            part.id: self._new_name(part.id)
            for generator in node.generators
            for part in ast.walk(generator.target)
            if isinstance(part, ast.Name)
        }
        for part in ast.walk(node):
            if isinstance(part, ast.Name):
                part.id = bound.get(part.id, part.id)
        holder = ast.Name(id=kept, ctx=ast.Load())
        inner: ast.stmt
        if isinstance(node, ast.DictComp):
            place = ast.Subscript(value=holder, slice=node.key, ctx=ast.Store())
            inner = _at(node, ast.Assign(targets=[place], value=node.value))
        else:
            append = ast.Attribute(value=holder, attr="append", ctx=ast.Load())
            inner = _at(node, ast.Expr(value=ast.Call(func=append, args=[node.elt], keywords=[])))
        for generator in reversed(node.generators):
            for condition in reversed(generator.ifs):
                inner = _at(node, ast.If(test=condition, body=[inner], orelse=[]))
            inner = _at(node, ast.For(target=generator.target, iter=generator.iter, body=[inner], orelse=[]))
        empty = ast.Dict(keys=[], values=[]) if isinstance(node, ast.DictComp) else ast.List(elts=[], ctx=ast.Load())
        start = ast.Assign(targets=[ast.Name(id=kept, ctx=ast.Store())], value=empty)
        return [_at(node, start), inner]


class _Taken(ast.NodeTransformer):
    """Takes the outermost comprehensions that are to be loops out of an expression."""

    def __init__(self, new_name: Callable[[str], str]) -> None:
        self._new_name = new_name
        self.found: list[tuple[str, Comprehension]] = []

    def _take(self, node: Comprehension) -> ast.AST:
        if len(node.generators) == 1 and not node.generators[0].ifs:
            return node  # what is in it may need its names
        name = self._new_name("kept")
        self.found.append((name, node))
        return _at(node, ast.Name(id=name, ctx=ast.Load()))

    visit_ListComp = visit_GeneratorExp = visit_DictComp = _take  # noqa: N815 their names are ast's


def _parsed(text: str, where: ast.AST) -> ast.expr:
    """Returns the tree of a text of ours, all of it at the place of `where`."""
    tree = ast.parse(text, mode="eval").body
    for node in ast.walk(tree):
        ast.copy_location(node, where)
    return tree


def _at(where: ast.AST, node: Node) -> Node:
    """Returns a new node at the place of `where`; what was there before keeps its own."""
    return ast.fix_missing_locations(ast.copy_location(node, where))
