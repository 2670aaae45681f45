import pytest

from porse.identity import candidate_id, canonical_json, content_id, seed_for


def test_canonical_json_has_one_text_for_equal_values():
    assert canonical_json({"b": 1, "a": [1.5, "ä"]}) == '{"a":[1.5,"ä"],"b":1}'


def test_canonical_json_refuses_what_has_no_one_text():
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical_json(float("nan"))


def test_a_content_id_is_the_hash_of_kind_and_content():
    # printf 'x\n{"a":1}' | sha256sum
    assert content_id("x", {"a": 1}) == "0a76cb7b4c02680bfe496339d4f0f952bf221290b5821184429fa0f909f020d3"


def test_every_part_of_a_candidate_participates_in_its_id():
    ids = {
        candidate_id("T", "r", "m", 1.0, 0.8),
        candidate_id("U", "r", "m", 1.0, 0.8),
        candidate_id("T", "s", "m", 1.0, 0.8),
        candidate_id("T", "r", "n", 1.0, 0.8),
        candidate_id("T", "r", "m", 1.1, 0.8),
        candidate_id("T", "r", "m", 1.0, 0.7),
        candidate_id("T", "r", "m", 1.0, 0.8, 1),
        candidate_id("T", "r", "m", 1.0, 0.8, 2),
    }
    assert len(ids) == 8
    assert candidate_id("T", "r", "m", 1, 0.8) == candidate_id("T", "r", "m", 1.0, 0.8, 0)


def test_a_candidates_id_is_twelve_digits_of_a_hash():
    # printf 'candidate\n{"alpha":0.3,"beta":0.7,"mapping_source":"m","reward_source":"r","task":"T"}' | sha256sum
    assert candidate_id("T", "r", "m", 0.7, 0.3) == "867714546abd"
    # with "draw":2 between beta and the mapping
    assert candidate_id("T", "r", "m", 0.7, 0.3, 2) == "b88b0de7534e"


def test_seeds_are_named_and_fit_a_generator():
    seeds = [seed_for(1, "policy", n) for n in range(100)] + [seed_for(2, "policy", n) for n in range(100)]
    assert len(set(seeds)) == 200
    assert all(0 <= seed < 2**63 for seed in seeds)
