import copy
import dataclasses

import pytest
import yaml

from porse.config import Params, parse_params
from porse.errors import ParamsError


@pytest.fixture(scope="module")
def document(root):
    return yaml.safe_load((root / "params.yaml").read_text())


def changed(document, name, value):
    document = copy.deepcopy(document)
    *path, last = name.split(".")
    section = document
    for key in path:
        section = section[key]
    section[last] = value
    return document


def test_the_committed_parameters_load(params):
    assert params.task == "Quadcopter"
    assert (params.generate.candidates, params.mutate.mutants, len(params.iterations)) == (6, 5, 5)
    assert (params.exploration.lambda_, params.exploration.cells) == (0.5, 1000)
    assert (params.candidate.beta, params.candidate.alpha) == (1.0, 0.8)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("seed", -1, ["seed", "[0,", "-1"]),
        ("candidate.alpha", 1.5, ["candidate.alpha", "[0, 1]", "1.5"]),
        ("candidate.beta", 3.0, ["candidate.beta", "candidate.scale"]),
        ("method", "prose", ["method", "porse", "did you mean"]),
        ("ablation", "without-bonsu", ["ablation", "did you mean without-bonus"]),
        ("generator", "human", ["generator", "model", "grammar"]),
        ("mutate.vary", ["gamma"], ["mutate.vary[0]", "beta", "alpha"]),
        ("numerics", "slow", ["numerics", "portable", "fast"]),
        ("llm.profile", "gpt", ["llm.profile", "offline"]),
        (
            "llm.profiles.local.leave_out",
            ["top_k"],
            ["llm.profiles.local.leave_out[0]", "temperature", "top_p", "top_k"],
        ),
        ("llm.profiles.local.aliases", "name", ["llm.profiles.local.aliases", "a list", "name"]),
        ("llm.profiles.local.extra", {"a": [{"b": float("inf")}]}, ["llm.profiles.local.extra.a[0].b", "finite"]),
        ("llm.profiles.local.extra", {"a": {1: 2}}, ["llm.profiles.local.extra.a", "texts as keys"]),
        ("llm.profiles.local.extra", {"a": dataclasses}, ["llm.profiles.local.extra.a", "type"]),
        ("train.num_envs", "many", ["train.num_envs", "int", "many"]),
        ("train.num_envs", True, ["train.num_envs", "int"]),
        ("train.gamma", float("nan"), ["train.gamma", "finite"]),
        ("train.minibatches", 7, ["train.minibatches", "divisor"]),
        ("generate.elites", 6, ["generate.elites", "generate.candidates"]),
        ("probe.trainings", 1, ["probe.trainings", "0, or at least 2", "found 1"]),
        ("train.hidden", [], ["train.hidden", "list"]),
        ("iterations", [{"n": 2, "next": 3}], ["iterations"]),
        (
            "rungs",
            [{"rung": 1, "pool": "validate-code", "until": 1, "keep": 7}],
            ["rungs[0].keep", "at most the 6", "7"],
        ),
        ("rungs", [{"rung": 1, "pool": "eliminate-9", "until": 1, "keep": 1}], ["rungs[0].pool", "validate-code"]),
        ("rungs", [{"rung": 1, "pool": "validate-code", "until": 1, "keep": 2}], ["fuse.pool", "keeps one"]),
        ("mutate.pool", "eliminate-4", ["rungs[3].pool", "eliminate-3"]),
        ("mutate.pool", "validate-code", ["mutate.pool", "an elimination where mutate.mutants is above 0"]),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(document, name, value, words):
    with pytest.raises(ParamsError) as caught:
        parse_params(changed(document, name, value), "params.yaml")
    assert all(word in str(caught.value) for word in [*words, "params.yaml"])


def test_an_extra_field_of_a_request_may_be_whatever_json_holds(document):
    extra = {"thinking": {"type": "disabled", "budget": None}, "stop": ["a", "b"], "top_k": 40, "x": True, "y": 0.5}
    params = parse_params(changed(document, "llm.profiles.local.extra", extra), "params.yaml")
    assert params.llm.profiles["local"].extra == extra


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("train.num_envs", 10**9, ["train.num_envs", "[2, 131072]"]),
        ("train.steps_per_epoch", 2**17, ["train.steps_per_epoch", "at most 4194304 divided by"]),
        ("train.hidden", [10**6], ["train.hidden[0]", "[1, 8192]"]),
        ("train.hidden", [64] * 40, ["train.hidden", "at most 16 layers"]),
        ("train.rung_epochs", 10**400, ["train.rung_epochs", "[1, 1e+06]", "000..."]),
        ("train.learning_rate", 10**400, ["train.learning_rate", "at most 1e+09", "000..."]),
        ("train.observation_clip", 0.0, ["train.observation_clip", "0.001"]),
        ("train.gamma", 1.0, ["train.gamma", "less than 1 where exploration.form is relative"]),
        ("exploration.lambda", 1e30, ["exploration.lambda", "1e+09"]),
        ("exploration.cells", 10**12, ["exploration.cells", "1e+06"]),
        ("generate.candidates", 10**6, ["generate.candidates", "[1, 1000]"]),
        ("evaluate.seeds", 10**6, ["evaluate.seeds", "[0, 1000]"]),
        ("evaluate.episodes", 1, ["evaluate.episodes", "[2, 131072]"]),
        ("iterations", [{"n": 1, "next": 1}], ["iterations[0].next", "a folder's name of its own"]),
        ("iterations", [{"n": 1, "next": "../x"}], ["iterations[0].next", "letters, digits and dashes"]),
        ("iterations", [{"n": 1, "next": 3}, {"n": 2, "next": 3}], ["iterations[0].next", "2, the iteration after it"]),
        ("rungs", [{"rung": "a; b", "pool": "validate-code", "until": 1, "keep": 1}], ["rungs[0].rung", "letters"]),
        ("rungs", [{"rung": 1, "pool": "validate-code", "until": 1, "keep": 1}] * 2, ["rungs[1].rung", "of its own"]),
        ("fuse.pool", "eliminate-9", ["fuse.pool", "keeps one"]),
    ],
)
def test_an_absurd_value_is_refused_before_anything_is_computed(document, name, value, words):
    with pytest.raises(ParamsError) as caught:
        parse_params(changed(document, name, value), "params.yaml")
    assert [word for word in [*words, "params.yaml"] if word not in str(caught.value)] == []
    assert len(str(caught.value)) < 500


def test_counts_of_each_environment_must_fit_into_a_checkpoint(document):
    # 2^24 counts: 16 384 environments x 1 024 cells, or 2^16 hashes of 256 environments
    document = changed(changed(document, "exploration.lifetime", "episode"), "train.num_envs", 2**14)
    parse_params(changed(document, "exploration.cells", 1024), "params.yaml")
    with pytest.raises(
        ParamsError, match=r"exploration\.cells to be fewer cells where exploration\.lifetime is episode"
    ):
        parse_params(changed(document, "exploration.cells", 1025), "params.yaml")
    hashed = changed(changed(document, "candidate.bonus", "simhash"), "exploration.simhash_bits", 16)
    parse_params(changed(hashed, "train.num_envs", 256), "params.yaml")
    with pytest.raises(ParamsError, match=r"exploration\.simhash_bits"):
        parse_params(changed(hashed, "train.num_envs", 512), "params.yaml")
    parse_params(changed(changed(document, "exploration.cells", 1025), "candidate.bonus", "none"), "params.yaml")


def test_a_pool_of_mutants_that_no_rung_reads_must_be_there_all_the_same(document):
    rungs = [{"rung": "only", "pool": "validate-code", "until": 1, "keep": 1}]
    with pytest.raises(ParamsError, match=r"expected mutate\.pool to be one of validate-code, eliminate-only"):
        parse_params(changed(changed(document, "rungs", rungs), "fuse.pool", "eliminate-only"), "params.yaml")


def test_an_unknown_parameter_is_refused_with_its_nearest_name(document):
    with pytest.raises(ParamsError, match=r"train\.gama; did you mean train\.gamma\?"):
        parse_params(changed(document, "train.gama", 0.9), "params.yaml")


def leaves(document, prefix=""):
    for key, value in document.items():
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")


def test_every_parameter_is_required(document):
    for name in leaves(document):
        if name.startswith(("llm.profiles.", "summarise.references.", "summarise.thresholds.")):
            continue  # entries by name: as many as one likes
        *path, last = name.split(".")
        incomplete = copy.deepcopy(document)
        section = incomplete
        for key in path:
            section = section[key]
        del section[last]
        with pytest.raises(ParamsError, match=f"parameter {name} in params.yaml, found none"):
            parse_params(incomplete, "params.yaml")


def test_no_parameter_has_a_default_in_python():
    def sections(kind):
        yield kind
        for field in dataclasses.fields(kind):
            if dataclasses.is_dataclass(field.type):
                yield from sections(field.type)

    for section in sections(Params):
        for field in dataclasses.fields(section):
            assert field.default is dataclasses.MISSING
            assert field.default_factory is dataclasses.MISSING


def test_every_parameter_is_explained(root):
    lines = (root / "params.yaml").read_text().splitlines()
    for index, line in enumerate(lines):
        if line and not line.startswith((" ", "#", "-")):
            explained = any(near.lstrip().startswith("#") for near in lines[max(0, index - 1) : index + 2])
            assert explained, f"{line} has no words above or below it"
