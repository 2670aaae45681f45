"""`porse demo`: the whole way at tiny size, in a minute: search, winner, film, report.

It runs in this process (`porse.iteration`), without DVC and without a network: recorded replies answer what they can, and the
grammar the rest.
"""

import os
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from porse import numerics
from porse.comparison.film import winner_film
from porse.config import load_document, parse_params
from porse.documents import read_yaml, render_yaml
from porse.errors import PorseError
from porse.printing import echo
from porse.renderer import has_display, no_renderer
from porse.report.markdown import results_table
from porse.report.page import no_film, page_of, render
from porse.report.results import read_results
from porse.repro import check_start
from porse.stage import LOGS, write_manifest

SMOKE = Path(__file__).with_name("smoke.yaml")
"""The parameters of the size `smoke`, laid over those of a file."""


def smoke(document: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a parsed `params.yaml` at the size `smoke`: the values of `SMOKE` take the place of its own."""
    found = dict(document)
    for key, value in read_yaml(SMOKE).items():
        own = found.get(key)
        found[key] = {**own, **value} if isinstance(own, Mapping) and isinstance(value, Mapping) else value
    return found


@click.command()
@click.option(
    "--out",
    default="demo",
    show_default=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the run; created if missing.",
)
@click.option(
    "--params", "path", default="params.yaml", show_default=True, type=click.Path(dir_okay=False, path_type=Path)
)
@click.option("--open/--no-open", "opens", default=True, help="Open the report in a browser, where there is a display.")
def demo(out: Path, path: Path, opens: bool) -> None:
    """Run everything at tiny size, in about a minute and without a network: the search, its winner's film, the report."""
    found = [name for name in ("run", "metrics.json") if (out / name).exists()]
    if found:
        raise PorseError(
            f"expected a folder without a run in it, found {', '.join(found)} in {out}; remove the folder, or name another "
            "with --out"
        )
    document = smoke(load_document(path))
    params = parse_params(document, f"{path} at the size smoke")
    check_start(params)
    out.mkdir(parents=True, exist_ok=True)
    (out / "params.yaml").write_text(render_yaml(document), encoding="utf-8")
    # Nothing here asks anybody, whatever the shell says.
    os.environ["PORSE_LLM_MODE"] = "frozen"
    # Before torch and MuJoCo are imported. A run is whole without a film.
    without = no_renderer()
    numerics.apply(params.numerics)
    from porse.generation.states import checker
    from porse.iteration import Place, run

    with checker(params) as check:
        run(params, Place(out, Path("prompts"), Path("llm_cache")), check, echo)
    write_manifest(out / LOGS)
    echo()
    results = read_results(out)
    echo(results_table(results.iterations, results.figures))
    echo()
    film = no_film(without) if without else winner_film(params, out)
    if film.gif:
        target = out / f"{params.task.replace(':', '.')}.gif"
        target.write_bytes(film.gif)
        echo(f"{target}: the winner")
    else:
        echo(f"no film: {film.words}", err=True)
    page = out / "report.html"
    page.write_text(render(page_of(results, film)), encoding="utf-8")
    echo(f"{page}: the report")
    if opens and has_display() and webbrowser.open(page.resolve().as_uri()):
        echo(f"{page}: opened")
