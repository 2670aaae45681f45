"""Bounds that a compiled graph must keep whatever the data are: sizes, loops, and what hides behind a branch.

The probe sees a function on some states only. What could grow later, with other data, is refused here or tried out by
force: whole numbers made from tensors, deep loops, large constants, and branches that those states do not take.
"""

import math
from collections.abc import Iterator
from typing import Any

from porse.functions.read.contract import MAX_ELEMENTS, MAX_LOOP, MAX_ROUNDS, words
from porse.code.graph import line_of, nodes
from porse.functions.verdict import CodeError

_SHAPES = frozenset(
    ("aten::size", "aten::len", "aten::dim", "aten::ndim", "aten::numel", "prim::dtype", "prim::layout")
)
_MAKERS = words("""
    aten::arange aten::expand aten::eye aten::full aten::linspace aten::new_full aten::new_ones aten::new_zeros aten::ones
    aten::repeat aten::tile aten::zeros
    """)
_ROUNDS_OF_SIZE = 1000
_ROUNDS_OF_LIST = 100
"""What a loop over environments, and one over a list, counts for when loops are nested."""


def check_bounds(graph: Any) -> None:
    """Refuses a graph whose use of time or memory could depend on data or is plainly too large.

    Raises:
        CodeError: check "static", with the line of the compiled text.
    """
    for node in nodes(graph):
        _check_whole_numbers(node)
        if node.kind() in _MAKERS:
            _check_made(node)
        if node.kind() == "aten::mul" and "[]" in node.output().type().str():
            _check_repeated(node)
    _check_loops(graph, 1)


def _check_whole_numbers(node: Any) -> None:
    kind = node.kind()
    if kind in _SHAPES or kind in ("aten::item", "prim::Loop"):  # what a loop makes is made by a node in it
        return
    if kind == "aten::arange":
        made = [value for value in node.inputs() if value.type().str() != "int" and _is_data(value)]
    elif any(_is_data(value) for value in node.inputs()):
        made = [value for value in node.outputs() if value.type().str() in ("int", "Scalar")]
    else:
        made = []
    if made:
        message = (
            f"{kind.partition('::')[2]} makes a whole number or a size from the values of a tensor, which is not"
            " allowed; sizes come from shapes and num_envs, and tensors stay tensors (torch.maximum, not max)"
        )
        raise CodeError("static", message, line_of(node))


def _is_data(value: Any) -> bool:
    return value.type().str() in ("Tensor", "float", "Scalar", "number") and value.node().kind() != "prim::Constant"


def _check_made(node: Any) -> None:
    constants = [v.toIValue() for v in node.inputs() if v.node().kind() == "prim::Constant"]
    lists = [value for value in constants if isinstance(value, list) and all(isinstance(n, int) for n in value)]
    numbers = [value for value in constants if isinstance(value, int | float) and not isinstance(value, bool)]
    for value in node.inputs():
        if value.node().kind() == "prim::ListConstruct":
            known = [v.toIValue() for v in value.node().inputs() if v.node().kind() == "prim::Constant"]
            lists.append([n for n in known if isinstance(n, int)])
    sizes = [math.prod(abs(n) for n in value if n != 0) for value in lists]
    if node.kind() in ("aten::eye", "aten::arange", "aten::linspace"):
        sizes += [abs(n) for n in numbers]
    if any(size > MAX_ELEMENTS for size in sizes):
        raise CodeError("static", f"a tensor of more than {MAX_ELEMENTS} numbers is not allowed", line_of(node))


def _check_repeated(node: Any) -> None:
    times = [value.toIValue() for value in node.inputs() if value.node().kind() == "prim::Constant"]
    if any(isinstance(number, int) and number > MAX_LOOP for number in times):
        raise CodeError("static", f"a list that is repeated more than {MAX_LOOP} times is not allowed", line_of(node))


def _check_loops(block: Any, outer: int) -> None:
    for node in block.nodes():
        rounds = outer * _rounds(node) if node.kind() == "prim::Loop" else outer
        if rounds > MAX_ROUNDS:
            raise CodeError("static", "the nested loops take too many rounds; use tensor operations", line_of(node))
        for inner in node.blocks():
            _check_loops(inner, rounds)


def _rounds(node: Any) -> int:
    count = node.inputsAt(0)
    if count.node().kind() == "prim::Constant":
        return max(int(count.toIValue()), 1)
    return _ROUNDS_OF_LIST if count.node().kind() in ("aten::len", "prim::min", "aten::min") else _ROUNDS_OF_SIZE


def forced_graphs(graph: Any) -> Iterator[Any]:
    """Yields, for each side of each branch, a copy of the graph that takes it whatever the data are."""
    choices: list[dict[int, bool]] = []
    _collect(graph, {}, [0], choices)
    for choice in choices:
        copy = graph.copy()
        branches = [node for node in nodes(copy) if node.kind() == "prim::If"]
        first = next(iter(copy.nodes()))
        for number, side in choice.items():
            constant = copy.insertConstant(side)
            constant.node().moveBefore(first)
            branches[number].replaceInput(0, constant)
        yield copy


def _collect(block: Any, outer: dict[int, bool], counter: list[int], found: list[dict[int, bool]]) -> None:
    """Adds, for each side of each branch, the choices that lead there, by the branch's number in the text's order."""
    for node in block.nodes():
        if node.kind() != "prim::If":
            for inner in node.blocks():
                _collect(inner, outer, counter, found)
            continue
        number = counter[0]
        counter[0] += 1
        for side, inner in zip((True, False), node.blocks(), strict=True):
            choice = {**outer, number: side}
            if not _is_about_layout(node):
                found.append(choice)
            _collect(inner, choice, counter, found)


def _is_about_layout(branch: Any) -> bool:
    """Whether a branch is one of torch's own about memory layouts, which nothing here can change."""
    condition = branch.inputsAt(0).node()
    return condition.kind() == "aten::eq" and condition.inputsAt(0).node().kind() == "prim::layout"
