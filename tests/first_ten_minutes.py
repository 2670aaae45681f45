"""Records docs/first-ten-minutes.md: a fresh clone, the commands of a newcomer in a real terminal, and the report in a browser.

`python tests/first_ten_minutes.py FOLDER` clones this repository's last commit into FOLDER/porse, puts the environment that runs
this script in the place of `make setup`, types every command of `STEPS` in a pseudo-terminal, and writes the page, pictures of the
terminal (SVG, by rich) and of the report (PNG, by Chromium; see tests/browser.py) to docs/. Needs `pip install pyte`, a terminal in
Python. What the terminals said is kept in FOLDER/said, so that a second call with the same folder draws without running again.
"""

import io
import itertools
import json
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image
from rich.console import Console
from rich.style import Style
from rich.text import Text

from browser import browser
from terminal import on_a_terminal
from tiny import QUIET, ROOT

COLUMNS, ROWS = 100, 32
WIDTH = 120
"""Of the page's lines."""
PAGE, PICTURES = ROOT / "docs" / "first-ten-minutes.md", ROOT / "docs" / "first-ten-minutes"
MOST_LINES = 46
"""Of a command's output, so many lines are on the page: the first and the last ones."""


@dataclass(frozen=True)
class Step:
    """One command.

    Attributes:
        words: what stands above it on the page.
        command: as it is typed.
        still: name of a picture of the terminal in the middle of it; empty for none.
        until: the picture is of the last screen with this text on it.
    """

    words: str
    command: str
    still: str = ""
    until: str = ""


STEPS = (
    Step(
        "`make demo` sets up `.venv` (left out here: it was there) and runs everything at tiny size: rewards and mappings, the "
        "population's trainings, eliminations, mutants, the winner's evaluation, its film, the report. Recorded replies answer; a "
        "seeded grammar answers the other questions.",
        "make demo",
        "demo",
        "best fitness",
    ),
    Step("The same answer in the terminal. `--json` has every figure.", "porse results demo"),
    Step("Which tasks are there? 25 of them; these have a door.", "porse tasks --tag door"),
    Step(
        "Every parameter has a value, and comes from somewhere. A stage reads some of them.",
        "porse params --stage eliminate",
    ),
    Step(
        "The demo is not a pipeline. To see one in a minute, run the real pipeline with the demo's parameters: DVC caches each "
        "stage, and you can kill it at any instant.",
        "cp demo/params.yaml params.yaml && porse pipeline && porse repro",
        "repro",
        "left over all",
    ),
    Step("Where is it?", "porse status"),
    Step(
        "The run is finished. Commit it.",
        "git add -A && git -c user.name=me -c user.email=me@here commit -qm 'a run'",
    ),
    Step(
        "Change one value: let the winner play 48 episodes instead of 32. Only what reads the value runs again.",
        "sed -i 's/episodes: 32/episodes: 48/' params.yaml && porse status && porse repro",
    ),
    Step("What did it change? The parameter, and one figure.", "dvc params diff && dvc metrics diff"),
    Step(
        "Undo the change. The earlier results are in DVC's cache, so nothing is trained.",
        "git checkout -q . && porse repro",
    ),
)

SHOTS = {
    "report": (
        1280,
        900,
        False,
        "document.body",
        "The top of the report: the answer, its interval, the winner's film.",
    ),
    "tree": (1280, 700, False, "document.querySelector('#population, #tree, svg.tree')", "The population as a tree."),
    "phone": (390, 844, True, "document.body", "The same page on a phone."),
}


def record(step: Step, number: int, folder: Path, said: Path, environment: dict[str, str]) -> None:
    """Runs a step, unless it was, and keeps what the terminal was told."""
    target = said / f"{number}.bin"
    if target.is_file():
        return
    print(f"[{number}/{len(STEPS)}] {step.command}", flush=True)
    code, pieces = on_a_terminal(["bash", "-c", step.command], ROWS, COLUMNS, environment, folder)
    if code:
        sys.exit(f"{step.command} ended with {code}")
    target.write_bytes(json.dumps([piece.hex() for piece in pieces]).encode())


def pieces_of(said: Path, number: int) -> list[bytes]:
    """Returns the pieces that `record` kept."""
    return [bytes.fromhex(piece) for piece in json.loads((said / f"{number}.bin").read_text())]


def lines_of(pieces: Sequence[bytes]) -> list[str]:
    """Returns the lines that stand in a terminal in the end, those that scrolled off among them."""
    import pyte

    screen = pyte.HistoryScreen(COLUMNS, ROWS, history=5000)
    stream = pyte.ByteStream(screen)
    for piece in pieces:
        stream.feed(piece)
    above = ["".join(line[column].data for column in range(COLUMNS)) for line in screen.history.top]
    lines = [line.rstrip() for line in (*above, *screen.display)]
    while lines and not lines[-1]:
        lines.pop()
    return lines


def still_of(pieces: Sequence[bytes], until: str, target: Path, title: str) -> None:
    """Draws the fullest screen that has a text on it, as .svg."""
    import pyte

    screen = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.ByteStream(screen)
    best: list[Text] = []
    fullest = 0
    for piece in pieces:
        stream.feed(piece)
        # A bar is written anew whenever it moves.
        shown = sum(bool(line.strip()) for line in screen.display) if until.encode() in piece else 0
        if shown > fullest or shown == ROWS:
            best, fullest = [_styled(screen, row) for row in range(ROWS)], shown
    while best and not best[-1].plain:
        best.pop()
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    for line in best:
        console.print(line)
    # Without the fonts that rich would have a browser fetch.
    drawn = re.sub(r"@font-face \{.*?\}", "", console.export_svg(title=title), flags=re.DOTALL)
    target.write_text(drawn, encoding="utf-8")


def _styled(screen: Any, row: int) -> Text:
    """Returns a row of a screen; neighbours of one look are one piece of it."""
    text = Text()
    cells = [screen.buffer[row][column] for column in range(COLUMNS)]
    while cells and cells[-1].data == " ":
        cells.pop()
    for (colour, bold), same in itertools.groupby(cells, lambda cell: (cell.fg, cell.bold)):
        if colour in _COLOURS:
            style = Style(color=_COLOURS[colour], bold=bold)
        else:
            style = Style(color=f"#{colour}" if re.fullmatch("[0-9a-f]{6}", colour) else colour, bold=bold)
        text.append("".join(cell.data for cell in same), style)
    return text


_COLOURS = {"default": None, "brown": "yellow"}
"""What pyte calls otherwise."""


def shortened(lines: Sequence[str]) -> list[str]:
    """Returns lines, and where they are too many, the first and the last of them."""
    if len(lines) <= MOST_LINES:
        return [*lines]
    half = MOST_LINES // 2
    return [*lines[:half], "...", *lines[-half:]]


def page(said: Path) -> str:
    """Returns the page."""
    parts = [
        "# The first ten minutes",
        "",
        "This page shows what a newcomer types in a fresh clone, and sees. `python tests/first_ten_minutes.py` recorded it in a",
        f"terminal of {COLUMNS} columns, on two cores. The environment was activated (`. .venv/bin/activate`). Every run gives these",
        "results; steps per second are those of one machine.",
    ]
    for number, step in enumerate(STEPS, 1):
        parts += [
            "",
            *textwrap.wrap(step.words, WIDTH, break_long_words=False, break_on_hyphens=False),
            "",
            "```console",
            f"$ {step.command}",
            *shortened(lines_of(pieces_of(said, number))),
            "```",
        ]
        if step.still:
            parts += [
                "",
                "In the middle of it:",
                "",
                f"![The terminal while it runs](first-ten-minutes/{step.still}.svg)",
            ]
        if number == 1:
            parts += ["", "The report, `demo/report.html`, is one file, and asks for nothing:"]
            for name, (*_, words) in SHOTS.items():
                parts += ["", f"![{words}](first-ten-minutes/{name}.png)"]
    return "\n".join(parts) + "\n"


def outputs(text: str) -> dict[str, list[str]]:
    """Returns the lines below each command of the page."""
    blocks = re.findall(r"^```console\n\$ ([^\n]*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return {command: output.splitlines() for command, output in blocks}


def shots(report: Path, profile: Path) -> None:
    """Takes pictures of the report, in few colours: they are small, and text stays sharp."""
    with browser(profile) as window:
        for name, (width, height, phone, place, _) in SHOTS.items():
            window.open(report, width, height, phone=phone)
            window.value(f"({place}).scrollIntoView()")
            target = PICTURES / f"{name}.png"
            window.picture(target)
            with Image.open(target) as image:
                image.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(target, optimize=True)


def main(folder: Path) -> None:
    """Records what was not recorded, and writes page and pictures."""
    said, clone = folder / "said", folder / "porse"
    said.mkdir(parents=True, exist_ok=True)
    if not clone.exists():
        subprocess.run(["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(clone)], check=True)
        (clone / ".venv").symlink_to(sys.prefix)
        (clone / ".venv" / "ready").touch()
    environment = {**os.environ, **QUIET, "TERM": "xterm-256color", "PYTHONPATH": str(clone)}
    environment["PATH"] = f"{clone / '.venv' / 'bin'}:{environment['PATH']}"
    for name in ("COLUMNS", "LINES", "DISPLAY"):
        environment.pop(name, None)
    for number, step in enumerate(STEPS, 1):
        record(step, number, clone, said, environment)
    PICTURES.mkdir(exist_ok=True)
    for number, step in enumerate(STEPS, 1):
        if step.still:
            still_of(pieces_of(said, number), step.until, PICTURES / f"{step.still}.svg", step.command)
    shots(clone / "demo" / "report.html", folder / "profile")
    PAGE.write_text(page(said), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
