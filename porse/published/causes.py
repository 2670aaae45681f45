"""Why an output may differ from the published one: edited files, other parameters, versions, another kind of CPU."""

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

from porse import numerics
from porse.config import Params
from porse.printing import visible
from porse.published.inputs import Changes, changes, read_folder

_NAMED = 5
"""So many files, parameters or packages are named one by one."""

_CPU = ("cpu", "machine")


def changed_inputs(then: Path, now: Path, kinds: Sequence[str]) -> dict[str, Changes]:
    """Returns what differs between the inputs in two folders, by the kind of stage; only kinds where something does."""
    before, after = read_folder(then), read_folder(now) if now.is_dir() else {}
    found = {kind: changes(before[kind], after[kind]) for kind in {*kinds} if kind in before and kind in after}
    return {kind: change for kind, change in sorted(found.items()) if change}


def causes(folder: Path, params: Params, change: Changes) -> list[str]:
    """Returns likely causes of a difference, the likeliest first, a sentence each.

    Args:
        folder: the published run.
        params: its parameters.
        change: what differs in the inputs of the stage.
    """
    path = folder / "logs" / "environment.json"
    then: Mapping[str, str] = json.loads(path.read_bytes()) if path.is_file() else {}
    now = numerics.manifest()
    found = []
    if change.files:
        found.append(f"edited files: {named(change.files)} are not what they were when the run was made")
    if change.parameters:
        found.append(f"other parameters: {named(change.parameters)}, by a preset or a set of this version")
    versions = [
        f"{name.removeprefix('package ')} {then[name]} there and {now[name]} here"
        for name in now
        if name in then
        and then[name] != now[name]
        and name not in _CPU
        and (name == "python" or name.startswith("package "))
    ]
    if versions:
        found.append(f"versions: {named(versions)}; `make setup` installs those of requirements.lock")
    found += _instruction_set(then, now, params)
    if not then:
        found.append("unknown: the run came without a record of the machine that made it")
    return found or [
        "none on record: files, parameters, versions and CPU are the run's; compute it once more, and report it if it differs again"
    ]


def _instruction_set(then: Mapping[str, str], now: Mapping[str, str], params: Params) -> list[str]:
    if platform.machine() not in ("x86_64", "AMD64"):
        return [f"instruction set: this is a {platform.machine()}, and bits are kept on x86-64 CPUs with AVX2"]
    if not then or all(then.get(name) == now[name] for name in _CPU):
        return []
    cpus = f"{then.get('cpu') or 'an unknown CPU'} there and {now['cpu'] or 'an unknown CPU'} here"
    if params.numerics == "fast":
        return [f"instruction set: {cpus}; numerics: fast gives the same bits on one kind of CPU alone"]
    return [
        f"instruction set: {cpus}; numerics: portable should give the same bits on both, so that other causes come first"
    ]


def named(names: Sequence[str]) -> str:
    """Returns names as a list in words, on one line; of many, the first."""
    more = len(names) - _NAMED
    return ", ".join(visible(name, keep="") for name in names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
