"""What `dvc plots` draws: the numbers by hand, and the page without a network."""

import re
import shutil
import tarfile
from configparser import ConfigParser

import pytest
import yaml

import tiny
from browser import CHROMIUM, browser
from meaning_cases import row_of
from porse import tables
from porse.errors import PorseError
from porse.report.dvc_page import PACKAGES, PAGE, dvc_page
from porse.report.plots import bonus_rows, component_rows, spread_rows


def curve(iteration, name, series, values):
    return [
        row_of(tables.CURVES, iteration=iteration, rung="1", candidate_id=name, series=series, epoch=epoch, value=value)
        for epoch, value in enumerate(values, 1)
    ]


def link(iteration, name):
    return row_of(tables.CANDIDATES, iteration=iteration, candidate_id=name)


def test_the_spread_over_candidates_counts_epochs_on_and_leaves_out_what_is_no_number():
    curves = [
        *curve(1, "a", "fitness", [-4.0, -3.0, -1.0]),
        *curve(1, "b", "fitness", [-2.0, float("nan")]),
        *curve(1, "c", "fitness", [-7.0]),
        *curve(2, "d", "fitness", [-5.0]),
        *curve(2, "e", "fitness", [-8.0]),
        *curve(1, "a", "reward", [100.0]),
    ]
    assert spread_rows(curves) == [
        ["epoch", "iteration", "candidates", "lowest", "median", "highest"],
        [1, 1, 3, -7.0, -4.0, -2.0],
        [2, 1, 1, -3.0, -3.0, -3.0],
        [3, 1, 1, -1.0, -1.0, -1.0],
        # The fourth epoch is the first of iteration 2; the median of two is their mean.
        [4, 2, 2, -8.0, -6.5, -5.0],
    ]


def test_the_bonus_is_that_of_the_chain_and_of_no_other_candidate():
    curves = [
        *curve(1, "a", "bonus_share", [0.25, 0.5]), *curve(1, "a", "bonus_size", [2.0, 3.0]),
        *curve(1, "a", "goal_size", [7.0, 5.0]), *curve(1, "b", "bonus_share", [0.75]),
        *curve(2, "a", "bonus_share", [0.125]), *curve(2, "a", "bonus_size", [1.0]), *curve(2, "a", "goal_size", [4.0]),
    ]  # fmt: skip
    assert bonus_rows(curves, [link(1, "a"), link(2, "a")]) == [
        ["epoch", "bonus_share", "bonus_size", "goal_size", "candidate"],
        [1, 0.25, 2.0, 7.0, "a"],
        [2, 0.5, 3.0, 5.0, "a"],
        [3, 0.125, 1.0, 4.0, "a"],
    ]


def test_components_have_a_line_for_each_epoch_and_begin_where_their_link_does():
    curves = [
        *curve(1, "a", "fitness", [-1.0, -2.0]), *curve(1, "a", "component/near", [0.5, 0.75]),
        *curve(2, "d", "fitness", [-3.0]), *curve(2, "d", "component/slow", [9.0]), *curve(2, "d", "component/near", [8.0]),
        *curve(2, "x", "component/near", [1.0]),
    ]  # fmt: skip
    assert component_rows(curves, [link(1, "a"), link(2, "d")]) == [
        ["epoch", "component", "mean", "candidate"],
        [1, "near", 0.5, "a"],
        [2, "near", 0.75, "a"],
        [3, "near", 8.0, "d"],
        [3, "slow", 9.0, "d"],
    ]


def test_the_page_of_dvcs_plots_is_named_in_its_configuration_and_loads_nothing(root):
    configuration = ConfigParser()
    configuration.read(root / ".dvc" / "config")
    # DVC counts from .dvc.
    assert root / ".dvc" / configuration["plots"]["html_template"] == root / PAGE
    page = (root / PAGE).read_text(encoding="utf-8")
    assert (page.count("{plot_divs}"), page.count("{refresh_tag}"), page.count("{scripts}")) == (1, 1, 0)
    assert not re.search(r"<(script|link)[^>]+(src|href)=", page)
    # Which ones are inside: each says its version.
    assert all(f"{name} {version}" in page for name, version in PACKAGES.items())


def test_the_page_is_made_of_what_npm_packs(tmp_path):
    def pack(name, script):
        source = tmp_path / "script.js"
        source.write_text(script)
        with tarfile.open(tmp_path / f"{name}-{PACKAGES[name]}.tgz", "w:gz") as archive:
            archive.add(source, f"package/build/{name}.min.js")

    for name in ("vega", "vega-lite"):
        pack(name, f"window.{name[:4]} = 1;")
    with pytest.raises(PorseError, match="npm pack vega-embed@"):
        dvc_page(tmp_path)
    pack("vega-embed", "x = '</script>'")
    with pytest.raises(PorseError, match="that can stand in a page"):
        dvc_page(tmp_path)
    pack("vega-embed", "embed();")
    page = dvc_page(tmp_path)
    assert page.count("<script>") == 3
    assert page.index("window.vega = 1;") < page.index("embed();") < page.index("{plot_divs}")


@pytest.mark.skipif(CHROMIUM is None, reason="no browser: set PORSE_CHROMIUM, or have chromium on the PATH")
def test_the_plots_and_their_differences_are_drawn_without_a_network(tmp_path, root):
    project = tmp_path / "project"
    (project / "plots").mkdir(parents=True)
    declared = yaml.safe_load((root / "dvc.yaml").read_text())["plots"]
    (project / "dvc.yaml").write_text(yaml.safe_dump({"plots": declared}))
    lines = {
        "fitness": "epoch,fitness\n1,-2.0\n2,-1.5\n3,-0.5\n",
        "iterations": "iteration,score,mts\n1,-2.0,-1.0\n2,-1.5,-0.5\n",
        "candidates": "epoch,iteration,candidates,lowest,median,highest\n1,1,3,-7,-4,-2\n2,1,1,-3,-3,-3\n",
        "bonus": "epoch,bonus_share\n1,0.25\n2,0.5\n",
        "components": "epoch,component,mean,candidate\n1,near,0.5,a\n1,slow,0.1,a\n2,near,0.75,a\n2,slow,0.2,a\n",
    }
    assert {name for each in declared for name in each} == {f"plots/{name}.csv" for name in lines}
    for name, text in lines.items():
        (project / "plots" / f"{name}.csv").write_text(text)
    tiny.run(project, "git", "init", "-q")
    tiny.dvc(project, "init", "-q")
    shutil.copy(root / ".dvc" / "config", project / ".dvc" / "config")
    shutil.copytree(root / ".dvc" / "plots", project / ".dvc" / "plots", dirs_exist_ok=True)
    tiny.run(project, "git", "add", "-A")
    tiny.run(project, "git", "-c", "user.name=a", "-c", "user.email=a@b.invalid", "commit", "-qm", "one")
    (project / "plots" / "fitness.csv").write_text("epoch,fitness\n1,-2.5\n2,-1.0\n3,-0.25\n")
    with browser(tmp_path / "profile") as window:
        for command in (("show",), ("diff", "HEAD")):
            tiny.dvc(project, "plots", *command)
            page = project / "dvc_plots" / "index.html"
            window.open(page, 1280, 900)
            drawn = "document.querySelectorAll('.vega-embed canvas, .vega-embed svg').length"
            window.value(
                f"new Promise(done => {{ const look = () => {drawn} >= 5 ? done() : setTimeout(look, 50); look() }})"
            )
            assert window.value(drawn) >= len(lines)
            assert window.requests == [page.resolve().as_uri()]
            assert window.complaints == []
