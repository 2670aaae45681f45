"""Stage resolve: what each of the other stages reads, in one file a stage, so that it depends on that and on no more."""

from pathlib import Path

import click

from porse.config import load_document, parse_params
from porse.inputs.resolve import resolve_inputs
from porse.pipeline import check_dependency, check_pipeline
from porse.stage import PlainCommand, run_stage, say
from porse.training.memory import check_memory


@click.command(cls=PlainCommand)
@click.option("--params", "source", required=True, type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path))
def main(source: Path, out: Path) -> None:
    """Writes the inputs of every stage."""
    root, document = Path(), load_document(source)
    params = parse_params(document, str(source))
    check_pipeline(root, params)
    check_dependency(root, params.task)
    check_memory(params)
    inputs = resolve_inputs(root, document, str(source))
    out.mkdir(parents=True, exist_ok=True)
    for name, own in inputs.items():
        (out / f"{name}.json").write_text(own.render(), encoding="utf-8")
    say(f"{params.method} on {params.task}: the inputs of {len(inputs)} stages")


if __name__ == "__main__":
    run_stage(main)
