"""A traced list without what nobody needs: copies of constants that nothing changes, steps written twice, steps unread."""

import dataclasses

from porse.functions.run.operators import operator
from porse.functions.run.program import Program, Step, reads, replaced


def tidied(program: Program) -> Program:
    """Returns a list with the same results, and as few steps as are needed."""
    if not any(operator(step.operator).writes for step in program.steps):
        program = _once(program)
    return _needed(program)


def _moved(step: Step, moved: dict[int, int]) -> Step:
    return dataclasses.replace(step, arguments=replaced(step.arguments, moved), keywords=replaced(step.keywords, moved))


def _once(program: Program) -> Program:
    """Writes what stands twice once, and constants without copies. Where nothing is written over, equal steps are equal."""
    moved: dict[int, int] = {}
    seen: dict[str, int] = {}
    steps: list[Step] = []
    new = program.first_made
    for old, given in zip(program.starts, program.steps, strict=True):
        step = _moved(given, moved)
        is_copy = step.operator == "clone.default" and step.arguments[0].index < program.first_made
        found = step.arguments[0].index if is_copy else seen.setdefault(repr(step), new)
        if found == new:
            steps.append(step)
            new += step.makes
        moved |= {old + index: found + index for index in range(step.makes)}
    return dataclasses.replace(program, steps=tuple(steps), results=tuple(moved.get(r, r) for r in program.results))


def _needed(program: Program) -> Program:
    """Leaves out steps, constants and variables that no result and no writing step hangs on."""
    live = set(program.results)
    kept: list[tuple[int, Step]] = []
    for start, step in zip(program.starts[::-1], program.steps[::-1], strict=True):
        made = range(start, start + step.makes)
        if operator(step.operator).writes or not live.isdisjoint(made):
            live.update(reads(step))
            kept.append((start, step))
    kept.reverse()
    given = [index for index in range(program.first_made) if index in live]
    made_by_kept = [start + index for start, step in kept for index in range(step.makes)]
    moved = {old: new for new, old in enumerate([*given, *made_by_kept])}
    count = len(program.variables)
    return dataclasses.replace(
        program,
        variables=tuple(program.variables[index] for index in given if index < count),
        constants=tuple(program.constants[index - count] for index in given if index >= count),
        steps=tuple(_moved(step, moved) for _, step in kept),
        results=tuple(moved[r] for r in program.results),
    )
