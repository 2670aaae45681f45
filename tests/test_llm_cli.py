"""`porse llm` as people use it."""

import dataclasses
import json
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import click
import pyarrow
import pyarrow.parquet
import pytest
from click.testing import CliRunner, Result

from porse.cli import main
from porse.errors import RepliesPending
from porse.functions import contract
from porse.llm.ask import ask
from porse.llm.record import Record
from porse.llm.request import Message, Origin
from porse.llm.sampling import MOST_CHARACTERS
from porse.llm.store import Store
from porse.llm_estimate import llm
from tests.llm_cases import RECORD, new_store, params, questions, record, request
from tests.llm_server import ChatServer, failing, replying

KEYS = [request(sample=k).key for k in range(3)]
WHO = ["--answered-by", "me", "--context", "fresh"]
ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "llm-cache.md"


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PORSE_LLM_MODE", "batch")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    new_store(tmp_path)
    return Store(Path("llm_cache"))


@pytest.fixture
def server() -> Iterator[ChatServer]:
    with ChatServer() as server:
        yield server


def run(*arguments: str, code: int = 0) -> Result:
    result = CliRunner().invoke(main, ["llm", *arguments])
    assert result.exit_code == code, result.output
    return result


def error(*arguments: str) -> str:
    """Returns the one paragraph with which a command fails."""
    text = run(*arguments, code=1).stderr
    assert text.startswith("Error: ")
    assert text.count("\n") == 1
    return text


def ask_in_batch(store: Store, count: int = 3) -> None:
    with pytest.raises(RepliesPending):
        ask(questions(count), params(), store.cache_dir)


def test_every_command_has_help_and_is_documented() -> None:
    text = DOCUMENT.read_text("utf-8")
    for name, command in llm.commands.items():
        assert command.help
        assert f"`porse llm {name}" in text
        assert "--cache" in [option for parameter in command.params for option in parameter.opts]
        for parameter in command.params:
            assert isinstance(parameter, click.Argument) or parameter.help, f"{name} {parameter.name}"  # type: ignore[attr-defined]


def test_offline_from_export_to_replay(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    ask_in_batch(store)
    assert [line.split()[0] for line in run("pending").stdout.splitlines()] == KEYS
    run("export", "requests.jsonl", "--prompts", "prompts")
    exported = [json.loads(line) for line in Path("requests.jsonl").read_text("utf-8").splitlines()]
    answers = [{"custom_id": line["custom_id"], "text": f"answer to {line['custom_id'][:4]}"} for line in exported]
    Path("answers.jsonl").write_text("".join(json.dumps(answer) + "\n" for answer in answers))
    assert "Fly to the target." in Path("prompts", f"{KEYS[0]}.prompt").read_text("utf-8")
    who = ["--answered-by", "a language model, offline", "--context", "fresh"]
    report = run("import", "answers.jsonl", *who).stdout.splitlines()
    assert report[0] == f"{KEYS[0]}  generate, iteration 1, reward 1: recorded, 14 characters"
    assert len(report) == 3
    assert run("pending").stdout == ""
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    replies = ask(questions(3), params(), store.cache_dir)
    assert [reply.text for reply in replies] == [f"answer to {key[:4]}" for key in KEYS]
    said = "a language model, offline, through batch mode, one fresh context per reply; not an API model"
    assert {reply.answered_by for reply in replies} == {said}
    assert said in run("stats").stdout
    run("verify")


def test_export_to_standard_output(store: Store) -> None:
    ask_in_batch(store)
    result = run("export")
    assert [json.loads(line)["custom_id"] for line in result.stdout.splitlines()] == KEYS
    assert result.stderr == "3 open requests\n"


def test_pending_is_forgotten_on_request(store: Store) -> None:
    ask_in_batch(store)
    run("pending", "--clear")
    assert run("pending").stdout == ""


def test_import_of_wrong_answers_writes_nothing(store: Store) -> None:
    ask_in_batch(store)
    Path("answers.jsonl").write_text(json.dumps({"custom_id": KEYS[0], "text": "a"}) + "\n{}\n")
    assert "line 2: expected an object with a custom_id" in error("import", "answers.jsonl", *WHO)
    assert list(store.all_keys()) == []


def test_import_needs_to_know_who_answered(store: Store) -> None:
    Path("answers.jsonl").write_text("")
    assert "--answered-by" in run("import", "answers.jsonl", "--context", "fresh", code=2).stderr
    assert "--context" in run("import", "answers.jsonl", "--answered-by", "me", code=2).stderr


def test_verify_accepts_what_the_program_writes(store: Store) -> None:
    store.write_all([record(sample=k) for k in range(3)])
    store.supersede(record("new", sample=1))
    (store.cache_dir / "README.md").write_text("# Recorded replies\n")
    assert run("verify").stdout == "3 records, all as they were written\n"


def git(*arguments: str, cwd: Path) -> None:
    identity = [
        "-c",
        "user.name=a",
        "-c",
        "user.email=a@b.c",
        "-c",
        "commit.gpgsign=false",
        "-c",
        "init.defaultBranch=main",
    ]
    subprocess.run(["git", *identity, *arguments], cwd=cwd, check=True, capture_output=True)


@pytest.mark.parametrize("attributes", [True, False])
def test_verify_accepts_a_clone_that_translates_line_ends(tmp_path: Path, attributes: bool) -> None:
    origin, clone = tmp_path / "origin", tmp_path / "clone"
    shutil.copytree(ROOT / "llm_cache", origin / "llm_cache")
    Store(origin / "llm_cache").write(record("line\r\nanother\rand\n"))
    if attributes:
        shutil.copy(ROOT / ".gitattributes", origin)
    git("init", cwd=origin)
    git("add", "--all", ":!.porse", cwd=origin)
    git("commit", "--message", "replies", cwd=origin)
    git("clone", "--config", "core.autocrlf=true", str(origin), str(clone), cwd=tmp_path)
    result = run("verify", "--cache", str(clone / "llm_cache"), code=0 if attributes else 1)
    expected = "records, all as they were written" if attributes else "another layout"
    assert expected in result.stdout


def spoil(store: Store, how: str) -> None:
    """Damages the record of RECORD, or puts something beside it."""
    path = store.path(RECORD.key)
    data = path.read_bytes()
    match how:
        case "edited":
            path.write_bytes(data.replace(b"return 1", b"return 2"))
        case "truncated":
            path.write_bytes(data[:-100])
        case "empty":
            path.write_bytes(b"")
        case "renamed":
            path.rename(path.with_name(f"{path.name[:2]}{'0' * 62}.json"))
        case "in the wrong directory":
            (store.cache_dir / "00").mkdir(exist_ok=True)
            path.rename(store.cache_dir / "00" / path.name)
        case "in no directory":
            path.rename(store.cache_dir / path.name)
        case "laid out differently":
            path.write_bytes(json.dumps(json.loads(data)).encode())
        case "with other line ends":
            path.write_bytes(data.replace(b"\n", b"\r\n"))
        case "with a field twice":
            path.write_bytes(data.replace(b'"format": 1,', b'"format": 1, "format": 1,'))
        case "a foreign file":
            path.with_name("notes.txt").write_text("notes")
        case "a link":
            path.rename(store.cache_dir.parent / "elsewhere")
            path.symlink_to(store.cache_dir.parent / "elsewhere")
        case "an old record of another key":
            path.with_name(f"{'1' * 64}.1.json").write_bytes(data)
        case _:
            raise AssertionError(how)


@pytest.mark.parametrize(
    ("how", "found"),
    [
        ("edited", "edited"),
        ("truncated", "do not parse"),
        ("empty", "do not parse"),
        ("renamed", "misnamed"),
        ("in the wrong directory", "misplaced"),
        ("in no directory", "misplaced"),
        ("laid out differently", "another layout"),
        ("with other line ends", "another layout"),
        ("with a field twice", "another layout"),
        ("a foreign file", "another file"),
        ("a link", "another file"),
        ("an old record of another key", "misplaced"),
    ],
)
def test_verify_finds(store: Store, how: str, found: str) -> None:
    store.write(RECORD)
    spoil(store, how)
    result = run("verify", code=1)
    assert found in result.stdout
    assert "Error: 1 problems in llm_cache" in result.stderr


@pytest.mark.parametrize(
    "secret",
    [
        "sk-" + "a1" * 16,
        "sk-proj-" + "a1_-" * 12,
        "Authorization: Bearer " + "abc123" * 5,
        "AKIA" + "ABCD1234" * 2,
        "ghp_" + "aB3" * 12,
        "hf_" + "aB3" * 11,
        "AIza" + "aB3-_" * 7,
        "-----BEGIN RSA PRIVATE KEY-----",
    ],
)
def test_verify_finds_secrets_without_repeating_them(store: Store, secret: str) -> None:
    store.write(record(f"my key is {secret}, keep it"))
    result = run("verify", code=1)
    assert "expected no secrets, found a" in result.stdout
    assert secret not in result.output


def test_verify_finds_secrets_in_other_files(store: Store) -> None:
    (store.cache_dir / "notes.txt").write_text("sk-" + "a1" * 16)
    assert "notes.txt: expected no secrets, found an OpenAI-style API key" in run("verify", code=1).stdout


def test_verify_takes_no_ordinary_text_for_a_secret(store: Store) -> None:
    store.write(record("risk-" + "a" * 40 + " task-aware-" + "b" * 30 + f" {'0f' * 32} bearer of news"))
    run("verify")


def test_verify_compares_with_the_tables(store: Store) -> None:
    store.write_all([record(sample=0), record("cut", "length", sample=1), record(sample=1, max_tokens=200)])
    store.write(record(sample=2))
    used = [request(sample=0).key, request(sample=1, max_tokens=200).key, "f" * 64]
    pyarrow.parquet.write_table(pyarrow.table({"key": used[:2], "text": ["a", "b"]}), "one.parquet")
    pyarrow.parquet.write_table(pyarrow.table({"key": used[2:]}), "two.parquet")
    result = run("verify", "--used", "one.parquet", "--used", "two.parquet", code=1)
    assert result.stdout.splitlines() == [
        f"{'f' * 64}.json: expected a record that the tables name, found none",
        f"{KEYS[2]}.json: expected a record that some table names, found it unused (generate, iteration 2, reward 3)",
    ]


@pytest.mark.parametrize("content", ["no parquet", None])
def test_verify_names_a_table_that_it_cannot_read(store: Store, content: str | None) -> None:
    store.write(RECORD)
    if content is None:
        pyarrow.parquet.write_table(pyarrow.table({"other": ["a"]}), "table.parquet")
    else:
        Path("table.parquet").write_text(content)
    assert "Expected a Parquet table with a column `key` in table.parquet" in error("verify", "--used", "table.parquet")


def test_verify_needs_a_directory(store: Store) -> None:
    assert "found none. Pass it by `--cache`" in error("verify", "--cache", "nowhere")


def test_stats_by_iteration_stage_and_model(store: Store) -> None:
    store.write_all([record(sample=0), record("cut", "length", sample=1), record(sample=1, max_tokens=200)])
    lines = [line.split() for line in run("stats").stdout.splitlines()]
    # Three replies of 1000 + 200 tokens at 2 and 10 USD per million.
    assert lines[1] == ["2", "generate", "3", "1", "3000", "600", "0.012000"]
    assert lines[4][:2] == ["test-model", "test-model-2026-01-01"]
    assert " ".join(lines[-2]) == "recorded: 3 replies, 0.012000 USD"
    assert " ".join(lines[-1]) == "spent by this checkout: 0 replies, 0.000000 USD"


def test_stats_say_how_different_the_samples_of_a_question_are(store: Store) -> None:
    code = "```python\ndef f(x):\n    near = x\n    return near, {}\n```"
    same = "Another text.\n```python\ndef f(x):\n    # nearer\n    close = x\n    return (close, {})\n```"
    other = "```python\ndef f(x):\n    return -x, {}\n```"
    for sample, text in enumerate([code, code, same, other]):
        store.write(record(text, sample=sample))
    others = [record(text, messages=(Message("user", "b"),), sample=k) for k, text in enumerate("xy")]
    store.write_all(others)
    store.write(record("alone", messages=(Message("user", "c"),)))
    lines = run("stats").stdout.splitlines()
    where = ["2", "generate", "reward", "3"]
    start = next(index for index, line in enumerate(lines) if "different functions" in line)
    # Four samples: two equal ones, one that differs in words, a comment, brackets and a name, and one that differs.
    rows = [line.split() for line in lines[start + 1 : start + 3]]
    assert sorted([*row[:4], *row[5:]] for row in rows) == [
        [*where, "2", "2", "2"],
        [*where, "4", "3", "2"],
    ]
    # The key of the first sample tells questions apart that were asked in the same place.
    assert {row[4] for row in rows} == {first.key[:12] for first in (record(code), others[0])}
    assert lines[start + 3] == "6 samples of 2 questions hold 4 different functions"


def test_of_a_reply_that_was_cut_off_the_longer_one_is_the_sample(store: Store) -> None:
    store.write_all([record("same"), record("cut", "length", sample=1), record("same", sample=1, max_tokens=200)])
    assert "2 samples of 1 questions hold 1 different functions" in run("stats").stdout


def test_stats_of_an_empty_cache(store: Store) -> None:
    assert "recorded: 0 replies" in run("stats").stdout
    assert "found none" in run("stats", "--cache", "nowhere", code=1).output


def test_stats_lists_keys(store: Store) -> None:
    store.write(RECORD)
    assert run("stats", "--list").stdout == f"{RECORD.key}  generate, iteration 2, reward 3\n"


def test_show_prints_a_conversation(store: Store) -> None:
    store.write(RECORD)
    text = run("show", RECORD.key[:10]).stdout
    assert "--- system ---\nYou write rewards.\nTorch only.\n\n--- user ---\nFly to the target.\n" in text
    assert "--- reply by test-model-2026-01-01 ---" in text
    assert "1000 + 200 tokens, 0.004000 USD" in text
    assert text.endswith("def reward():\n    return 1\n\n")


def test_show_prints_what_was_asked(store: Store) -> None:
    plain = record(sample=3)
    dialect = record(top_p=None, limit="max_completion_tokens", extra={"reasoning_effort": "low", "n_predict": None})
    store.write_all([plain, dialect])
    assert "model test-model, temperature 0.5, top_p 0.9, max_tokens 100, sample 3\n" in run("show", plain.key).stdout
    asked = 'temperature 0.5, max_completion_tokens 100, sample 0, n_predict null, reasoning_effort "low"\n'
    assert asked in run("show", dialect.key).stdout


def test_show_prints_an_open_request(store: Store) -> None:
    ask_in_batch(store, 1)
    assert "(waits for an answer)" in run("show", KEYS[0][:10]).stdout


def test_show_of_an_unknown_key(store: Store) -> None:
    assert "found none" in error("show", "abc")


TITLE = "\x1b]0;mine\x07"
CLIPBOARD = "\x1b]52;c;bHM=\x07\x9b2J"


def test_no_record_writes_to_the_terminal_more_than_its_signs(store: Store) -> None:
    """Every text that a stranger's record holds: a title, a clipboard, and a line that looks like one of ours."""
    forged = f"m{TITLE}\nrecorded: 0 replies"
    origin = Origin(f"s{CLIPBOARD}\n{'0' * 64}  generate", 1, f"x{TITLE}")
    answer = dataclasses.replace(RECORD.answer, text=f"text{CLIPBOARD}\n\tdef f(): pass\r\x85")
    provenance = dataclasses.replace(
        RECORD.provenance, answered_by=forged, profile=forged, recorded_at=forged, origin=origin
    )
    records = [
        Record(request(model=forged, sample=k, extra={f"a{TITLE}\nb": TITLE}), answer, provenance) for k in range(2)
    ]
    store.write_all(records)
    (store.cache_dir / f"a{TITLE}\nb").touch()
    key, other = (item.key for item in records)
    for words in (["show", key], ["stats"], ["stats", "--list"], ["stats", "--json"], ["diff", key, other]):
        shown = run(*words).output
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", shown), words
    shown = run("show", key).stdout
    assert "--- reply by m\\u001b]0;mine\\u0007\\u000arecorded: 0 replies ---\n" in shown
    assert "text\\u001b]52;c;bHM=\\u0007\\u009b2J\n\tdef f(): pass\\u000d\\u0085\n" in shown
    assert [line[:64] for line in run("stats", "--list").stdout.splitlines()] == sorted([key, other])
    assert [line for line in run("stats").stdout.splitlines() if line.startswith("recorded:")] == [
        "recorded: 2 replies, 0.008000 USD"
    ]
    found = run("verify", code=1)
    assert found.stdout.startswith("a\\u001b]0;mine\\u0007\\u000ab: expected only record files")
    assert found.stdout.count("\n") == 1


def test_what_goes_out_to_be_answered_writes_nothing_to_a_terminal_and_means_the_same(store: Store) -> None:
    with pytest.raises(RepliesPending):
        ask(questions(1, messages=(Message("user", f"a{CLIPBOARD}\U000e0041字"),)), params(), store.cache_dir)
    line = run("export").stdout
    assert line.isascii()
    assert json.loads(line)["body"]["messages"][0]["content"] == f"a{CLIPBOARD}\U000e0041字"


@pytest.mark.parametrize("unit", ["a;", "f()();"])
def test_a_reply_beyond_the_contract_is_compared_word_by_word_and_takes_no_time(store: Store, unit: str) -> None:
    assert MOST_CHARACTERS == contract.MAX_REPLY_CHARACTERS
    long = unit * (1_800_000 // len(unit)) + "1"
    store.write_all([record(long), record(f" {long}", sample=1), record(f"{long} 2", sample=2)])
    started = time.monotonic()
    assert "3 samples of 1 questions hold 2 different functions" in run("stats").stdout
    assert time.monotonic() - started < 10


def test_diff_of_two_conversations(store: Store) -> None:
    store.write_all([record("one\ntwo", sample=0), record("one\n2", sample=1)])
    lines = run("diff", KEYS[0], KEYS[1]).stdout.splitlines()
    assert "-two" in lines
    assert "+2" in lines
    assert "-one" not in lines
    assert run("diff", KEYS[0], KEYS[0]).stdout == ""


def test_refresh_from_a_text(store: Store) -> None:
    store.write(record("old"))
    Path("answer.txt").write_text("new\n")
    output = run("refresh", KEYS[0][:12], "--answer", "answer.txt", *WHO).stdout
    assert f"the old record is llm_cache/{KEYS[0][:2]}/{KEYS[0]}.1.json" in output
    found = store.read(KEYS[0])
    assert found is not None
    assert (found.answer.text, found.provenance.mode) == ("new", "refresh")
    assert found.provenance.answered_by == "me, through a text, one fresh context per reply; not an API model"
    assert "old" in store.path(KEYS[0]).with_name(f"{KEYS[0]}.1.json").read_text("utf-8")
    run("verify")


@pytest.mark.parametrize("content", [b"", b" \n", b"\xff"])
def test_refresh_from_a_text_refuses_what_is_no_text(store: Store, content: bytes) -> None:
    store.write(record("old"))
    Path("answer.txt").write_bytes(content)
    error("refresh", KEYS[0], "--answer", "answer.txt", *WHO)
    assert store.read(KEYS[0]) == record("old")


def test_refresh_from_a_text_needs_to_know_who_answered(store: Store) -> None:
    store.write(record("old"))
    Path("answer.txt").write_text("new")
    for half in ([], WHO[:2], WHO[2:]):
        assert "--answered-by" in run("refresh", KEYS[0], "--answer", "answer.txt", *half, code=2).stderr


def test_refresh_of_an_unknown_key(store: Store) -> None:
    assert "found none" in error("refresh", "abc")


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch, server: ChatServer) -> ChatServer:
    """Lets `refresh` read an llm section whose profile is the server's."""
    monkeypatch.setattr("porse.llm.cli.load_params", lambda path: SimpleNamespace(llm=params(server.url)))
    return server


def test_refresh_from_the_endpoint(store: Store, shipped: ChatServer) -> None:
    store.write(record("old"))
    run("refresh", KEYS[0])
    found = store.read(KEYS[0])
    assert found is not None
    assert (found.answer.text, found.provenance.mode) == ("reply to Fly to the target.", "refresh")
    assert "spent by this checkout: 1 replies" in run("stats").stdout


@pytest.mark.parametrize("misbehaviour", [failing(400), replying("")])
def test_failed_refresh_changes_nothing(store: Store, shipped: ChatServer, misbehaviour: object) -> None:
    store.write(record("old"))
    shipped.script = [misbehaviour]  # type: ignore[list-item]
    error("refresh", KEYS[0])
    assert store.read(KEYS[0]) == record("old")
    assert len(list(store.cache_dir.rglob("*.json"))) == 1


def test_refresh_needs_a_profile_of_the_same_model(store: Store, shipped: ChatServer) -> None:
    store.write(record("old", model="other-model"))
    assert "--profile NAME" in error("refresh", request(model="other-model").key)
    assert "--profile to be one of local, found 'x'" in error(
        "refresh", request(model="other-model").key, "--profile", "x"
    )
    assert shipped.requests == []


def test_the_committed_replies_say_what_composed_them() -> None:
    store = Store(ROOT / "llm_cache")
    records = [record for key in store.all_keys() if (record := store.read(key)) is not None]
    # The default run has 57; the other runs of suites/methods.yaml have 94 more on Quadcopter, 169 on
    # FrankaCabinet, 147 on DoorOpenOutward and 123 on PushBlock, with those of ROSKA's former short trainings.
    assert len(records) == 57 + 94 + 169 + 147 + 123
    assert {(item.request.model, item.provenance.profile, item.provenance.mode) for item in records} == {
        ("offline", "offline", "batch")
    }
    assert {item.provenance.answered_by for item in records} == {
        "a language model, offline, through batch mode, one fresh context per reply; not an API model"
    }
