"""Published runs: made of a real tiny run, looked at, damaged byte by byte, forged, sent over HTTP, and computed again."""

import copy
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import BaseRequestHandler
from typing import ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from click.testing import CliRunner
from safetensors import safe_open
from safetensors.numpy import save_file

from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.cli import main
from porse.config import parse_params
from porse.errors import PorseError
from porse.init import make_project as init_project
from porse.inputs.resolve import Inputs
from porse.published import check, command, fetch
from porse.published import publish as publishing
from porse.published.causes import causes
from porse.published.check import check_content
from porse.published.fetch import find, published_folders, receive
from porse.published.inputs import Changes, changes
from porse.published.locks import Shelf, digest, read_locks
from porse.published.manifest import (
    File,
    Manifest,
    check_files,
    is_allowed,
    make_manifest,
    parse_manifest,
    read_manifest,
)
from porse.published.replay import drawn, names_of, replay
from porse.published.shapes import policy_shapes
from porse.training.start import random_policy
from test_pipeline import Endpoint, git, tiny_params
from tiny import BIN, QUIET, ROOT, committed_params, dvc, make_project, run
from warm_stages import warm_stages


@pytest.fixture(autouse=True)
def _long(request):
    request.node.add_marker(pytest.mark.timeout(900))


@pytest.fixture(scope="module")
def warm(tmp_path_factory) -> Iterator[Path]:
    with warm_stages(tmp_path_factory.mktemp("warm")) as venv:
        yield venv


@contextmanager
def served(handler) -> Iterator[str]:
    """Gives the address of a server on loopback."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


class Quiet(SimpleHTTPRequestHandler):
    """A read-only server of plain files."""

    def log_message(self, *_):
        pass


class Asked(Endpoint):
    """An endpoint that counts its own questions."""

    asked: ClassVar[list[dict]] = []


@pytest.fixture(scope="module")
def project(tmp_path_factory, warm) -> Path:
    """A project with a run of one iteration, recorded from an endpoint, committed, and published as `tiny` with all its outputs."""
    params = tiny_params()
    params["iterations"] = [{"n": 1, "next": "result"}]
    project = make_project(tmp_path_factory.mktemp("published") / "project", params, warm)
    with served(Asked) as url:
        dvc(project, "repro", PORSE_LLM_MODE="record", PORSE_LLM_BASE_URL=f"{url}/v1", PORSE_LLM_CONCURRENCY="1")
    # A reply that another run read.
    other = min((ROOT / "llm_cache").glob("??/*.json")).relative_to(ROOT)
    (project / other).parent.mkdir(exist_ok=True)
    shutil.copy(ROOT / other, project / other)
    git(project, "add", "-A")
    git(project, "commit", "-qm", "a run")
    (project / "words.md").write_text("It hovers badly, and is <b>small</b>.")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        for name, value in QUIET.items():
            patch.setenv(name, value)
        # A film takes as long as all the rest.
        patch.setattr(publishing, "winner_film", lambda params, folder: publishing.no_film("none was drawn."))
        words = ["--words", "words.md"]
        done = CliRunner().invoke(main, ["publish", ".", "tiny", *words, "--remote", str(project.parent / "remote")])
    assert done.exit_code == 0, done.output
    return project


@pytest.fixture
def tiny_run(project, tmp_path) -> Path:
    """A copy of the published run, to be damaged."""
    shutil.copytree(project / "published" / "tiny", tmp_path / "tiny")
    return tmp_path / "tiny"


@pytest.fixture
def inside(project, monkeypatch) -> Path:
    monkeypatch.chdir(project)
    for name, value in QUIET.items():
        monkeypatch.setenv(name, value)
    return project


def seal(folder: Path) -> None:
    """Writes the manifest of a folder anew, as somebody would who forges a run."""
    (folder / "manifest.json").write_bytes(make_manifest(folder, {"porse": "0", "commit": ""}, ()).render())


def porse(*words: str):
    return CliRunner().invoke(main, list(words))


# What is published.


def test_a_published_run_holds_what_a_reader_needs_and_nothing_that_nobody_declared(project):
    folder = project / "published" / "tiny"
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    assert {
        "card.md", "report.html", "params.yaml", "metrics.json", "dvc.lock", "iterations/1/dvc.lock", "presets/Quadcopter.yaml",
        "inputs/mutate.json", "results/candidates.parquet", "run/result/start/policies/best.safetensors", "run/1/start/winner.parquet",
        "logs/environment.json", "outputs.dvc", "llm_cache/refreshed.txt",
    } <= {*manifest.files}  # fmt: skip
    for name in ("params.yaml", "dvc.lock", "metrics.json", "results/curves.parquet", "inputs/fuse.json"):
        assert (folder / name).read_bytes() == (project / name).read_bytes()
    # Stages that leave no part of a start, the results or the metrics: ten of iteration 1 but fuse, evaluation and plots.
    assert len(manifest.left_out) == 9 + 2
    assert {"run/1/train-1", "evaluation", "plots"} <= {*manifest.left_out}
    assert manifest.program["commit"] == git(project, "rev-parse", "HEAD").strip()


def test_it_has_the_replies_that_its_tables_name_and_no_others(project):
    rows = tables.read(project / "results" / "replies.parquet", tables.REPLIES)
    kept = {path.stem for path in (project / "published" / "tiny" / "llm_cache").glob("??/*.json")}
    assert kept == {row["key"] for row in rows}
    assert len(kept) == 8
    assert len([*(project / "llm_cache").glob("??/*.json")]) == 9


def test_the_card_says_what_it_is_in_its_authors_words_and_from_its_data(project):
    text = (project / "published" / "tiny" / "card.md").read_text()
    assert "## Its author's words\n\nIt hovers badly, and is <b>small</b>.\n" in text
    assert "| Task | Quadcopter | size cpu |" in text
    assert "| 8 replies (1 beta, 3 mapping, 4 reward) | local |" in text
    assert "| package torch |" in text
    assert "it is one search with one seed" in text
    assert "`dvc pull tiny/outputs.dvc` brings them" in text


def test_runs_are_listed(inside):
    (row,) = json.loads(porse("published", "--json").stdout)
    metrics = json.loads(Path("metrics.json").read_text())
    assert (row["name"], row["task"], row["method"], row["seed"]) == ("tiny", "Quadcopter", "porse", 1)
    assert (row["score"], row["mts"]) == (metrics["score"], metrics["mts"])
    # 3 candidates, 5 mutants and 2 survivors, each for a rung of 1 epoch.
    assert row["epochs"] == 3 + 5 + 2
    assert porse("published").stdout.startswith("tiny: porse on Quadcopter, ")


def test_the_page_is_shown_and_a_name_that_is_none_is_a_sentence(inside, monkeypatch):
    opened = []
    monkeypatch.setattr(command.renderer, "has_display", lambda: True)
    monkeypatch.setattr(command.webbrowser, "open", lambda address: opened.append(address) or True)
    assert porse("show", "tiny").exit_code == 0
    assert opened == [(inside / "published" / "tiny" / "report.html").as_uri()]
    done = porse("show", "tniy")
    assert "expected the name of a published run, found 'tniy'; published here: tiny" in done.output


def test_the_winner_plays_under_the_runs_name_with_its_own_parameters(inside, monkeypatch):
    asked = {}
    play = copy.copy(command.play)
    play.callback = command._with_published(lambda **values: asked.update(values))
    monkeypatch.setattr(command.renderer, "has_display", lambda: False)
    play.main(["tiny"], standalone_mode=False)
    folder = Path("published") / "tiny"
    names = ("task", "checkpoint", "path", "out", "seconds")
    assert [asked[name] for name in names] == [
        "Quadcopter", folder / "run", folder / "params.yaml", Path("tiny.gif"), command.FILM_S,
    ]  # fmt: skip
    play.main(["tiny", "--out", "a.mp4", "--seconds", "7"], standalone_mode=False)
    assert (asked["out"], asked["seconds"]) == (Path("a.mp4"), 7.0)
    monkeypatch.setattr(command.renderer, "has_display", lambda: True)
    play.main(["tiny"], standalone_mode=False)
    assert (asked["out"], asked["seconds"]) == (None, 10.0)
    play.main(["Over"], standalone_mode=False)
    assert [asked[name] for name in names] == ["Over", None, None, None, 10.0]
    params = command._params(folder)
    assert digest(command.shows.winners_policy(folder / "run", params)) == digest(
        Path("run/result/start/policies/best.safetensors")
    )


def test_what_a_suite_keeps_of_an_entry_is_published_with_the_rest_from_dvcs_cache(inside, tmp_path, monkeypatch):
    entry = tmp_path / "entry"
    for name in ("params.yaml", "metrics.json", "dvc.lock", "iterations/1/dvc.lock", "logs/environment.json"):
        (entry / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(name, entry / name)
    shutil.copytree("results", entry / "results")
    shutil.copytree("run/result/start", entry / "run" / "result" / "start")
    monkeypatch.setattr(publishing, "winner_film", lambda params, folder: publishing.no_film("none was drawn."))
    try:
        publishing.publish(entry, "from-a-suite", Path(), "", None, False, lambda line: None)
        own, other = (read_manifest(Path("published") / name).files for name in ("from-a-suite", "tiny"))
    finally:
        shutil.rmtree("published/from-a-suite")
    assert {*other} - {*own} == {"outputs.dvc"}
    # The other card says where its outputs can be pulled from.
    assert {name for name in own if own[name] != other[name]} == {"card.md"}


def test_a_run_whose_rungs_have_changed_is_published_after_the_next_repro(project, warm, tmp_path, monkeypatch):
    changed = tmp_path / "project"
    shutil.copytree(project, changed, symlinks=True)
    for name, value in QUIET.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(changed)
    params = yaml.safe_load(Path("params.yaml").read_text())
    params["rungs"][-1]["rung"], params["fuse"]["pool"] = "last", "eliminate-last"
    Path("params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    environment = {"PORSE_LLM_MODE": "frozen", "PORSE_PYTHON": str(warm / "bin" / "python")}
    run(changed, BIN / "porse", "pipeline")
    dvc(changed, "repro", **environment)
    monkeypatch.setattr(publishing, "winner_film", lambda params, folder: publishing.no_film("none was drawn."))
    publishing.publish(Path(), "again", Path(), "", None, False, lambda line: None)
    names = [stage.name for stage in read_locks(Path("published/again"))]
    assert ("1/eliminate-last" in names, "1/eliminate-2" in names) == (True, False)
    # What the last stages depend on is what a fresh clone would have.
    assert not Path("run/1/eliminate-2").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Tiny", "expected a name of at most 60 small letters"),
        ("a/b", "expected a name of at most 60 small letters"),
        ("../a", "expected a name of at most 60 small letters"),
        ("tiny", "expected no published run of the name tiny, found published/tiny"),
    ],
)
def test_a_name_is_a_word_that_is_free(inside, name, message):
    done = porse("publish", ".", name)
    assert (done.exit_code, message in done.output) == (1, True), done.output


def test_a_run_that_was_changed_or_never_was_is_not_published(inside, tmp_path):
    done = porse("publish", str(tmp_path), "b")
    assert "expected a finished run in" in done.output
    original = Path("params.yaml").read_text()
    try:
        Path("params.yaml").write_text(f"{original}\n# a word\n")
        assert "by its lock, found others" in porse("publish", ".", "b").output
    finally:
        Path("params.yaml").write_text(original)
    preset = Path("presets/Quadcopter.yaml")
    original = preset.read_text()
    try:
        preset.write_text(original.replace("gamma: ", "gamma: 0.5 # ", 1))
        assert "found train.gamma: 0.5 in place of" in porse("publish", ".", "b").output
    finally:
        preset.write_text(original)
    assert [path.name for path in published_folders(Path())] == ["tiny"]


@pytest.mark.parametrize(
    ("lock", "name", "part", "path", "message"),
    [
        # As after a new training, before the elimination behind it.
        ("iterations/1", "1/train-population-2", "outs", "run/1/train-2", "stage 1/eliminate-2 has not run since run/1/train-2 "),
        # As after the last iteration, before the evaluation.
        ("", "evaluate", "deps", "run", "stage evaluate has not run since run changed"),
    ],
)  # fmt: skip
def test_a_run_that_was_stopped_on_its_way_is_not_published(inside, lock, name, part, path, message):
    lock = Path(lock) / "dvc.lock"
    original = lock.read_text()
    stage = next(stage for stage in read_locks(Path()) if stage.name == name)
    try:
        lock.write_text(original.replace(getattr(stage, part)[path], f"{'0' * 32}.dir", 1))
        done = porse("publish", ".", "b")
    finally:
        lock.write_text(original)
    assert (done.exit_code, message in done.output) == (1, True), done.output


def test_what_does_not_fit_into_git_is_left_out_the_winner_last(inside, tmp_path, monkeypatch):
    params = command._params(Path("published/tiny"))
    source = publishing.Source(Path(), Path(), params, read_locks(Path()), Shelf([(Path(), "here")], None))
    best = Path("run/result/start/policies/best.safetensors").stat().st_size
    monkeypatch.setattr(publishing, "MOST_GIT_BYTES", publishing._SPARE_BYTES + best + 10)
    facts = publishing._copy_policies(source, tmp_path)
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()] == [
        "run/result/start/policies/best.safetensors"
    ]
    assert [fact.value for fact in facts] == ["1 of 1 iterations", "0 of 2 folders"]
    monkeypatch.setattr(publishing, "MOST_GIT_BYTES", publishing._SPARE_BYTES + best - 1)
    with pytest.raises(PorseError, match="expected room for the winner's policy"):
        publishing._copy_policies(source, tmp_path / "none")


# Damage.


def test_one_flipped_byte_in_any_file_is_refused_by_the_files_name(tiny_run):
    manifest = read_manifest(tiny_run)
    assert len(manifest.files) > 45
    for name in manifest.files:
        path = tiny_run / name
        data = path.read_bytes()
        # One of the first, the middle and the last; an empty file gets its first.
        for place in {0, len(data) // 2, len(data) - 1} if data else {0}:
            damaged = bytearray(data or b"\x00")
            damaged[place] ^= 0x20
            path.write_bytes(damaged)
            with pytest.raises(PorseError, match=f"^refused: .*{name}"):
                check_files(tiny_run, manifest)
        path.write_bytes(data)
    check_files(tiny_run, manifest)


def test_one_flipped_byte_anywhere_in_the_manifest_is_refused(tiny_run):
    data = (tiny_run / "manifest.json").read_bytes()
    parse_manifest(data, "manifest.json")
    for place in range(0, len(data), 13):
        for bit in (0x01, 0x20):
            damaged = bytearray(data)
            damaged[place] ^= bit
            with pytest.raises(PorseError, match=r"manifest\.json"):
                parse_manifest(bytes(damaged), "manifest.json")


def test_a_file_too_many_or_too_few_is_refused_by_its_name(tiny_run):
    manifest = read_manifest(tiny_run)
    (tiny_run / "results" / "more.parquet").touch()
    with pytest.raises(PorseError, match=r"results/more\.parquet, found one that it does not name"):
        check_files(tiny_run, manifest)
    (tiny_run / "results" / "more.parquet").unlink()
    (tiny_run / "results" / "curves.parquet").unlink()
    with pytest.raises(PorseError, match=r"results/curves\.parquet, found none of that name"):
        check_files(tiny_run, manifest)


def test_a_damaged_run_is_not_shown_or_played_or_replayed(inside):
    path = Path("published/tiny/results/curves.parquet")
    data = path.read_bytes()
    try:
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        for words in (["show", "tiny"], ["play", "tiny", "--out", "a.gif"], ["replay", "tiny"]):
            done = porse(*words)
            assert done.exit_code == 1
            assert (
                "refused: expected the bytes that were published at published/tiny/results/curves.parquet"
                in done.output
            )
    finally:
        path.write_bytes(data)


# Forgery: whoever makes a manifest can make a right one.


@pytest.mark.parametrize(
    "name",
    [
        "../a.py", "/etc/passwd", "results/../../a.parquet", "dvc.yaml", "iterations/1/dvc.yaml", "porse/cli.py", "prompts/reward.jinja",
        ".dvc/config", "results/.hidden.parquet", "results/a/b.parquet", "results/a b.parquet", "results/a\n.parquet", "code/../a.py",
        "code/.git/hooks/post-checkout", "llm_cache/aa/x.json", "run/1/start/policies/best.pt", "manifest.json", "", "outputs/run/a",
        "code/" + "a/" * 20 + "b.py", "results/caf\u00e9.parquet",
    ],
)  # fmt: skip
def test_a_name_that_no_published_run_has_is_refused(tiny_run, name):
    manifest = read_manifest(tiny_run)
    assert not is_allowed(name)
    forged = Manifest(manifest.program, {**manifest.files, name: File("0" * 64, 1)}, ())
    with pytest.raises(PorseError, match=r"refused: expected names of files that a published run may have at m, found"):
        parse_manifest(forged.render(), "m")


@pytest.mark.parametrize(
    ("name", "file", "message"),
    [
        ("results/x.parquet", File("0" * 64, 2**40), "a hash and a size of at most"),
        ("results/x.parquet", File("0" * 63, 1), "a hash and a size"),
        ("results/x.parquet", File("0" * 64, -1), "a hash and a size"),
        ("results/CURVES.parquet", File("0" * 64, 1), "names that differ in more than case"),
    ],
)
def test_sizes_are_bounded_and_names_differ(tiny_run, name, file, message):
    manifest = read_manifest(tiny_run)
    forged = Manifest(manifest.program, {**manifest.files, name: file}, ())
    with pytest.raises(PorseError, match=message):
        parse_manifest(forged.render(), "m")
    many = {f"results/a{number}.parquet": File("0" * 64, 60 * 2**20) for number in range(5)}
    with pytest.raises(PorseError, match="bytes together"):
        parse_manifest(Manifest(manifest.program, {**manifest.files, **many}, ()).render(), "m")


@pytest.mark.parametrize(
    ("program", "left_out"),
    [
        ({"porse": "\x1b[2J", "commit": ""}, ()),
        ({"porse": "1"}, ()),
        ({"porse": "1", "commit": "", "more": ""}, ()),
        ({"porse": "1", "commit": ""}, ("a\nb",)),
        ({"porse": "1", "commit": ""}, (3,)),
    ],
)
def test_words_that_a_terminal_would_read_otherwise_are_refused(tiny_run, program, left_out):
    forged = Manifest(program, read_manifest(tiny_run).files, left_out)
    with pytest.raises(PorseError, match=r"refused: expected (the version and|paths of)"):
        parse_manifest(forged.render(), "m")


@pytest.mark.parametrize("text", ["", "[" * 100_000, "{}", "null", '{"format": 2}', '{"format": 1, "files": {"a": 1}}'])
def test_a_manifest_that_is_none_is_refused(tiny_run, text):
    (tiny_run / "manifest.json").write_text(text)
    with pytest.raises(PorseError, match=r"manifest\.json"):
        read_manifest(tiny_run)


@pytest.mark.parametrize("kind", ["link", "folder link", "pipe", "dvc.yaml", "template"])
def test_links_devices_and_files_that_somebody_might_run_are_refused_before_they_are_read(tiny_run, tmp_path, kind):
    (tmp_path / "secret").mkdir()
    place = tiny_run / {"dvc.yaml": "dvc.yaml", "template": "iterations/dvc.yaml.jinja"}.get(kind, "results/x.parquet")
    if kind == "link":
        place.symlink_to("/etc/passwd")
    elif kind == "folder link":
        place.symlink_to(tmp_path / "secret")
    elif kind == "pipe":
        os.mkfifo(place)
    else:
        place.write_text("stages: {a: {cmd: touch stolen}}")
    with pytest.raises(PorseError, match=f"refused: .*{place.name}"):
        receive(str(tiny_run), tmp_path / "copy")
    assert not [path for path in (tmp_path / "copy").rglob("*") if path.is_file()]


def refusal(folder: Path, project: Path, **limits) -> str:
    """Returns the sentence with which a forged run is refused."""
    seal(folder)
    check_files(folder, read_manifest(folder))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        with pytest.raises(PorseError, match=r"refused|expected") as error:
            check_content(folder, False, **limits)
    return str(error.value)


def test_a_sound_run_passes_the_check_of_its_content(tiny_run, inside):
    check_content(tiny_run, False)


def test_figures_that_the_lock_does_not_name_are_refused(tiny_run, project):
    path = tiny_run / "metrics.json"
    path.write_text(path.read_text().replace('"mts": -', '"mts": '))
    assert "metrics.json, found something else" in refusal(tiny_run, project)


def test_a_lock_that_names_other_places_is_refused(tiny_run, project):
    path = tiny_run / "iterations" / "1" / "dvc.lock"
    original = path.read_text()
    for place in ("../../stolen", "/tmp/stolen", "porse/cli.py", "run/1/generate-2"):
        path.write_text(original.replace("path: run/1/generate\n", f"path: {place}\n"))
        # A place that other stages read is a circle, which is no one lock's.
        assert re.search(r"/dvc\.lock, found (something else|others|a circle)", refusal(tiny_run, project))


def test_an_edited_reply_is_refused(tiny_run, project):
    path = next((tiny_run / "llm_cache").glob("??/*.json"))
    path.write_text(path.read_text().replace("distance", "Distance"))
    found = refusal(tiny_run, project)
    assert path.name in found
    assert "payload hash" in found


def test_a_reply_that_the_tables_name_and_that_is_not_there_is_refused(tiny_run, project):
    path = next((tiny_run / "llm_cache").glob("??/*.json"))
    path.unlink()
    assert f"{path.name}: expected a record that the tables name, found none" in refusal(tiny_run, project)


@pytest.mark.parametrize("name", ["params.yaml", "inputs/summarise.json"])
def test_a_task_of_somebodys_own_is_not_imported_without_trust(tiny_run, project, tmp_path, name):
    """A module of that name lies where it would be found."""
    stolen = tmp_path / "stolen"
    module = project / "hostile_task.py"
    module.write_text(f"open({str(stolen)!r}, 'w')\nclass Task: EPISODE_LENGTH = NUM_OBSERVATIONS = NUM_ACTIONS = 1\n")
    try:
        path, lock = tiny_run / name, tiny_run / "dvc.lock"
        md5 = digest(path)
        path.write_text(re.sub(r'(task"?: "?)Quadcopter', r"\1hostile_task:Task", path.read_text()))
        lock.write_text(lock.read_text().replace(md5, digest(path)))
        found = refusal(tiny_run, project)
        assert ("found 'hostile_task:Task', which is its author's code" in found) is (name == "params.yaml")
        assert ("inputs, found another one" in found) is (name != "params.yaml")
    finally:
        module.unlink()
    assert not stolen.exists()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("params.yaml", "a: &a [x, x]\nb: &b [*a, *a]\n" + "".join(f"c{n}: &c{n} [*b, *b]\n" for n in range(9))),
        ("params.yaml", "[" * 50_000),
        ("inputs/fuse.json", "[" * 100_000),
        ("logs/environment.json", '{"cpu": {"a": 1}}'),
        ("run/result/start/policies/best.safetensors", "\x08"),
        ("run/result/start/winner.parquet", "PAR1"),
    ],
)
def test_texts_that_are_no_such_texts_are_refused_by_name(tiny_run, project, name, text):
    (tiny_run / name).write_text(text)
    assert name in refusal(tiny_run, project)


def test_a_policy_of_other_networks_is_refused(tiny_run, project):
    path = tiny_run / "run" / "result" / "start" / "policies" / "best.safetensors"
    arrays = dict(read_checkpoint(path).arrays)
    arrays["actor.mlp.0.weight"] = np.zeros((8, 398), np.float32)
    write_checkpoint(path, policy_checkpoint(arrays))
    found = refusal(tiny_run, project)
    assert (
        "expected a policy of Quadcopter with 21 observations, hidden layers of 8 and 12 actions, found 398 " in found
    )
    assert "best.safetensors" in found


@pytest.mark.parametrize(
    ("task", "hidden", "normalises"), [("Quadcopter", [8], True), ("Over", [16, 8, 4], True), ("Pen", [8, 8], False)]
)
def test_the_shapes_of_a_policy_are_those_of_a_drawn_one(task, hidden, normalises):
    train = {"hidden": hidden, "normalise_observations": normalises, "num_envs": 2}
    document = committed_params()
    params = parse_params({**document, "task": task, "train": document["train"] | train}, "here")
    assert policy_shapes(params) == {name: array.shape for name, array in random_policy(params, 1).arrays.items()}


TITLE = "\x1b]0;mine\x07\x9b2J\ntiny: 34 of 34 outputs identical"
UNSEEN = re.compile(r"[\x00-\x1f\x7f-\x9f]")


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("inputs/generate.json", "files"),
        ("inputs/generate.json", "parameters"),
        ("inputs/generate.json", "value"),
        ("logs/environment.json", "name"),
        ("logs/environment.json", "value"),
    ],
)
def test_names_and_values_that_a_terminal_would_obey_are_refused_by_the_files_name(tiny_run, project, name, place):
    path = tiny_run / name
    document = json.loads(path.read_text())
    if place == "files":
        document["files"][TITLE] = "0" * 64
    elif place == "parameters":
        document["parameters"]["x"] = {TITLE: 1}
    elif place == "value" and "parameters" in document:
        document["parameters"]["x"] = [TITLE]
    else:
        document |= {TITLE: "x"} if place == "name" else {"package torch": TITLE}
    path.write_text(json.dumps(document))
    found = refusal(tiny_run, project)
    assert f"without control characters at {tiny_run.parent}" in found
    assert name in found
    assert not UNSEEN.search(found)


@pytest.mark.parametrize("kind", ["table", "policy", "parameters"])
def test_no_error_about_a_forged_run_writes_to_the_terminal_more_than_its_signs(tiny_run, inside, tmp_path, kind):
    if kind == "table":
        pq.write_table(pa.table({TITLE: [1]}), tiny_run / "results" / "scores.parquet")
    elif kind == "policy":
        path = tiny_run / "run" / "result" / "start" / "policies" / "best.safetensors"
        with safe_open(path, "np") as file:
            said = file.metadata()
        save_file({f"actor.{TITLE}": np.full((3, 3), np.nan, np.float32)}, path, said)
    else:
        path = tiny_run / "params.yaml"
        path.write_text(path.read_text() + '"\\e]0;mine\\a\\N\\L34 of 34 outputs identical": 1\n')
    seal(tiny_run)
    done = porse("replay", str(tiny_run))
    assert done.exit_code == 1
    assert done.output.startswith("Error: ")
    assert done.output.count("\n") == 1
    assert not UNSEEN.search(done.output.rstrip("\n"))


def test_names_in_what_a_replay_says_are_each_on_its_line(params, tmp_path):
    (said,) = [line for line in causes(tmp_path, params, Changes((TITLE,), ())) if line.startswith("edited")]
    assert "\\u001b]0;mine\\u0007\\u009b2J\\u000atiny: 34 of 34" in said
    assert not UNSEEN.search(said)


def test_a_text_beyond_its_bound_is_refused_by_name_whatever_it_says(tiny_run, project):
    path = tiny_run / "presets" / "Quadcopter.yaml"
    path.write_text(f"{path.read_text()}\n{'#' * check.MOST_TEXT_BYTES}\n")
    assert f"expected at most {check.MOST_TEXT_BYTES} bytes at {path}" in refusal(tiny_run, project)


def test_a_table_that_unpacks_to_more_than_its_share_is_refused_by_name(tiny_run, project):
    """A mebibyte of one letter, four thousand times: 4 GiB of text in some kilobytes of Parquet."""
    path = tiny_run / "results" / "replies.parquet"
    schema = tables.REPLIES.schema
    rows = 4096
    columns = {
        field.name: pa.array(["a"] * rows) if field.type == pa.string() else pa.array([0] * rows).cast(field.type)
        for field in schema
    }
    columns["text"] = pa.DictionaryArray.from_arrays(pa.array([0] * rows, pa.int32()), pa.array(["x" * 2**20]))
    # Without Arrow's own schema, which would say dictionary: the column reads as the text that the declaration names.
    pq.write_table(pa.table(columns), path, compression="zstd", store_schema=False)
    assert path.stat().st_size < 2**17
    found = refusal(tiny_run, project, memory_mib=700)
    assert "a file that is read within 700 MiB" in found
    assert "results/replies.parquet" in found


# From elsewhere.


def test_a_run_comes_from_a_plain_server(project, tmp_path):
    with served(partial(Quiet, directory=str(project / "published"))) as address:
        manifest = receive(f"{address}/tiny/", tmp_path / "copy")
        check_files(tmp_path / "copy", manifest)
        with pytest.raises(PorseError, match="to answer with 200, found 404"):
            receive(f"{address}/tniy", tmp_path / "other")
    with pytest.raises(PorseError, match="found no answer"):
        receive(f"{address}/tiny", tmp_path / "third")
    assert manifest == read_manifest(project / "published" / "tiny")


@pytest.mark.parametrize("way", ["longer", "packed", "elsewhere", "short"])
def test_a_server_that_sends_something_else_is_refused_by_the_files_name(project, tmp_path, way):
    class Lying(BaseHTTPRequestHandler):
        def do_GET(self):
            data = (project / "published" / self.path.lstrip("/")).read_bytes()
            lies = self.path.endswith("card.md")
            self.send_response(302 if lies and way == "elsewhere" else 200)
            if lies and way == "elsewhere":
                self.send_header("Location", "file:///etc/passwd")
            if lies and way == "packed":
                self.send_header("Content-Encoding", "gzip")
            self.end_headers()
            self.wfile.write({"longer": data + b"x" * 2**22, "short": data[:-1]}.get(way, data) if lies else data)

        def log_message(self, *_):
            pass

    with served(Lying) as address, pytest.raises(PorseError, match=r"card\.md"):
        receive(f"{address}/tiny", tmp_path / "copy")
    assert not (tmp_path / "copy" / "card.md").exists() or (tmp_path / "copy" / "card.md").stat().st_size < 2**17


@pytest.mark.parametrize("way", ["headers", "continue", "body", "silence"])
def test_the_time_of_a_download_ends_whatever_it_waits_for(tmp_path, monkeypatch, way):
    monkeypatch.setattr(fetch, "SECONDS", 1)
    start, more = {
        "headers": (b"HTTP/1.1 200 OK\r\n", b"X-%d: y\r\n"),
        "continue": (b"", b"HTTP/1.1 100 Continue\r\nX: %d\r\n\r\n"),
        "body": (b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n", b"%d"),
        "silence": (b"", b""),
    }[way]

    class Trickling(BaseRequestHandler):
        def handle(self):
            self.request.recv(65536)
            self.request.sendall(start)
            with suppress(OSError):
                for number in range(200):
                    self.request.sendall(more and more % number)
                    time.sleep(0.1)

    began = time.monotonic()
    with served(Trickling) as address, pytest.raises(PorseError, match="a run that comes within 1 s at http"):
        receive(f"{address}/tiny", tmp_path / "copy")
    assert time.monotonic() - began < 8


@pytest.mark.parametrize("way", ["folder", "server"])
def test_a_reader_pulls_all_outputs_from_a_plain_folder_or_a_read_only_server(project, tmp_path, way):
    clone = tmp_path / "clone"
    clone.mkdir()
    git(clone, "init", "-q")
    dvc(clone, "init", "-q")
    for name in (".gitignore", ".dvc/config", "tiny/outputs.dvc"):
        (clone / "published" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(project / "published" / name, clone / "published" / name)
    remote = project.parent / "remote"
    with served(partial(Quiet, directory=str(remote))) as address:
        dvc(clone / "published", "remote", "add", "--local", "theirs", address if way == "server" else str(remote))
        dvc(clone / "published", "pull", "--remote", "theirs", "tiny/outputs.dvc")
    for stage in read_locks(project):
        for path, md5 in stage.outs.items():
            assert path.startswith("inputs/") or digest(clone / "published" / "tiny" / "outputs" / path) == md5
    # The project around it has nothing to do with it, and its own commands do not look there.
    git(clone, "add", "-A")
    assert "outputs/" not in git(clone, "ls-files")
    assert json.loads(dvc(clone, "status", "--json").stdout) == {}


# Computed again.


def test_stages_are_drawn_by_the_readers_seed(project):
    stages = read_locks(project)
    names = names_of(stages)
    assert len(names) == 13
    draws = [tuple(drawn(stages, 2, seed)) for seed in range(40)]
    assert drawn(stages, 2, 7) == drawn(stages, 2, 7)
    assert {name for draw in draws for name in draw} == {*names}
    assert all(names.index(one) < names.index(other) for one, other in draws)
    assert drawn(stages, 99, 1) == names


def test_a_whole_run_is_computed_again_to_the_same_bytes(inside, tmp_path):
    """In another process, as a user gives it; a shell that records, and a project whose own replies are gone, change nothing."""
    kept = inside / "llm_cache"
    kept.rename(inside / "hidden")
    try:
        kept.mkdir()
        shutil.copy(inside / "hidden" / "refreshed.txt", kept)
        done = subprocess.run(
            [BIN / "porse", "replay", "tiny", "--json", "--keep", tmp_path / "copy"],
            cwd=inside, env={**os.environ, **QUIET, "PORSE_LLM_MODE": "record"}, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        shutil.rmtree(kept)
        (inside / "hidden").rename(kept)
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout)
    # 13 stages leave an output each, and summarise two more.
    assert (found["outputs"], found["identical"], found["differ"]) == (15, 15, [])
    assert len(found["computed"]) == 13
    assert (found["changed_inputs"], found["first_difference"], found["failed"]) == ({}, None, None)
    assert (tmp_path / "copy" / "metrics.json").read_bytes() == (inside / "metrics.json").read_bytes()


def test_a_drawn_stage_takes_what_it_reads_from_where_it_is_and_computes_the_rest(inside, tmp_path):
    folder = find(Path(), "tiny")
    lines: list[str] = []
    cached = Shelf([(folder, "published/tiny")], inside / ".dvc" / "cache")
    found = replay(folder, Path(), tmp_path / "one", ["1/eliminate-1", "1/mutate"], cached, False, lines.append)
    assert found.is_identical
    assert (found.outputs, [stage.name for stage in found.plan.computed]) == (2, ["1/eliminate-1", "1/mutate"])
    assert found.plan.taken == {"run/1/start": "published/tiny", "run/1/train-1": "DVC's cache"}
    # Nobody has what validate-code read but for the start of the iteration.
    bare = Shelf([(folder, "published/tiny")], None)
    found = replay(folder, Path(), tmp_path / "two", ["1/validate-code"], bare, False, lines.append)
    assert found.is_identical
    assert [stage.name for stage in found.plan.computed] == ["1/generate", "1/validate-code"]
    assert found.plan.taken == {"run/1/start": "published/tiny"}
    assert "computed because they read its outputs, which nobody here has: 1/generate" in lines


def test_newer_code_is_named_also_where_the_outputs_are_the_same(inside, tmp_path):
    path = Path("porse/prompts.py")
    original = path.read_text()
    try:
        path.write_text(f"{original}# a word\n")
        done = porse("replay", "tiny", "--stages", "1/generate")
    finally:
        path.write_text(original)
    assert done.exit_code == 0, done.output
    assert "1 of 1 outputs identical, of 1 of 13 stages" in done.stdout
    assert (
        "inputs of generate are not those of the run: 1 files (porse/prompts.py); the outputs are the same all the same"
        in done.stdout
    )


def test_the_first_difference_comes_with_its_files_and_its_likely_cause(inside):
    path = Path("porse/identity.py")
    original = path.read_text()
    try:
        # Every draw of the run is another one.
        path.write_text(original.replace(">> 1", ">> 2"))
        done = porse("replay", "tiny", "--stages", "begin", "--json")
    finally:
        path.write_text(original)
    assert done.exit_code == 1
    found = json.loads(done.stdout)
    assert (found["outputs"], found["identical"], found["differ"]) == (1, 0, ["run/1/start"])
    first = found["first_difference"]
    assert (first["stage"], first["outputs"]) == ("begin", ["run/1/start"])
    assert "run/1/start/policies/random.safetensors" in first["files"]
    assert first["causes"][0] == "edited files: porse/identity.py are not what they were when the run was made"
    assert found["changed_inputs"]["begin"]["files"] == ["porse/identity.py"]


def test_a_question_that_has_changed_fails_by_the_stages_name_and_names_the_prompt(inside):
    originals = {each: each.read_text() for each in Path("prompts").glob("*.jinja")}
    try:
        for each, text in originals.items():
            each.write_text(f"Please. {text}")
        done = porse("replay", "tiny", "--stages", "1/generate")
    finally:
        for each, text in originals.items():
            each.write_text(text)
    assert done.exit_code == 1
    assert "failed: 1/generate: Expected" in done.stdout
    assert (
        "inputs of generate are not those of the run: 15 files (prompts/about.jinja, prompts/alpha-system.jinja, "
        "prompts/alpha-task.jinja, prompts/beta-system.jinja, prompts/beta-task.jinja and 10 more)"
    ) in done.stdout


def test_a_stage_that_is_none_is_a_sentence(inside):
    done = porse("replay", "tiny", "--stages", "1/muate")
    assert "expected stages of this run, found '1/muate'; its stages are begin, 1/generate" in done.output


def test_a_run_from_elsewhere_is_replayed_as_data(inside, tiny_run):
    done = porse("replay", str(tiny_run), "--stages", "1/generate", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["identical"] == 1


@pytest.mark.slow
def test_a_task_of_its_authors_own_is_replayed_elsewhere_with_trust_alone(inside, tmp_path):
    """Made in a project of `porse init`; the reader's project has neither the task nor its name in dvc.yaml."""
    theirs = tmp_path / "theirs"
    init_project(theirs)
    document = yaml.safe_load((theirs / "params.yaml").read_text())
    shape = tiny_params()
    document |= {name: shape[name] for name in ("rungs", "evaluate")} | {"iterations": [{"n": 1, "next": "result"}]}
    for name in ("generate", "train", "mutate", "fuse"):
        document[name] |= {key: shape[name][key] for key in document[name] if shape[name][key] is not None}
    (theirs / "params.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    environment = {**os.environ, **QUIET}
    for words in (["porse", "repro"], ["porse", "publish", ".", "cart"]):
        git(theirs, "add", "-A")
        git(theirs, "commit", "-qm", "a step")
        done = subprocess.run([BIN / words[0], *words[1:]], cwd=theirs, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    there = theirs / "published" / "cart"
    assert {"code/my_tasks/cart.py", "code/my_tasks/cart.xml", "presets/my_tasks.cart.CartPole.yaml"} <= {
        *read_manifest(there).files
    }
    done = porse("replay", str(there), "--stages", "begin")
    assert "found 'my_tasks.cart:CartPole', which is its author's code" in done.output
    assert not Path("my_tasks").exists()
    done = porse("replay", str(there), "--trust", "--json", "--stages", "1/validate-code")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert (found["identical"], found["outputs"], found["changed_inputs"]) == (2, 2, {})
    assert not Path("my_tasks").exists()


def test_without_a_name_it_is_the_smallest_and_where_none_is_published_nothing_is_to_be_done(
    inside, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    done = porse("replay")
    assert (done.exit_code, done.stdout) == (0, "no run is published in published/: nothing to replay\n")
    assert "no run is published" in porse("published").stdout
    assert json.loads(porse("published", "--json").stdout) == []


def test_the_smallest_run_is_replayed_and_stages_are_drawn_of_the_others(project, tmp_path):
    for name, epochs in (("b", 2), ("a", 1), ("c", 3)):
        shutil.copytree(project / "published" / "tiny", tmp_path / name)
        path = tmp_path / name / "params.yaml"
        path.write_text(path.read_text().replace("rung_epochs: 1\n", f"rung_epochs: {epochs}\n"))
    folders = sorted(tmp_path.iterdir())
    assert command.chosen(folders, None) == "a"
    assert {command.chosen(folders, seed) for seed in range(20)} == {"b", "c"}
    assert (command.chosen(folders[:1], 5), command.chosen([], 5)) == ("a", None)


# Why something differs.


def test_what_differs_between_inputs_is_named_by_file_and_by_parameter():
    then = Inputs({"seed": 1, "train": {"gamma": 0.9, "old": 1}}, {"a.py": "1", "b.py": "2", "c.py": "3"})
    now = Inputs({"seed": 1, "train": {"gamma": 0.8, "new": None}}, {"a.py": "1", "b.py": "4", "d.py": "3"})
    assert changes(then, now) == Changes(("b.py", "c.py", "d.py"), ("train.gamma", "train.new", "train.old"))
    assert not changes(then, then)


def test_causes_come_in_their_order_and_say_when_there_is_none_on_record(inside, monkeypatch, tmp_path, params):
    here = {"cpu": "A", "machine": "x86_64", "python": "3.11.7", "package torch": "2.13.0", "MKL_CBWR": "COMPATIBLE"}
    monkeypatch.setattr("porse.numerics.manifest", lambda: here)
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    (tmp_path / "logs").mkdir()

    def found(*changed, **then):
        record = {**here, **{name.replace("_", " "): value for name, value in then.items()}}
        (tmp_path / "logs" / "environment.json").write_text(json.dumps(record))
        change = changed[0] if changed else Changes((), ())
        return [sentence.partition(":")[0] for sentence in causes(tmp_path, params, change)]

    assert found() == ["none on record"]
    assert found(cpu="B") == ["instruction set"]
    assert found(Changes(("a.py",), ("seed",)), cpu="B", package_torch="2.12.0") == [
        "edited files", "other parameters", "versions", "instruction set",
    ]  # fmt: skip
    (tmp_path / "logs" / "environment.json").unlink()
    assert [sentence.partition(":")[0] for sentence in causes(tmp_path, params, Changes((), ()))] == ["unknown"]
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert causes(tmp_path, params, Changes((), ()))[0].startswith("instruction set: this is a aarch64")


def test_the_digest_of_an_output_is_dvcs_own(project):
    for stage in read_locks(project):
        for path, md5 in stage.outs.items():
            assert digest(project / path) == md5


def test_an_output_that_dvcs_cache_holds_damaged_is_not_taken(project, tmp_path):
    cache = tmp_path / "cache"
    shutil.copytree(project / ".dvc" / "cache", cache)
    md5 = next(stage.outs["evaluation"] for stage in read_locks(project) if stage.name == "evaluate")
    shelf = Shelf([], cache)
    assert shelf.fetch("evaluation", md5, tmp_path / "one") == "DVC's cache"
    file = project / "evaluation" / "seeds.parquet"
    of_file = hashlib.md5(file.read_bytes(), usedforsecurity=False).hexdigest()
    stored = cache / "files" / "md5" / of_file[:2] / of_file[2:]
    stored.chmod(0o644)
    stored.write_bytes(stored.read_bytes()[:-1] + b"x")
    assert shelf.fetch("evaluation", md5, tmp_path / "two") == ""
    assert not (tmp_path / "two").exists()


def test_the_check_takes_its_limits_upon_itself(tiny_run, inside):
    code = "import resource, sys; from porse.published import check; sys.argv = ['x']; check.main(__import__('pathlib').Path('none'), False, 512); print(resource.getrlimit(resource.RLIMIT_FSIZE)[0], resource.getrlimit(resource.RLIMIT_CPU)[0])"
    done = subprocess.run([sys.executable, "-c", code], cwd=inside, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == f"0 {check.SECONDS}"
