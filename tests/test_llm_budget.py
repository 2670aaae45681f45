"""Budgets end a recording before they are passed, whatever goes wrong and however many ask at once."""

import contextlib
import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from porse.errors import CacheError, ProviderError
from porse.llm import provider
from porse.llm.ask import ask
from porse.llm.ledger import Spending, Totals, ledger_path, most_tokens, totals
from porse.llm.request import Message
from porse.llm.store import Store
from tests.llm_cases import new_store, params, questions, request
from tests.llm_server import Behaviour, ChatServer, failing, replying, slow_headers

ROOT = Path(__file__).parents[1]

MOST_USD = (80 * 2.0 + 100 * 10.0) / 1e6
"""The most that one of the questions can cost: 30 + 18 bytes and twice 16 tokens around them, and 100 tokens of reply."""

REPLY_USD = (50 * 2.0 + 20 * 10.0) / 1e6
"""What a reply of `CHEAP` costs."""

CHEAP = replying("text", usage={"prompt_tokens": 50, "completion_tokens": 20})


@pytest.fixture
def server() -> Iterator[ChatServer]:
    with ChatServer() as server:
        server.script = [CHEAP] * 100
        yield server


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return new_store(tmp_path)


@pytest.fixture(autouse=True)
def recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PORSE_LLM_MODE", "record")
    monkeypatch.setenv("PORSE_LLM_ATTEMPTS", "3")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("PORSE_LLM_BASE_URL", raising=False)
    monkeypatch.setattr(provider, "FIRST_DELAY_S", 0.01)


def stopped(server: ChatServer, store: Store, count: int, **budget: float) -> str:
    """Returns the message with which a recording of so many questions ends."""
    with pytest.raises(ProviderError) as caught:
        ask(questions(count), params(server.url, **budget), store.cache_dir)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def recorded(store: Store) -> int:
    return len(list(store.all_keys()))


def test_the_most_that_a_prompt_can_hold_is_a_token_for_each_byte() -> None:
    assert most_tokens(request()) == 30 + 16 + 18 + 16
    assert most_tokens(request(messages=(Message("user", "Größe"),))) == 7 + 16


def test_a_number_of_requests_is_not_passed(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    message = stopped(server, store, 5, max_requests=3)
    assert "found 2 failures" in message
    assert "llm.max_requests of params.yaml is 3, and 3 requests are sent" in message
    assert "All other replies are recorded" in message
    assert (len(server.requests), recorded(store)) == (3, 3)
    stopped(server, store, 5, max_requests=3)
    assert len(server.requests) == 3, "the same command again has no budget of its own"
    assert len(ask(questions(5), params(server.url, max_requests=5), store.cache_dir)) == 5
    assert len(server.requests) == 5


def test_a_sum_is_not_passed(server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    # Beside one question under way, no second one fits. After n replies 0.0003 n are spent, and one more may cost 0.00116:
    # the fourth would fit into 0.00206 and not into 0.0020.
    server.delay_s = 0.02
    message = stopped(server, store, 6, max_usd=0.0020)
    assert "llm.max_usd of params.yaml is 0.002, 0.000900 USD are spent" in message
    assert "one more request costs up to 0.001160" in message
    assert (len(server.requests), recorded(store), server.most_busy) == (3, 3, 1)
    assert totals(store) == Totals(Spending(3, 150, 60, pytest.approx(3 * REPLY_USD)), 3, {})
    stopped(server, store, 6, max_usd=0.0021)
    assert recorded(store) == 4
    assert len(ask(questions(6), params(server.url), store.cache_dir)) == 6


def test_a_budget_with_room_lets_requests_run_side_by_side(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.delay_s = 0.05
    assert len(ask(questions(12), params(server.url, max_usd=1.0, max_requests=12), store.cache_dir)) == 12
    assert server.most_busy == 4


def test_a_longer_reply_is_part_of_the_budget(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.script = [replying("cut", "length")]
    assert "llm.max_requests" in stopped(server, store, 1, max_requests=1)
    assert [sent["body"]["max_tokens"] for sent in server.requests] == [100]
    assert recorded(store) == 1, "what is paid for is kept"


def test_attempts_that_fail_are_requests_and_cost_nothing(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.script = [failing(500)] * 3
    assert "llm.max_requests of params.yaml is 2" in stopped(server, store, 1, max_requests=2)
    assert len(server.requests) == 2
    assert totals(store) == Totals(Spending(0, 0, 0, 0.0), 2, {})


@pytest.mark.parametrize("unusable", [replying("text", model="other-model"), replying("part", "content_filter")])
def test_a_reply_that_cannot_be_used_is_paid_for(server: ChatServer, store: Store, unusable: Behaviour) -> None:
    server.script = [unusable]
    stopped(server, store, 1)
    # 100 + 10 tokens, as the server counts by itself.
    assert totals(store) == Totals(Spending(1, 100, 10, pytest.approx(300e-6)), 1, {})


def test_a_reply_without_counts_counts_with_the_most_it_can_have_cost(server: ChatServer, store: Store) -> None:
    server.script = [replying("text", usage=None), replying("text", usage={"prompt_tokens": 2**70})]
    ask(questions(2), params(server.url), store.cache_dir)
    assert totals(store).spending.cost_usd == pytest.approx(2 * MOST_USD)


def test_a_request_that_was_never_answered_may_have_been_paid_for(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PORSE_LLM_TIMEOUT_S", "0.3")
    server.script = [slow_headers]
    assert "0.001160 may have been" in stopped(server, store, 1, max_usd=0.0020)
    assert len(server.requests) == 1
    assert list(totals(store).reserved.values()) == [pytest.approx(MOST_USD)]


def test_a_request_that_was_never_sent_costs_nothing(store: Store) -> None:
    with pytest.raises(ProviderError, match="3 attempts failed"):
        ask(questions(1), params("http://127.0.0.1:9/v1"), store.cache_dir)
    assert totals(store) == Totals(Spending(0, 0, 0, 0.0), 3, {})


def test_a_budget_changes_nothing_where_nothing_is_asked(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    replies = ask(questions(3), params(server.url), store.cache_dir)
    nothing = params(server.url, max_usd=0.0, max_requests=0)
    assert ask(questions(3), nothing, store.cache_dir) == replies
    monkeypatch.setenv("PORSE_LLM_MODE", "frozen")
    assert ask(questions(3), nothing, store.cache_dir) == replies


def test_a_ledger_of_an_earlier_version_and_a_line_that_was_cut_off_are_read(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = {"replies": 1, "prompt_tokens": 7, "completion_tokens": 5, "cost_usd": 0.5}
    ledger_path(store).parent.mkdir(exist_ok=True)
    ledger_path(store).write_text(f'{json.dumps(old)}\n{{"request": "a", "reserved_u')
    ask(questions(1), params(server.url), store.cache_dir)
    assert totals(store) == Totals(Spending(2, 57, 25, pytest.approx(0.5 + REPLY_USD)), 2, {})
    assert "llm.max_usd of params.yaml is 0.5" in stopped(server, store, 2, max_usd=0.5)


ASK = """
import sys
from pathlib import Path
from porse.errors import ProviderError
from porse.llm.ask import ask
from tests.llm_cases import params, questions

first = int(sys.argv[3])
try:
    ask(questions(first + 10)[first:], params(sys.argv[1], max_requests=13), Path(sys.argv[2]))
except ProviderError as error:
    sys.exit(str(error))
"""


def test_processes_side_by_side_do_not_pass_a_budget_together(
    server: ChatServer, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.delay_s = 0.02
    start = [sys.executable, "-c", ASK, server.url, str(store.cache_dir)]
    both = [subprocess.Popen([*start, first], cwd=ROOT, stderr=subprocess.PIPE, text=True) for first in ("0", "10")]
    errors = [process.communicate()[1] for process in both]
    assert any("llm.max_requests of params.yaml is 13, and 13 requests are sent" in error for error in errors)
    assert len(server.requests) == 13
    assert recorded(store) == 13
    assert totals(store).requests == 13


FULL = 4 * 2**20
"""No file may grow beyond this, as none can on a disk that is full."""


@contextlib.contextmanager
def full_disk() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(store: Store, room: int) -> None:
    """Leaves a ledger so much room."""
    ledger_path(store).parent.mkdir(parents=True, exist_ok=True)
    ledger_path(store).write_bytes(b"x" * (FULL - room - 1) + b"\n")


def test_a_paid_reply_is_kept_where_the_ledger_has_no_room_for_its_cost(
    server: ChatServer, store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    # The line before the request fits, the line after it does not.
    fill(store, 120)
    with full_disk():
        (reply,) = ask(questions(1), params(server.url), store.cache_dir)
    assert reply.text == "text"
    assert (len(server.requests), recorded(store)) == (1, 1)
    (said,) = caplog.messages
    assert f"Expected to write the ledger {ledger_path(store)}, found: [Errno" in said
    assert said.endswith("What was reserved for the request counts as spent.")
    found = totals(store)
    assert (found.requests, found.spending, found.usd) == (1, Spending(0, 0, 0, 0.0), pytest.approx(MOST_USD))
    # With room again, a line that was cut off is no part of the next one.
    ask(questions(2), params(server.url), store.cache_dir)
    assert (totals(store).requests, totals(store).usd) == (2, pytest.approx(MOST_USD + REPLY_USD))


def test_nothing_is_sent_where_the_ledger_has_no_room(server: ChatServer, store: Store) -> None:
    fill(store, 20)
    with (
        full_disk(),
        pytest.raises(CacheError, match=r"Expected to write the ledger .*llm-ledger\.jsonl, found: \[Errno"),
    ):
        ask(questions(2), params(server.url), store.cache_dir)
    assert not server.requests
    assert len(ask(questions(2), params(server.url), store.cache_dir)) == 2


def test_a_refusal_is_told_as_it_is_where_the_ledger_has_no_room_for_it(server: ChatServer, store: Store) -> None:
    server.script = [failing(401, message="no such key")]
    fill(store, 120)
    with full_disk():
        assert "no such key" in stopped(server, store, 1)
