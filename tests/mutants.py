"""Runs cosmic-ray's mutants against fast tests, a fork each: `python tests/mutants.py SESSION LOG [PATH...]`.

SESSION is what `cosmic-ray init tests/mutation.toml SESSION` wrote. One process imports everything, runs the tests of
`tests/mutation.toml` once and notes which of them run which line. For each mutant it forks; the child puts the mutant's code
into the modules that it has, and runs the tests of the changed lines until one fails, the fastest first. No file is edited.
LOG gets one line of JSON for each mutant, and a second call goes on from it: without the line of a mutant, that one is run
again. PATH names modules; without one, all are run.
"""

import ast
import gc
import importlib
import json
import os
import resource
import shlex
import sys
import time
import tomllib
import types
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "tests" / "mutation.toml"
EXAMPLES = 20
"""Examples of each property: hypothesis's own number costs more than all other tests together."""
PATIENCE = 3
"""A mutant that takes so many times the CPU time of its tests, and 1 s, goes round in circles, which is noticed too."""
BATCH = 20
"""Mutants to a fork: it costs more than most mutants do."""
FIRST = 10
"""How many tests of each mutant are run once more at the end of its batch."""


@dataclass(frozen=True)
class Mutant:
    """One change of one module.

    Attributes:
        path: the module's file, from the project's root.
        operator: cosmic-ray's name of the kind of change.
        occurrence: which of the operator's places in the module it is, from 0.
        rows: the first and the last changed line.
        source: the module's text with the change.
    """

    path: str
    operator: str
    occurrence: int
    rows: tuple[int, int]
    source: str

    @property
    def key(self) -> tuple[str, str, int]:
        """What names it in a log."""
        return self.path, self.operator, self.occurrence

    def change(self) -> dict[str, Any]:
        """Returns its first changed line, before and after."""
        before, after = (text.splitlines() for text in ((ROOT / self.path).read_text(), self.source))
        place = next(i for i, (one, other) in enumerate(zip(before, after, strict=False)) if one != other)
        return {"line": place + 1, "old": before[place].strip(), "new": after[place].strip()}


class _Meaning(ast.NodeTransformer):
    """Leaves out what no result depends on: annotations, and what the errors say."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant("")
        return self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.Raise:
        if isinstance(node.exc, ast.Call):
            node.exc.args = []
        return node


def meaning(source: str) -> str:
    """Returns what two modules have in common that differ in annotations, texts of errors or spaces alone."""
    return ast.dump(_Meaning().visit(ast.parse(source)))


def listed(session: Path, paths: Sequence[str]) -> list[Mutant]:
    """Returns the session's mutants of the modules that begin with an entry of `paths`, those without a meaning left out."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator
    from cosmic_ray.work_db import WorkDB, use_db

    seen: set[tuple[str, str]] = set()
    codes: dict[str, str] = {}
    found = []
    with use_db(str(session), WorkDB.Mode.open) as database:
        specs = [item.mutations[0] for item in database.work_items]
    for spec in specs:
        path = str(spec.module_path)
        if not any(map(path.startswith, paths)):
            continue
        if path not in codes:
            codes[path] = (ROOT / path).read_text()
            seen.add((path, meaning(codes[path])))
        source = mutate_code(
            codes[path], get_operator(spec.operator_name)(**(spec.operator_args or {})), spec.occurrence
        )
        try:
            compile(source, path, "exec")
        except SyntaxError:
            continue
        if (path, meaning(source)) not in seen:
            seen.add((path, meaning(source)))
            rows = spec.start_pos[0], spec.end_pos[0]
            found.append(Mutant(path, spec.operator_name.split("/")[-1], spec.occurrence, rows, source))
    return found


def functions(value: Any) -> list[types.FunctionType]:
    """Returns the functions of a function, a property, a class method or a wrapper; caches are emptied on the way."""
    while True:
        if isinstance(value, property):
            return [part for part in (value.fget, value.fset) if isinstance(part, types.FunctionType)]
        if isinstance(value, staticmethod | classmethod):
            value = value.__func__
        elif hasattr(value, "__wrapped__"):
            if hasattr(value, "cache_clear"):
                value.cache_clear()
            value = value.__wrapped__
        else:
            return [value] if isinstance(value, types.FunctionType) else []


def exchanged(old: Any, new: Any) -> bool:
    """Gives old functions the code of new ones, so that whoever holds them runs it; returns whether that says it all."""
    pairs = functions(old), functions(new)
    if type(old) is not type(new) or not pairs[0] or len(pairs[0]) != len(pairs[1]):
        return False
    for mine, other in zip(*pairs, strict=True):
        mine.__code__, mine.__defaults__, mine.__kwdefaults__ = other.__code__, other.__defaults__, other.__kwdefaults__
    return True


def differ(old: Any, new: Any) -> bool:
    """Returns whether two values are not equal; those that cannot be compared are not."""
    try:
        return bool(old != new)
    except (RuntimeError, TypeError, ValueError):
        return True


def plant(path: str, source: str) -> None:
    """Puts a mutated module's functions and values into the module that is loaded, and wherever they were imported by name."""
    name = path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    module = sys.modules[name]
    twin = types.ModuleType(name)
    vars(twin).update({key: value for key, value in vars(module).items() if key.startswith("__")})
    sys.modules[name] = twin
    try:
        exec(compile(source, str(module.__file__), "exec"), vars(twin))
    finally:
        sys.modules[name] = module
    for key, new in list(vars(twin).items()):
        old = vars(module).get(key)
        mine = getattr(new, "__module__", name) == name
        if key.startswith("__") or not mine or exchanged(old, new):
            continue
        if isinstance(old, type) and isinstance(new, type) and not _other_dataclass(old, new):
            _exchange_members(old, new)
        elif differ(old, new):
            _rebind(key, old, new)
            setattr(module, key, new)


def _other_dataclass(old: type, new: type) -> bool:
    options = (repr(getattr(kind, "__dataclass_params__", None)) for kind in (old, new))
    return len(set(options)) > 1


def _exchange_members(old: type, new: type) -> None:
    for key, value in list(vars(new).items()):
        before = vars(old).get(key)
        if exchanged(before, value):
            continue
        plain = isinstance(value, int | float | str | tuple) and not key.startswith("__")
        if functions(value) or (plain and differ(before, value)):
            setattr(old, key, value)


def _rebind(key: str, old: Any, new: Any) -> None:
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None) or ""
        own = file.startswith(f"{ROOT}/") and "site-packages" not in file
        # By its name too: equal numbers are one object.
        if own and vars(module).get(key) is old:
            setattr(module, key, new)


class _First:
    """Remembers the first test that failed."""

    name = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and not self.name:
            self.name = report.nodeid


def first_failure(tests: Sequence[Any], elsewhere: Any) -> str:
    """Runs tests in their order until one fails and returns its name, or an empty text.

    Args:
        tests: pytest's items.
        elsewhere: an item of another file: only fixtures that this one shares are kept. None: none are.
    """
    first = _First()
    manager = tests[0].config.pluginmanager
    manager.register(first)
    for test, following in zip(tests, [*tests[1:], elsewhere], strict=True):
        test.config.hook.pytest_runtest_protocol(item=test, nextitem=following)
        if first.name:
            break
    tests[0].session._setupstate.teardown_exact(elsewhere)
    manager.unregister(first)
    return first.name


def forked(work: Callable[[Callable[[Any], object]], object]) -> Iterator[Any]:
    """Runs `work` in a child of this process and yields what it tells with its argument, until it ends, however that is."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        # A group of its own: a mutant may end all of its group, and a child that it lets go on here ends.
        os.setpgrp()
        mine = os.getpid()
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        try:
            work(
                lambda news: os.write(writing, f"{json.dumps(news)}\n".encode()) if os.getpid() == mine else os._exit(0)
            )
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        yield from map(json.loads, pipe)
    os.waitpid(child, 0)


def traced(tests: Sequence[Any], paths: Collection[str]) -> Iterator[tuple[str, float, list[tuple[str, int]]]]:
    """Runs all tests and yields the name of each, its CPU seconds, and which lines of the modules it ran.

    Raises:
        RuntimeError: one failed.
    """
    files = {str(ROOT / path): path for path in paths}
    for test, following in zip(tests, [*tests[1:], None], strict=True):
        ran: set[tuple[str, int]] = set()

        def on_line(frame: types.FrameType, event: str, _: Any, ran: set[tuple[str, int]] = ran) -> Any:
            ran.add((files[frame.f_code.co_filename], frame.f_lineno))
            return on_line

        def on_call(frame: types.FrameType, event: str, _: Any, on_line: Any = on_line) -> Any:
            return on_line if frame.f_code.co_filename in files else None

        begun = time.process_time()
        sys.settrace(on_call)
        failed = first_failure([test], following)
        sys.settrace(None)
        if failed:
            raise RuntimeError(failed)
        yield test.nodeid, time.process_time() - begun, sorted(ran)


@dataclass(frozen=True)
class Covered:
    """A mutant, the tests that run a changed line, the fastest first, and the CPU seconds that they take together."""

    mutant: Mutant
    tests: Sequence[Any]
    cpu_s: float


class Loop:
    """Takes the place of pytest's loop over the tests that were collected."""

    def __init__(self, mutants: Sequence[Mutant], log: Path) -> None:
        self._mutants, self._log = mutants, log

    def pytest_runtestloop(self, session: Any) -> bool:
        """Runs the tests once, and then the mutants against them."""
        items = session.items
        _fewer_examples(items)
        # Fixtures of the session are made once, before any fork.
        for name in ("root", "params", "small"):
            item = next((item for item in items if name in getattr(item, "fixturenames", ())), None)
            if item is not None:
                first_failure([item], items[-1] if item is not items[-1] else items[0])
        paths = {mutant.path for mutant in self._mutants}
        gc.freeze()
        covered = list(self._covered(items, [*forked(lambda tell: [*map(tell, traced(items, paths))])]))
        with self._log.open("a") as log:
            for start in range(0, len(covered), BATCH):
                for entry in _outcomes(covered[start : start + BATCH], items):
                    log.write(json.dumps(entry) + "\n")
                log.flush()
        return True

    def _covered(
        self, items: Sequence[Any], known: Sequence[tuple[str, float, list[tuple[str, int]]]]
    ) -> Iterator[Covered]:
        if len(known) < len(items):
            failed = items[len(known)].nodeid
            importlib.import_module("pytest").exit(f"expected tests that pass without a mutant, found {failed}", 1)
        times = {name: cpu_s for name, cpu_s, _ in known}
        lines: dict[str, dict[int, set[str]]] = {}
        for name, _, ran in known:
            for path, row in ran:
                lines.setdefault(path, {}).setdefault(row, set()).add(name)
        for mutant in self._mutants:
            rows = lines.get(mutant.path, {})
            here = {name for row in range(mutant.rows[0], mutant.rows[1] + 1) for name in rows.get(row, ())}
            # A line that runs at import alone concerns whoever runs anything of the module.
            names = here or {name for found in rows.values() for name in found}
            tests = sorted((item for item in items if item.nodeid in names), key=lambda item: times[item.nodeid])
            yield Covered(mutant, tests, sum(times[name] for name in names))


def _outcomes(batch: Sequence[Covered], items: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Yields what became of each mutant, all in one child: between two of them the original comes back.

    At the end tests have to pass without a mutant, or else one left something behind, and each gets a child of its own.
    """
    answers = list(forked(lambda tell: _run(batch, items, tell)))
    if len(answers) <= len(batch):
        # The next one took too long, or ended the child.
        late = batch[len(answers)]
        yield from (_entry(case.mutant, answer) for case, answer in zip(batch, answers, strict=False))
        yield _entry(late.mutant, "no answer in time")
        yield from _outcomes(batch[len(answers) + 1 :], items) if batch[len(answers) + 1 :] else ()
    elif answers[-1]:
        for case in batch:
            yield from _outcomes([case], items)
    else:
        yield from (_entry(case.mutant, answer) for case, answer in zip(batch, answers[:-1], strict=True))


def _run(batch: Sequence[Covered], items: Sequence[Any], tell: Callable[[Any], object]) -> None:
    for case in batch:
        allowed = time.process_time() + 1.0 + PATIENCE * case.cpu_s
        resource.setrlimit(resource.RLIMIT_CPU, (int(allowed) + 1, resource.RLIM_INFINITY))
        tell(_first_to_notice(case, items))
    resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    # Alone, a mutant has left nothing behind for another one.
    tests = {test.nodeid: test for case in batch for test in case.tests[:FIRST]}
    tell(first_failure(list(tests.values()), None) if tests and len(batch) > 1 else "")


def _first_to_notice(case: Covered, items: Sequence[Any]) -> str | None:
    """Returns the test that fails with the mutant, an empty text if all pass, or None if there is none."""
    if not case.tests:
        return None
    files = {test.path for test in case.tests}
    elsewhere = next((item for item in items if item.path not in files), None)
    try:
        plant(case.mutant.path, case.mutant.source)
    except Exception as error:
        return f"its import: {error!r}"
    failed = first_failure(case.tests, elsewhere)
    plant(case.mutant.path, (ROOT / case.mutant.path).read_text())
    return failed


def _entry(mutant: Mutant, answer: str | None) -> dict[str, Any]:
    outcome = "no test" if answer is None else "killed" if answer else "survived"
    names = {"path": mutant.path, "operator": mutant.operator, "occurrence": mutant.occurrence}
    return {**names, **mutant.change(), "outcome": outcome, "by": answer or ""}


def _fewer_examples(items: Iterable[Any]) -> None:
    from hypothesis import HealthCheck, Phase, settings

    for item in items:
        used = getattr(item.obj, "_hypothesis_internal_use_settings", None)
        if used is not None:
            item.obj._hypothesis_internal_use_settings = settings(
                used,
                max_examples=EXAMPLES,
                phases=[Phase.explicit, Phase.generate],
                database=None,
                derandomize=True,
                deadline=None,
                suppress_health_check=list(HealthCheck),
            )


def summary(entries: Iterable[dict[str, Any]]) -> str:
    """Returns docs/mutation.md's table, mutants of each module, noticed and left, and a line for each one that is left."""
    entries = list(entries)
    left = [entry for entry in entries if entry["outcome"] != "killed"]
    listed, kept = Counter(entry["path"] for entry in entries), Counter(entry["path"] for entry in left)
    rows = [(f"`{path[6:-3]}`", listed[path], kept[path]) for path in sorted(listed)]
    rows.append(("together", listed.total(), kept.total()))
    table = [f"| {name} | {count} | {count - stay} | {stay} |" for name, count, stay in rows]
    changes = sorted(f"{e['path']}:{e['line']}: {e['old']}  =>  {e['new']} ({e['outcome']})" for e in left)
    return "\n".join(["| module | mutants | noticed | left |", "|---|---|---|---|", *table, *changes])


def main(session: str, log: str, *paths: str) -> int:
    """Runs the mutants that the log has not, and prints a summary of all of it."""
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    config = tomllib.loads(CONFIG.read_text())["cosmic-ray"]
    found = listed(Path(session), paths or config["module-path"])
    written = Path(log).read_text().splitlines() if Path(log).exists() else []
    done = {(entry["path"], entry["operator"], entry["occurrence"]) for entry in map(json.loads, written)}
    due = [mutant for mutant in found if mutant.key not in done]
    print(f"{len(found)} mutants, {len(due)} of them to be run", flush=True)
    if due:
        # Before torch is imported, as for the tests.
        importlib.import_module("porse.numerics").apply("portable")
        pytest = importlib.import_module("pytest")
        command = shlex.split(config["test-command"])
        arguments = [word for word in command[command.index("pytest") + 1 :] if word != "-x"]
        if pytest.main([*arguments, "--tb=native", "-W", "ignore"], plugins=[Loop(due, Path(log))]) not in (0, 1):
            return 1
    print(summary(map(json.loads, Path(log).read_text().splitlines())))
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    raise SystemExit(main(*sys.argv[1:]))
