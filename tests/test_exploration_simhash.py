import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from porse.exploration import SimHash
from porse.exploration.simhash import hash_codes

# Bit 0: x >= 0; bit 1: y >= 0; bit 2: x - y >= 0.
PROJECTION = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]], dtype=torch.float64)


def test_a_code_has_one_bit_for_each_side_of_a_plane():
    states = torch.tensor([[2.0, 1.0], [1.0, 2.0], [-1.0, 2.0], [-2.0, -1.0], [1.0, -1.0]])
    # (2, 1): + + + = 1 + 2 + 4; (1, 2): + + - = 3; (-1, 2): - + - = 2; (-2, -1): - - - = 0; (1, -1): + - + = 5
    assert hash_codes(states, PROJECTION).tolist() == [7, 3, 2, 0, 5]


def test_zero_counts_as_positive():
    # (0, 0): all bits; (-1, -1): x - y = 0 sets bit 2 alone
    assert hash_codes(torch.tensor([[0.0, 0.0], [-0.0, -0.0], [-1.0, -1.0]]), PROJECTION).tolist() == [7, 7, 4]


def test_opposite_states_have_complementary_codes_and_scaled_ones_the_same():
    states = torch.randn(64, 7, generator=torch.Generator().manual_seed(1))
    codes = hash_codes(states, SimHash(7, 20, 3).projection)
    opposite = hash_codes(-states, SimHash(7, 20, 3).projection)
    assert (codes + opposite).tolist() == [2**20 - 1] * 64
    scaled = hash_codes(4.0 * states, SimHash(7, 20, 3).projection)
    assert scaled.tolist() == codes.tolist()
    assert len(set(codes.tolist())) > 60


def test_what_is_not_finite_has_no_code():
    rows = torch.tensor([[float("nan"), 1.0], [2.0, 1.0], [float("inf"), 1.0], [1.0, float("-inf")]])
    assert hash_codes(rows, PROJECTION).tolist() == [-1, 7, -1, -1]


def test_the_projection_is_standard_normal_and_follows_from_the_seed():
    first, again, other = (SimHash(500, 20, seed).projection for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    # 10 000 numbers: the mean is within 0.04, four standard errors, of 0, and the variance within 0.06 of 1
    assert abs(first.mean().item()) < 0.04
    assert abs(first.var().item() - 1.0) < 0.06


def test_drawing_the_projection_leaves_the_global_generator_alone():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    SimHash(30, 10, 5)
    assert torch.equal(torch.get_rng_state(), before)


@given(st.integers(1, 12), st.integers(1, 6), st.integers(0, 2**31 - 1))
@settings(deadline=None, max_examples=40)
def test_every_state_has_a_cell(bits, width, seed):
    hashes = SimHash(width, bits, seed)
    cells = hashes.locate(torch.randn(10, width, generator=torch.Generator().manual_seed(seed)))
    assert hashes.cells == 2**bits
    assert bool(((cells >= 0) & (cells < hashes.cells)).all())


@pytest.mark.parametrize("bits", [0, 21])
def test_a_number_of_bits_that_a_table_cannot_hold_is_refused(bits):
    with pytest.raises(ValueError, match=f"expected 1 to 20 bits of a hash, found {bits}"):
        SimHash(3, bits, 0)
