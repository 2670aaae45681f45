"""The tasks, as people look for them."""

import json

import click

from porse.printing import echo, print_line
from porse.task_names import TAGS, TASK_ROWS


@click.command("tasks")
@click.option(
    "--tag", "tags", multiple=True, type=click.Choice([*TAGS]), help="Only tasks with this tag; may be given again."
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_tasks(tags: tuple[str, ...], as_json: bool) -> None:
    """Print the tasks, with sizes and tags."""
    rows = [row for row in json.loads(TASK_ROWS.read_text(encoding="utf-8")) if {*tags} <= {*row["tags"]}]
    if as_json:
        echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        tagged = ", ".join(row["tags"])
        sizes = f"{row['observations']:4} {row['actions']:3} {row['episode_length']:5}"
        print_line(f"{row['task']:20} {row['family']:7} {sizes} {tagged:20} ", row["description"])
    if not tags:
        echo()
        for tag, meaning in TAGS.items():
            print_line(f"{tag:11} ", meaning)
