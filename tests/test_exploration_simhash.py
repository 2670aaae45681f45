import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from porse.exploration import SimHashCounts
from porse.exploration.simhash import hash_codes

# Bit 0: x >= 0; bit 1: y >= 0; bit 2: x - y >= 0.
PROJECTION = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]], dtype=torch.float64)


def hand_made(scale=0.01):
    counter = SimHashCounts(2, 3, scale, 0)
    counter.projection = PROJECTION
    return counter


def test_a_code_has_one_bit_for_each_side_of_a_plane():
    states = torch.tensor([[2.0, 1.0], [1.0, 2.0], [-1.0, 2.0], [-2.0, -1.0], [1.0, -1.0]])
    # (2, 1): + + + = 1 + 2 + 4; (1, 2): + + - = 3; (-1, 2): - + - = 2; (-2, -1): - - - = 0; (1, -1): + - + = 5
    assert hash_codes(states, PROJECTION).tolist() == [7, 3, 2, 0, 5]


def test_zero_counts_as_positive():
    # (0, 0): all bits; (-1, -1): x - y = 0 sets bit 2 alone
    assert hash_codes(torch.tensor([[0.0, 0.0], [-0.0, -0.0], [-1.0, -1.0]]), PROJECTION).tolist() == [7, 7, 4]


def test_opposite_states_have_complementary_codes_and_scaled_ones_the_same():
    states = torch.randn(64, 7, generator=torch.Generator().manual_seed(1))
    codes = hash_codes(states, SimHashCounts(7, 20, 1.0, 3).projection)
    opposite = hash_codes(-states, SimHashCounts(7, 20, 1.0, 3).projection)
    assert (codes + opposite).tolist() == [2**20 - 1] * 64
    scaled = hash_codes(4.0 * states, SimHashCounts(7, 20, 1.0, 3).projection)
    assert scaled.tolist() == codes.tolist()
    assert len(set(codes.tolist())) > 60


def test_the_bonus_is_the_scale_over_the_root_of_the_visits_after_counting():
    counter = hand_made()
    # (2, 1) and (20, 10) collide in code 7, (1, 2) is alone in code 3
    bonus = counter.bonus(torch.tensor([[2.0, 1.0], [20.0, 10.0], [1.0, 2.0]]))
    torch.testing.assert_close(bonus, torch.tensor([0.01 / 2**0.5, 0.01 / 2**0.5, 0.01]))
    assert counter.counts.tolist() == [0, 0, 0, 1, 0, 0, 0, 2]
    torch.testing.assert_close(counter.bonus(torch.tensor([[4.0, 2.0]])), torch.tensor([0.01 / 3**0.5]))
    assert bonus.dtype == torch.float32


def test_what_is_not_finite_is_not_counted_and_earns_nothing():
    counter = hand_made()
    bonus = counter.bonus(torch.tensor([[float("nan"), 1.0], [2.0, 1.0], [float("inf"), 1.0], [1.0, float("-inf")]]))
    assert bonus.tolist() == [0.0, pytest.approx(0.01), 0.0, 0.0]
    assert counter.bonus(torch.full((2, 2), float("nan"))).tolist() == [0.0, 0.0]
    assert int(counter.counts.sum()) == 1


def test_the_projection_is_standard_normal_and_follows_from_the_seed():
    first, again, other = (SimHashCounts(500, 20, 1.0, seed).projection for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    # 10 000 numbers: the mean is within 0.04, four standard errors, of 0, and the variance within 0.06 of 1
    assert abs(first.mean().item()) < 0.04
    assert abs(first.var().item() - 1.0) < 0.06


def test_drawing_the_projection_leaves_the_global_generator_alone():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    SimHashCounts(30, 10, 1.0, 5)
    assert torch.equal(torch.get_rng_state(), before)


@given(st.integers(1, 12), st.integers(1, 6), st.integers(0, 2**31 - 1))
@settings(deadline=None, max_examples=40)
def test_every_visit_is_counted_once(bits, width, seed):
    counter = SimHashCounts(width, bits, 1.0, seed)
    generator = torch.Generator().manual_seed(seed)
    for step in range(1, 4):
        bonus = counter.bonus(torch.randn(10, width, generator=generator))
        assert counter.counts.shape == (2**bits,)
        assert int(counter.counts.sum()) == 10 * step
        assert bool(((bonus > 0.0) & (bonus <= 1.0)).all())


@pytest.mark.parametrize("bits", [0, 21])
def test_a_number_of_bits_that_a_table_cannot_hold_is_refused(bits):
    with pytest.raises(ValueError, match=f"expected 1 to 20 bits of a hash, found {bits}"):
        SimHashCounts(3, bits, 1.0, 0)


def test_counts_continue_from_a_state():
    steps = [torch.randn(16, 5, generator=torch.Generator().manual_seed(i)) for i in range(6)]
    whole, first, second = (SimHashCounts(5, 4, 0.01, 9) for _ in range(3))
    expected = [whole.bonus(step).tolist() for step in steps]
    for step in steps[:3]:
        first.bonus(step)
    state = first.state()
    assert set(state) == {"counts"}
    second.load_state(state)
    assert [second.bonus(step).tolist() for step in steps[3:]] == expected[3:]
    # neither object shares memory with the state
    assert state["counts"].sum() == first.counts.sum() == 48
