"""A traced list without what nobody needs: copies of constants that nothing changes, steps written twice, steps unread."""

import dataclasses

from porse.functions.run.operators import operator
from porse.functions.run.program import Program, Register, Step, mapped, registers


def tidied(program: Program) -> Program:
    """Returns a list with the same results, and as few steps as are needed.

    Where nothing is written over, equal steps are equal, and copies of constants are the constants. What no result and no
    writing step hangs on is left out.
    """
    writes = {step.operator for step in program.steps if operator(step.operator).writes}
    same: dict[int, int] = {}
    seen: dict[str, int] = {}
    steps: dict[int, Step] = {}
    for start, given in zip(program.starts, program.steps, strict=True):
        step = _moved(given, same)
        is_copy = step.operator == "clone.default" and step.arguments[0].index < program.first_made
        found = step.arguments[0].index if is_copy else seen.setdefault(repr(step), start)
        if writes or found == start:
            steps[start] = step
        else:
            same |= {start + index: found + index for index in range(step.makes)}
    results = [same.get(result, result) for result in program.results]
    live = set(results)
    for start, step in reversed([*steps.items()]):
        if step.operator not in writes and live.isdisjoint(range(start, start + step.makes)):
            del steps[start]
        else:
            live.update(registers(step.arguments))
    count = len(program.variables)
    given_live = [index for index in range(program.first_made) if index in live]
    made = [start + index for start, step in steps.items() for index in range(step.makes)]
    new = {old: place for place, old in enumerate([*given_live, *made])}
    return dataclasses.replace(
        program,
        variables=tuple(program.variables[index] for index in given_live if index < count),
        constants=tuple(program.constants[index - count] for index in given_live if index >= count),
        steps=tuple(_moved(step, new) for step in steps.values()),
        results=tuple(new[result] for result in results),
    )


def _moved(step: Step, to: dict[int, int]) -> Step:
    """Returns a step that reads other registers in place of some."""

    def changed(leaf: object) -> object:
        return Register(to.get(leaf.index, leaf.index)) if isinstance(leaf, Register) else leaf

    return dataclasses.replace(step, arguments=mapped(step.arguments, changed))
