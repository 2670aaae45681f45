"""What the exploration bonus means: bins, cells, counts and directions by pencil, with asymmetric numbers."""

import pytest
import torch

from porse.exploration import SimHashCounts, SumCounts, VisitCounts
from porse.exploration.bins import ProgressBins
from porse.exploration.bonus import pay_finite, rarity
from porse.exploration.ranges import Range, first_range, grow
from porse.exploration.simhash import hash_codes
from porse.exploration.sums import bins_per_summand
from porse.exploration.visits import bins_per_variable


def doubles(*rows):
    return torch.tensor(rows, dtype=torch.float64)


# The bonus of a visit.


def test_the_bonus_falls_with_the_root_of_the_visits():
    # 0.3 / sqrt(1), / sqrt(4), / sqrt(9)
    found = rarity(torch.tensor([1, 4, 9]), 0.3)
    assert found.tolist() == pytest.approx([0.3, 0.15, 0.1], rel=1e-6)
    assert found.dtype == torch.float32


def test_rows_that_are_not_finite_are_left_out_and_the_others_keep_their_places():
    seen = []

    def pay(rows):
        seen.append(rows.tolist())
        return rows[:, 0] * 10.0

    rows = torch.tensor([[1.0, 2.0], [float("inf"), 2.0], [3.0, float("nan")], [4.0, 5.0]])
    assert pay_finite(rows, pay).tolist() == [10.0, 0.0, 0.0, 40.0]
    assert pay_finite(rows[1:3], pay).tolist() == [0.0, 0.0]
    assert seen == [[[1.0, 2.0], [4.0, 5.0]]]


# Ranges.


def test_a_first_range_starts_on_the_grid_of_its_width():
    # [0.3, 3.4] in 4 bins: 3.1 / 4 = 0.775, so bins of 1, from 0 to 4
    assert first_range(0.3, 3.4, 4) == Range(0.0, 1.0, 4)
    # [-0.3, 3.4]: 3.7 / 4 = 0.925, so bins of 1 from -1; 3.4 lies beyond 3, so they double upward: from -1 to 7
    assert first_range(-0.3, 3.4, 4) == Range(-1.0, 2.0, 4)
    # a spread of exactly 4 has bins of 1, and its upper end belongs above: bins of 2
    assert first_range(0.0, 4.0, 4) == Range(0.0, 2.0, 4)
    assert first_range(0.0, 3.999, 4) == Range(0.0, 1.0, 4)


def test_equal_first_values_have_bins_as_fine_as_the_values_allow():
    # 2^-20 up to 1; at 6 the next power of two, 8, coarsens them: 2^-17
    assert first_range(0.5, 0.5, 4).width == 2.0**-20
    assert first_range(6.0, 6.0, 4).width == 2.0**-17
    assert first_range(-6.0, -6.0, 4).width == 2.0**-17


def test_a_value_lies_in_the_bin_whose_lower_edge_it_has_reached():
    found = Range(-2.0, 0.5, 5)
    # edges -2, -1.5, -1, -0.5, 0, 0.5
    values = torch.tensor([-2.0, -1.6, -1.5, -1e-20, 0.0, 0.49], dtype=torch.float64)
    assert found.index(values).tolist() == [0, 0, 1, 3, 4, 4]
    assert found.high == 0.5


def test_growing_by_two_doublings_merges_four_bins():
    # [0, 6) in bins of 2 toward 20: bins of 4 to 12, then of 8 to 24
    assert grow(Range(0.0, 2.0, 3), 20.0) == (Range(0.0, 8.0, 3), [0, 0, 0])
    # toward -7: [-6, 6) in bins of 4 with (1, 2, 2), then [-18, 6) in bins of 8 with 1 -> 2 - 1 // 2 = 2
    assert grow(Range(0.0, 2.0, 3), -7.0) == (Range(-18.0, 8.0, 3), [2, 2, 2])
    # the upper edge itself is outside, the lower one inside
    assert grow(Range(0.0, 1.0, 5), 5.0) == (Range(0.0, 2.0, 5), [0, 0, 1, 1, 2])
    assert grow(Range(0.0, 1.0, 5), 0.0) == (Range(0.0, 1.0, 5), [0, 1, 2, 3, 4])


# Bins of several variables.


def test_a_falling_variable_rises_as_it_falls_and_the_others_stay():
    space = ProgressBins([True, False, True], 4)
    assert space.turn(torch.tensor([[1.0, 2.0, -3.0]])).tolist() == [[1.0, -2.0, -3.0]]


def test_the_last_variable_counts_least_in_a_joint_cell():
    space = ProgressBins([True, True, True], 5)
    # 25 x 3 + 5 x 1 + 4 = 84
    assert space.encode(torch.tensor([[3, 1, 4]])).tolist() == [84]
    assert space.decode(torch.tensor([84, 7])).tolist() == [[3, 1, 4], [0, 1, 2]]


def test_every_variable_has_its_own_range_and_growths_name_theirs():
    space = ProgressBins([True, True], 4)
    assert space.include(doubles([0.0, 0.0], [3.0, 30.0])) == []
    assert space.ranges == [Range(0.0, 1.0, 4), Range(0.0, 8.0, 4)]
    assert space.indices(doubles([2.5, 17.0])).tolist() == [[2, 2]]
    # the second alone grows, upward; then the first, downward
    [growth] = space.include(doubles([1.0, 40.0]))
    assert (growth.variable, growth.image.tolist()) == (1, [0, 0, 1, 1])
    [growth] = space.include(doubles([-1.0, 0.0]))
    assert (growth.variable, growth.image.tolist()) == (0, [2, 2, 3, 3])
    assert space.ranges == [Range(-4.0, 2.0, 4), Range(0.0, 16.0, 4)]
    assert space.state().tolist() == [[-4.0, 2.0], [0.0, 16.0]]


def test_one_step_may_push_a_range_both_ways():
    space = ProgressBins([True], 4)
    space.include(doubles([0.0], [3.0]))
    growths = space.include(doubles([-1.0], [6.0]))
    # down to [-4, 4) first, then up to [-4, 12)
    assert [growth.image.tolist() for growth in growths] == [[2, 2, 3, 3], [0, 0, 1, 1]]
    assert space.ranges == [Range(-4.0, 4.0, 4)]


def test_more_cells_than_an_integer_can_tell_apart_are_refused():
    # 8^21 = 2^63 are just enough
    assert ProgressBins([True] * 21, 8).variables == 21
    with pytest.raises(ValueError, match="at most 2\\^63"):
        ProgressBins([True] * 22, 8)


# Counts.


def test_bins_fill_the_cells_of_a_grid_and_of_a_sum():
    # grid: 3^4 = 81 <= 100 < 4^4; sum: 4 (25 - 1) + 1 = 97 <= 100 < 4 x 25 + 1
    assert bins_per_variable(100, 4) == 3
    assert bins_per_summand(100, 4) == 25
    assert (bins_per_variable(8, 3), bins_per_variable(7, 3)) == (2, 1)
    assert (bins_per_summand(101, 4), bins_per_summand(10, 1)) == (26, 10)


def test_a_grid_tells_cells_of_equal_sum_apart_and_a_sum_does_not():
    grid, added = VisitCounts([True, True], 16, 1.0), SumCounts([True, True], 7, 1.0)
    # bins of 1 for both; (1, 2) and (2, 1) have the sum 3, (3, 3) has 6
    steps = torch.tensor([[0.0, 0.0], [3.0, 3.0], [1.0, 2.0], [2.0, 1.0], [1.0, 2.0]])
    root2, root3 = 2.0**-0.5, 3.0**-0.5
    assert grid.bonus(steps).tolist() == pytest.approx([1.0, 1.0, root2, 1.0, root2], rel=1e-6)
    assert added.bonus(steps).tolist() == pytest.approx([1.0, 1.0, root3, root3, root3], rel=1e-6)
    assert (len(grid.counts), len(added.counts)) == (16, 7)
    assert added.counts.tolist() == [1, 0, 0, 3, 0, 0, 1]


def test_merged_cells_keep_their_visits_in_the_variable_that_grew():
    visits = VisitCounts([True, True], 4, 1.0)
    # 2 x 2 bins of 1: (0, 0) twice, (0, 1) once, (1, 1) once
    visits.bonus(torch.tensor([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    assert visits.counts.tolist() == [2, 1, 0, 1]
    # the second variable grows to [0, 4): its old bins are both bin 0; the newcomer lies in (0, 1)
    assert visits.bonus(torch.tensor([[0.0, 3.0]])).tolist() == [1.0]
    assert visits.counts.tolist() == [3, 1, 1, 0]
    # and one more in the cell of the old three has 4 visits
    assert visits.bonus(torch.tensor([[0.0, 0.5]])).tolist() == [0.5]


def test_sums_are_counted_anew_when_a_variable_grows():
    counts = SumCounts([True, False], 7, 0.4)
    assert counts.space.bins == 4
    # turned: (0, 0), (3, 3), (1, 3): sums 0, 6, 4
    counts.bonus(torch.tensor([[0.0, 0.0], [3.0, -3.0], [1.0, -3.0]]))
    assert counts.counts.tolist() == [1, 0, 0, 0, 1, 0, 1]
    # the first grows to [0, 8): old bins 0, 3, 1 become 0, 1, 0: sums 0, 4, 3; the newcomer (5 -> 2, 1) has 3
    assert counts.bonus(torch.tensor([[5.0, -1.0]])).tolist() == pytest.approx([0.4 / 2**0.5], rel=1e-6)
    assert counts.counts.tolist() == [1, 0, 0, 2, 1, 0, 0]


def test_sums_are_counted_anew_in_the_variable_that_grew():
    counts = SumCounts([True, True], 7, 1.0)
    # (0, 0), (3, 3), (3, 1): sums 0, 6, 4; the second grows to [0, 8): (0, 0), (3, 1), (3, 0): sums 0, 4, 3
    counts.bonus(torch.tensor([[0.0, 0.0], [3.0, 3.0], [3.0, 1.0]]))
    assert counts.bonus(torch.tensor([[0.0, 5.0]])).tolist() == [1.0]
    # and the newcomer's bins are (0, 2)
    assert counts.counts.tolist() == [1, 0, 1, 1, 1, 0, 0]


def test_joint_cells_survive_folding_and_a_state():
    counts = SumCounts([True, True], 7, 1.0)
    counts.bonus(torch.tensor([[0.0, 0.0], [3.0, 3.0]]))
    for _ in range(300):
        counts.bonus(torch.tensor([[1.0, 2.0]]))
    # joint cells of 4 x 4: 0, (1, 2) = 6, (3, 3) = 15
    state = counts.state()
    assert (state["joint"].tolist(), state["visits"].tolist()) == ([0, 6, 15], [1, 300, 1])
    other = SumCounts([True, True], 7, 1.0)
    other.load_state(state)
    assert other.counts.tolist() == [1, 0, 0, 300, 0, 0, 1]
    assert other.bonus(torch.tensor([[2.0, 1.0]])).tolist() == pytest.approx([301**-0.5], rel=1e-6)


def test_a_state_is_a_copy():
    for counts, step in (
        (VisitCounts([True], 4, 1.0), torch.tensor([[0.0], [1.0]])),
        (SimHashCounts(1, 3, 1.0, 0), torch.tensor([[0.5], [1.0]])),
    ):
        counts.bonus(step)
        state = counts.state()
        counts.bonus(step)
        assert int(state["counts"].sum()) == 2
        counts.load_state(state)
        counts.bonus(step)
        assert int(state["counts"].sum()) == 2


# Hashes.


def test_the_first_row_of_the_projection_is_the_lowest_bit():
    projection = doubles([1.0, 0.0], [0.0, 1.0], [-1.0, -1.0])
    # x >= 0 is 1, y >= 0 is 2, x + y <= 0 is 4
    states = torch.tensor([[1.0, 2.0], [1.0, -2.0], [-1.0, 2.0], [-1.0, -2.0], [-1.0, 1.0]])
    assert hash_codes(states, projection).tolist() == [3, 5, 2, 4, 6]


def test_a_hash_is_drawn_by_its_own_seed_alone():
    expected = torch.randn((3, 2), generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    assert torch.equal(SimHashCounts(2, 3, 1.0, 12).projection, expected)
    assert len(SimHashCounts(2, 3, 1.0, 12).counts) == 8
