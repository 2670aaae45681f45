"""The documented observation ranges are the code's, the pages are current, and the pictures show something."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

from porse.picture import write_png
from porse.report.charts import Chart, Line
from porse.report.svg import svg
from porse.report.task_layout import layout
from porse.report.task_pages import PAGES, PICTURES, TRAINED, charts, pages
from porse.task_names import TASK_TAGS
from porse.tasks import TASKS, make_task

NAMES = sorted(TASKS)
DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.parametrize("name", NAMES)
def test_documented_ranges_are_what_the_code_observes(name):
    task = make_task(name, 2, seed=1)
    generator = torch.Generator().manual_seed(1)
    for _ in range(3):
        task.step(torch.rand(2, task.NUM_ACTIONS, generator=generator) * 2 - 1)
    seen, values, start = task.compute_observations(), task.variables(), 0
    for block in layout(TASKS[name]):
        entries = seen[:, start : start + block.width]
        start += block.width
        if block.variable:
            expected = values[block.variable].flatten(1) if values[block.variable].dim() > 1 else values[block.variable]
            if block.columns is not None:
                expected = expected[:, block.columns[0] : block.columns[1]]
            assert torch.allclose(entries, block.scale * expected), block.meaning
        if block.meaning == "zeros":
            assert not entries.any()
    assert start == task.NUM_OBSERVATIONS


def test_dimensions_are_those_of_the_paper():
    door = (417, 52)
    expected = {
        "Quadcopter": (21, 12), "FrankaCabinet": (23, 9), "Anymal": (48, 12), "Humanoid": (108, 21),
        "Over": (398, 40), "ReOrientation": (422, 40), "CatchAbreast": (422, 52), "CatchOver2Underarm": (422, 52),
        "CatchUnderarm": (422, 52), "TwoCatchUnderarm": (446, 52), "DoorCloseInward": door, "DoorCloseOutward": door,
        "DoorOpenInward": door, "DoorOpenOutward": door, "Scissors": door, "SwingCup": door, "Switch": door,
        "Kettle": door, "LiftUnderarm": door, "Pen": door, "BottleCap": (422, 52), "GraspAndPlace": (425, 52),
        "BlockStack": (428, 52), "PushBlock": (428, 52),
    }  # fmt: skip
    found = {name: (task.NUM_OBSERVATIONS, task.NUM_ACTIONS) for name, task in TASKS.items()}
    assert {name: sizes for name, sizes in found.items() if name != "SwitchReachable"} == expected


@pytest.fixture(scope="module")
def written():
    return pages(DOCS)


def test_there_is_a_page_for_every_task_and_for_nothing_else(written):
    assert {path.stem for path in (DOCS / PAGES).iterdir()} == set(TASKS)
    assert {name for name in written if name.endswith(".md")} == {
        "tasks.md",
        "learned.md",
        *(f"{PAGES}/{name}.md" for name in TASKS),
    }


def test_the_charts_are_current_and_there_are_no_others(written):
    drawn = {name for name in written if name.startswith(f"{TRAINED}/")}
    assert drawn == {f"{TRAINED}/{path.name}" for path in (DOCS / TRAINED).glob("*.svg")}
    for name in drawn:
        assert (DOCS / name).read_text(encoding="utf-8") == written[name], "run: python -m porse.report.task_pages docs"


ROWS = [
    {"task": "Over", "seed": seed, "steps": steps, "fitness": fitness, "return": returned}
    for seed, steps, fitness, returned in (
        ("1", "60000", "0.1", "2"),
        ("1", "120000", "0.3", ""),
        ("2", "60000", "0.2", "5"),
        ("2", "120000", "0.4", "7"),
    )
]


def test_a_task_has_a_line_for_each_seed_and_the_published_return_as_far_as_the_first_point_beyond_ours():
    found = charts("Over", ROWS)
    assert sorted(found) == ["Over-return.svg", "Over.svg"]
    fitness, returns = found["Over.svg"], found["Over-return.svg"]
    assert [(line.name, list(line.points)) for line in fitness.lines] == [
        ("seed 1", [(60.0, 0.1), (120.0, 0.3)]),
        ("seed 2", [(60.0, 0.2), (120.0, 0.4)]),
    ]
    assert math.isnan(returns.lines[0].points[1][1])
    assert list(returns.lines[1].points) == [(60.0, 5.0), (120.0, 7.0)]
    theirs = returns.lines[2]
    assert theirs.name == "Bi-DexHands' PPO"
    steps, mean = zip(*theirs.points, strict=True)
    # Over's curve has points at 117 965 steps, 1.115, and at 4 476 109, 6.27.
    assert steps[-2:] == (117.965, 4476.109)
    assert mean[-2:] == pytest.approx((1.115, 6.27), abs=1e-3)
    _, low, high = theirs.band[-1]
    assert low < mean[-1] < high
    assert low + high == pytest.approx(2 * mean[-1])
    assert list(charts("Pen", ROWS)) == ["Pen.svg"]


def test_a_chart_is_a_file_of_its_own_that_names_its_lines_and_runs_nothing():
    shown = svg(Chart("a & <b>", "steps", "F", [Line("seed <1>", [(0.0, 0.0), (10.0, 2.0)]), Line("2", [(0.0, 1.0)])]))
    root = ElementTree.fromstring(shown)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("aria-label") == "a & <b>"
    words = [text.text for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert words[:2] == ["seed <1>", "2"]
    assert words[-2:] == ["steps", "F"]
    assert "script" not in shown


def test_a_legend_has_room_for_every_name():
    names = ["porse", "porse without-goal-reward", "eureka", "simhash", "roska", "human", "llmcount"]
    root = ElementTree.fromstring(svg(Chart("", "", "", [Line(name, [(0.0, 0.0), (1.0, 1.0)]) for name in names])))
    _, top, width, _ = map(float, root.get("viewBox").split())
    found = [text for text in root.iter("{http://www.w3.org/2000/svg}text") if text.get("class") == "name"]
    assert [text.text for text in found] == names
    rows = {}
    for text in found:
        rows.setdefault(float(text.get("y")), []).append((float(text.get("x")), 6 * len(text.text)))
    assert [len(row) for row in rows.values()] == [2, 2, 2, 1]
    assert top < min(rows) - 10
    assert max(rows) == 0.0
    for row in rows.values():
        ends = [*(x - 25 for x, _ in row[1:]), width]
        assert all(x + long <= end for (x, long), end in zip(row, ends, strict=True))


@pytest.mark.parametrize("name", ["tasks.md", "learned.md", *(f"{PAGES}/{name}.md" for name in NAMES)])
def test_a_page_is_current(written, name):
    assert (DOCS / name).read_text(encoding="utf-8") == written[name], "run: python -m porse.report.task_pages docs"


@pytest.mark.parametrize("name", ["tasks.md", "learned.md", *(f"{PAGES}/{name}.md" for name in NAMES)])
def test_what_a_page_links_to_is_there(written, name):
    links = re.findall(r"\]\(([^)#]+)\)", written[name])
    assert len(links) >= 2
    assert [link for link in links if not (DOCS / name).parent.joinpath(link).is_file()] == []


def test_the_index_is_read_in_a_few_minutes_and_leads_to_every_task(written):
    assert len(written["tasks.md"].split()) < 2500
    rows = [line for line in written["tasks.md"].splitlines() if line.startswith("| [")]
    for name in TASKS:
        row = next(row for row in rows if row.startswith(f"| [{name}]({PAGES}/{name}.md) |"))
        assert row.split(" | ")[1:2] == [", ".join(TASK_TAGS[name])], name


@pytest.mark.parametrize("name", NAMES)
def test_every_task_has_a_picture(name):
    assert (DOCS / PICTURES / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_png_holds_its_pixels(tmp_path):
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    write_png(tmp_path / "a.png", pixels)
    imageio = pytest.importorskip("imageio.v3")
    assert np.array_equal(imageio.imread(tmp_path / "a.png"), pixels)
