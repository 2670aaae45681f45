"""A traced list without what nobody needs: copies of constants that nothing changes, steps written twice, steps unread."""

import dataclasses
from typing import Any

from porse.functions.run.operators import operator
from porse.functions.run.program import Program, Step, reads, replaced


def tidied(program: Program) -> Program:
    """Returns a list with the same results, and as few steps as are needed."""
    if not any(operator(step.operator).writes for step in program.steps):
        program = _once(program)
    return _needed(program)


def _once(program: Program) -> Program:
    """Writes what stands twice once, and constants without copies. Where nothing is written over, equal steps are equal."""
    moved: dict[int, int] = {}
    seen: dict[Any, int] = {}
    steps: list[Step] = []
    old = new = program.first_made
    for step in program.steps:
        given = tuple(replaced(value, moved) for value in step.arguments)
        keywords = tuple((name, replaced(value, moved)) for name, value in step.keywords)
        key = repr((step.operator, given, keywords))
        is_copy = step.operator == "clone.default" and given[0].index < program.first_made
        found = given[0].index if is_copy else seen.get(key)
        if found is None:
            found = seen[key] = new
            steps.append(Step(step.operator, given, keywords, step.makes))
            new += step.makes
        for index in range(step.makes):
            moved[old + index] = found + index
        old += step.makes
    return dataclasses.replace(program, steps=tuple(steps), results=tuple(moved.get(r, r) for r in program.results))


def _needed(program: Program) -> Program:
    """Leaves out steps, constants and variables that no result and no writing step hangs on."""
    starts, made = [], program.first_made
    for step in program.steps:
        starts.append(made)
        made += step.makes
    live = set(program.results)
    kept = []
    for start, step in zip(reversed(starts), reversed(program.steps), strict=True):
        if operator(step.operator).writes or live & set(range(start, start + step.makes)):
            live.update(reads(step))
            kept.append((start, step))
    kept.reverse()
    moved: dict[int, int] = {}
    for index in range(program.first_made):
        if index in live:
            moved[index] = len(moved)
    first = len(moved)
    for start, step in kept:
        for index in range(step.makes):
            moved[start + index] = first + index
        first += step.makes
    count = len(program.variables)
    return dataclasses.replace(
        program,
        variables=tuple(name for index, name in enumerate(program.variables) if index in moved),
        constants=tuple(c for index, c in enumerate(program.constants, start=count) if index in moved),
        steps=tuple(
            Step(
                s.operator,
                tuple(replaced(v, moved) for v in s.arguments),
                tuple((n, replaced(v, moved)) for n, v in s.keywords),
                s.makes,
            )
            for _, s in kept
        ),
        results=tuple(moved[r] for r in program.results),
    )
