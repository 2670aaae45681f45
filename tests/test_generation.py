import dataclasses

import pytest
import torch

from porse.config import parse_params
from porse.errors import ParamsError, SearchError
from porse.functions.verdict import Verdict
from porse.generation import answers
from porse.generation.candidates import first_pool
from porse.generation.conversations import Brief
from porse.generation.functions import ROUNDS, Attempt, Function, checked_functions, sample_of
from porse.generation.mutants import _collect
from porse.generation.states import probe_states
from porse.generation.values import parse_values
from porse.llm.request import Message, Reply
from porse.pool import Pool
from porse.search.breeding import Breeding
from porse.tasks import find_task
from tiny import committed_params

BAD = Verdict(False, "syntax", "expected a colon", 3, (), ())
GOOD = Verdict(True, "ok", "", 0, program="program")


@pytest.mark.parametrize(
    ("text", "varied", "values"),
    [
        ('Try\n```json\n[{"goal": 1.5, "bonus": 0.5}, {"goal": 1, "bonus": 1}]\n```', "beta", [0.5, 1.0]),
        # weights of another sum keep their ratio: 2 x 3 / (1 + 3) = 1.5
        ('```\n[{"goal": 1, "bonus": 3}, {"goal": 2, "bonus": 0}]\n```', "beta", [1.5, 0.0]),
        ("```json\n[0, 0.25]\n```", "alpha", [0.0, 0.25]),
        ("[0.5, 1]", "alpha", [0.5, 1.0]),
        ("```json\n[9, 9]\n```\nor better\n```json\n[0.1, 0.2]\n```", "alpha", [0.1, 0.2]),
    ],
)
def test_values_are_read_from_the_last_block(text, varied, values):
    assert parse_values(text, varied, 2, 2.0) == values


@pytest.mark.parametrize(
    ("text", "varied", "message"),
    [
        ("I would try 0.5.", "alpha", "JSON"),
        ("[0.5]", "alpha", "a list of 2"),
        ("[0.5, 1.2]", "alpha", r"\[0, 1\]"),
        ("[true, 0.5]", "alpha", "True"),
        ("[0.5, 0.6]", "beta", "a pair"),
        ('[{"goal": 0, "bonus": 0}, {"goal": 1, "bonus": 1}]', "beta", "above 0"),
        ('[{"goal": -1, "bonus": 2}, {"goal": 1, "bonus": 1}]', "beta", "weight goal"),
        ('[{"goal": 1}, {"goal": 1, "bonus": 1}]', "beta", "weight bonus"),
        ('[{"goal": 1, "bonus": NaN}, {"goal": 1, "bonus": 1}]', "beta", "weight bonus"),
    ],
)
def test_values_that_cannot_be_used_are_refused_with_what_was_found(text, varied, message):
    with pytest.raises(ValueError, match=message):
        parse_values(text, varied, 2, 2.0)


class Model:
    """Answers each question with its place in the sequence, and remembers what it was asked."""

    def __init__(self):
        self.questions = []

    def ask(self, questions, llm, cache):
        self.questions += questions
        return [
            Reply(f"k{len(self.questions)}", f"reply {len(self.questions)}", "stop", 0, 0, "test", 0.0)
            for _ in questions
        ]


@pytest.fixture
def model(monkeypatch):
    scripted = Model()
    monkeypatch.setattr(answers, "ask", scripted.ask)
    return scripted


@pytest.fixture
def brief(root):
    facts = {"description": "hover", "starts": "", "ends": "", "fitness": "", "limit": 7}
    return Brief(root / "prompts", facts, "class Quadcopter: ...", True, False, None, [], {}, {}, [])


def run(params, brief, verdicts):
    """Runs one slot through the given verdicts."""
    sequence = iter(verdicts)
    first = Attempt("reward", 2, 0, (Message("user", "write"),), Reply("k0", "first", "stop", 0, 0, "test", 0.0))

    def check(attempts):
        return [(verdict, "source" if verdict.passed else "") for verdict in (next(sequence) for _ in attempts)]

    return checked_functions([first], check, brief, params, 1, None)


def test_a_broken_function_goes_back_with_its_verdict(params, brief, model):
    checked = run(params, brief, [BAD, GOOD])
    [question] = model.questions
    assert [message.role for message in question.request.messages] == ["user", "assistant", "user"]
    assert question.request.messages[1].content == "first"
    assert "expected a colon" in question.request.messages[2].content
    assert "line 3" in question.request.messages[2].content
    assert (question.origin.stage, question.origin.subject) == ("validate-code", "reward 2, attempt 1")
    assert checked.functions == [Function("reward", 2, "k1", "source", "program")]
    assert [verdict.passed for _, verdict in checked.attempts] == [False, True]


def test_what_stays_broken_is_replaced_by_a_fresh_reply(params, brief, model):
    # max_repairs 2: attempts 0, 1, 2 are a reply and its repairs; attempt 3 asks the first question with a new sample.
    run(params, brief, [BAD, BAD, BAD, GOOD])
    fresh = model.questions[2].request
    assert [message.role for message in fresh.messages] == ["system", "user"]
    assert fresh.sample == 2 + params.generate.candidates


@pytest.mark.parametrize(
    ("winner", "bred", "sample"),
    [
        # K = 6: an iteration has 6 * 1001 samples of a question. The first fresh reply of slot 2: 2 + 6 * 1 = 8. Iteration 4 is the
        # first that refines the winner of iteration 3.
        (3, None, 8),
        # The winner of iteration 1 was refined in iterations 2 and 3.
        (1, None, 8 + 2 * 6006),
        # Without a winner the first question is asked again: in iterations 1, 2 and 3 before.
        (None, None, 8 + 3 * 6006),
        # Parents are bred from in iteration 2 for the first time. The winner is not asked about.
        (3, ("a",), 8 + 2 * 6006),
        (3, (), 8 + 3 * 6006),
    ],
)
def test_the_same_question_in_a_later_iteration_is_another_sample(params, brief, winner, bred, sample):
    brief = dataclasses.replace(
        brief,
        winner=winner and {"iteration": winner},
        breedings={} if bred is None else {2: Breeding(2, 0, "mutation", bred)},
    )
    assert params.generate.candidates == 6
    assert sample_of(brief, "reward", 2, 1, params, 4) == sample


def test_the_samples_of_a_mapping_follow_the_winner_since_mappings_are_not_bred(params, brief):
    bred = dataclasses.replace(brief, winner={"iteration": 2}, breedings={2: Breeding(2, 0, "mutation", ("a",))})
    # Of iterations 3 and 4, the first refined this winner before; as a reward, slot 2 was bred in iterations 2 and 3.
    assert sample_of(bred, "mapping", 2, 0, params, 4) == 2 + 6006
    assert sample_of(bred, "reward", 2, 0, params, 4) == 2 + 2 * 6006


def test_an_iteration_has_more_samples_than_fresh_replies_are_allowed():
    document = committed_params()
    allowed = {**document["validate"], "max_fresh": ROUNDS - 1}
    assert parse_params({**document, "validate": allowed}, "a test").validate.max_fresh == ROUNDS - 1
    with pytest.raises(ParamsError, match="max_fresh"):
        parse_params({**document, "validate": {**allowed, "max_fresh": ROUNDS}}, "a test")


def test_when_no_attempt_is_left_the_stage_says_so(params, brief, model):
    # (2 + 1) x (2 + 1) attempts
    with pytest.raises(SearchError, match="slot 2 of iteration 1, found none in 9 replies"):
        run(params, brief, [BAD] * 9)


def with_candidates(params, candidates):
    return dataclasses.replace(params, generate=dataclasses.replace(params.generate, candidates=candidates))


def functions_of(*sources):
    return [
        Function(kind, slot, f"{kind}{slot}", f"{kind} {source}", f"list of {kind} {source}")
        for slot, source in enumerate(sources)
        for kind in ("reward", "mapping")
    ]


def test_the_first_pool_pairs_slots_and_carries_the_winners_pair_over(params):
    winner = {
        "candidate_id": "w", "reward_key": "rk", "mapping_key": "mk", "reward_source": "r", "mapping_source": "m",
        "reward_program": "rp", "mapping_program": "mp", "beta": 1.7, "alpha": 0.3,
    }  # fmt: skip
    pool = first_pool(functions_of("a", "b"), winner, {}, with_candidates(params, 3), 2)
    assert [(row["slot"], row["origin"], row["reward_source"], row["mapping_source"]) for row in pool] == [
        (0, "new", "reward a", "mapping a"),
        (1, "new", "reward b", "mapping b"),
        (2, "elite", "r", "m"),
    ]
    assert [(row["reward_program"], row["mapping_program"]) for row in pool][1:] == [
        ("list of reward b", "list of mapping b"),
        ("rp", "mp"),
    ]
    assert {(row["beta"], row["alpha"], row["policy"], row["epochs"]) for row in pool} == {(1.0, 0.8, "fused", 0)}
    assert pool[2]["parent_id"] == "w"


def test_equal_pairs_are_one_candidate(params):
    assert [
        row["slot"] for row in first_pool(functions_of("a", "a", "b"), None, {}, with_candidates(params, 3), 1)
    ] == [0, 2]


def test_mutants_take_slots_after_the_candidates_and_none_equals_its_parent(params, tmp_path):
    [parent] = first_pool(functions_of("a"), None, {}, with_candidates(params, 1), 2)
    pool = Pool(tmp_path, [parent], [])
    values = [0.1, 0.8, 0.1, 0.9]
    swarm = _collect(pool, parent, "alpha", values, values, params, [])
    # 0.8 is the parent itself, and the second 0.1 is the first again.
    assert [(row["slot"], row["alpha"], row["policy"]) for row in swarm.mutants] == [
        (6, 0.1, "alpha-0.100000"),
        (9, 0.9, "alpha-0.900000"),
    ]
    assert [row["index"] for row in swarm.rows] == [0, 3]


def test_probe_states_are_those_that_a_reward_is_paid_for_of_several_ages():
    states = probe_states("Quadcopter", 4, 3, 1)
    assert states["num_envs"] == 12
    assert states["root_positions"].shape == (12, 3)
    late = find_task("Quadcopter").EPISODE_LENGTH - 1
    assert states["progress_buf"].tolist() == [1] * 4 + [3] * 4 + [late] * 4
    assert (states["root_linvels"] != 0).any(dim=1).all()


def test_forces_are_not_exactly_zero_in_probe_states():
    """They are right after a reset, where no reward is paid, and divisions by them refused good rewards."""
    states = probe_states("ReOrientation", 2, 2, 1)
    forces = [v for n, v in states.items() if isinstance(v, torch.Tensor) and n.endswith("dof_force_tensor")]
    assert forces
    assert all(bool((force != 0).any(dim=1).all()) for force in forces)


def test_parameters_reach_the_request(params, brief, model):
    run(dataclasses.replace(params, llm=dataclasses.replace(params.llm, max_tokens=99)), brief, [BAD, GOOD])
    request = model.questions[0].request
    assert (request.model, request.temperature, request.top_p, request.max_tokens) == ("offline", 1.0, 1.0, 99)
