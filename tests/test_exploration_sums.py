from fractions import Fraction
from itertools import pairwise

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from porse.exploration import SumCounts, VisitCounts
from porse.exploration import sums as sums_module
from porse.exploration.bins import ProgressBins
from porse.exploration.ranges import Range
from porse.exploration.sums import bins_per_summand

FLOATS = st.floats(-1e6, 1e6, allow_nan=False, width=32)


def recounted(counter, progress, rises):
    """The counts that the last ranges give to all progress so far, (visits, variables), in exact arithmetic."""
    counts = [0] * len(counter.counts)
    for row in progress.tolist():
        turned = [Fraction(value if up else -value) for value, up in zip(row, rises, strict=True)]
        bins = [
            (value - Fraction(held.low)) // Fraction(held.width)
            for value, held in zip(turned, counter.space.ranges, strict=True)
        ]
        counts[sum(bins)] += 1
    return counts


def test_the_sums_fill_the_cells_and_no_more():
    # 1 x 999 + 1 = 1000; 2 x 499 + 1 = 999; 3 x 333 + 1 = 1000; 8 x 124 + 1 = 993, and 8 x 125 + 1 = 1001 are too many
    assert [bins_per_summand(1000, d) for d in (1, 2, 3, 8)] == [1000, 500, 334, 125]
    assert [len(SumCounts([True] * d, 1000, 1.0).counts) for d in (1, 2, 3, 8)] == [1000, 999, 1000, 993]


@given(st.integers(2, 2000), st.integers(1, 40))
def test_no_larger_number_of_bins_would_fit(cells, variables):
    bins = bins_per_summand(cells, variables)
    assert variables * (bins - 1) + 1 <= cells < variables * bins + 1


def test_a_cell_is_the_sum_of_the_bins():
    # 7 cells of 2 variables: 4 bins each, over [0, 4). Sums: 0 + 3, 3 + 0, 1 + 1, 3 + 3.
    counter = SumCounts([True, True], 7, 0.01)
    bonus = counter.bonus(torch.tensor([[0.0, 3.0], [3.0, 0.0], [1.0, 1.0], [3.5, 3.5]]))
    assert counter.space.ranges == [Range(0.0, 1.0, 4)] * 2
    assert counter.counts.tolist() == [0, 0, 1, 2, 0, 0, 1]
    torch.testing.assert_close(bonus, torch.tensor([0.01 / 2**0.5, 0.01 / 2**0.5, 0.01, 0.01]))


def test_equal_sums_part_when_a_range_grows():
    # 4 bins each, over [0, 4): (0, 3), (3, 0) and (2, 1) share the sum 3. Then 7 in the first variable: its bins become
    # 0 and 1 -> 0, 2 and 3 -> 1, and the three are now 0 + 3, 1 + 0 and 1 + 1; the new one is 3 + 0.
    counter = SumCounts([True, True], 7, 0.01)
    counter.bonus(torch.tensor([[0.0, 3.0], [3.0, 0.0], [2.0, 1.0]]))
    assert counter.counts.tolist() == [0, 0, 0, 3, 0, 0, 0]
    bonus = counter.bonus(torch.tensor([[7.0, 0.0]]))
    assert counter.counts.tolist() == [0, 1, 1, 2, 0, 0, 0]
    torch.testing.assert_close(bonus, torch.tensor([0.01 / 2**0.5]))


@given(
    st.lists(st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=4), min_size=1, max_size=15), st.integers(3, 60)
)
@settings(deadline=None, max_examples=150)
def test_counts_are_those_that_the_last_ranges_would_have_given(steps, cells):
    rises = [True, False]
    counter = SumCounts(rises, cells, 1.0)
    for step in steps:
        counter.bonus(torch.tensor(step))
    seen = torch.tensor([row for step in steps for row in step])
    assert counter.counts.tolist() == recounted(counter, seen, rises)


def test_a_value_that_rounds_onto_an_edge_stays_below_it():
    # 2 bins over [-1, 0): -1e-20 + 1 is rounded to 1, the upper edge; it belongs to the last bin, 1. Then 0 comes, the
    # range is [-1, 1) with an edge at 0, and -1e-20 + 1 would be rounded into the bin above: it stays in bin 0.
    counter = SumCounts([True], 2, 1.0)
    counter.bonus(torch.tensor([[-1.0], [-1e-20]]))
    assert counter.counts.tolist() == [1, 1]
    counter.bonus(torch.tensor([[0.0]]))
    assert counter.counts.tolist() == [2, 1]
    counter.bonus(torch.tensor([[-1e-20]]))
    assert counter.counts.tolist() == [3, 1]


@pytest.mark.parametrize("variables", [1, 3, 8])
def test_counts_stay_right_over_many_steps_and_growths(variables, monkeypatch):
    monkeypatch.setattr(sums_module, "_BUFFERED_STEPS", 4)
    rises = [index % 2 == 0 for index in range(variables)]
    counter = SumCounts(rises, 200, 1.0)
    generator = torch.Generator().manual_seed(variables)
    steps = [torch.randn(16, variables, generator=generator) * (1 + index) for index in range(60)]
    for step in steps:
        counter.bonus(step)
    assert counter.counts.tolist() == recounted(counter, torch.cat(steps), rises)


def test_one_variable_counts_like_a_grid_of_one_variable():
    sums, grid = SumCounts([False], 50, 0.01), VisitCounts([False], 50, 0.01)
    generator = torch.Generator().manual_seed(5)
    for scale in (1.0, 3.0, 0.1, 20.0):
        step = torch.randn(32, 1, generator=generator) * scale
        assert sums.bonus(step).tolist() == grid.bonus(step).tolist()
    assert sums.counts.tolist() == grid.counts.tolist()


def test_more_variables_than_cells_share_one_cell():
    counter = SumCounts([True] * 5, 4, 1.0)
    torch.testing.assert_close(counter.bonus(torch.randn(4, 5)), torch.full((4,), 0.5))
    counter.bonus(torch.full((1, 5), 1e5))
    assert counter.counts.tolist() == [5]


def test_what_is_not_finite_is_not_counted_and_earns_nothing():
    counter = SumCounts([True, True], 100, 0.01)
    bonus = counter.bonus(torch.tensor([[0.0, 1.0], [float("nan"), 1.0], [0.0, float("-inf")]]))
    assert bonus.tolist() == [pytest.approx(0.01), 0.0, 0.0]
    assert counter.bonus(torch.full((2, 2), float("nan"))).tolist() == [0.0, 0.0]
    assert int(counter.counts.sum()) == int(counter.state()["visits"].sum()) == 1


@pytest.mark.parametrize("cut", [0, 1, 3, 6])
def test_counts_continue_from_a_state(cut):
    steps = [torch.randn(16, 2, generator=torch.Generator().manual_seed(i)) * (1 + i) for i in range(7)]
    whole, first, second = (SumCounts([True, False], 100, 0.01) for _ in range(3))
    expected = [whole.bonus(step).tolist() for step in steps]
    for step in steps[:cut]:
        first.bonus(step)
    second.load_state(first.state())
    assert second.counts.tolist() == first.counts.tolist()
    assert [second.bonus(step).tolist() for step in steps[cut:]] == expected[cut:]
    for name, value in whole.state().items():
        assert torch.equal(second.state()[name], value)


def test_taking_a_state_changes_nothing():
    steps = [torch.randn(8, 2, generator=torch.Generator().manual_seed(i)) * (1 + i) for i in range(5)]
    watched, alone = SumCounts([True, True], 30, 0.01), SumCounts([True, True], 30, 0.01)
    for step in steps:
        state = watched.state()
        state["visits"].zero_()
        assert watched.bonus(step).tolist() == alone.bonus(step).tolist()


def test_the_table_has_one_row_for_a_joint_cell_however_often_it_is_visited(monkeypatch):
    monkeypatch.setattr(sums_module, "_BUFFERED_STEPS", 8)
    counter = SumCounts([True, True], 7, 0.01)
    corners = torch.tensor([[0.0, 0.0], [0.0, 3.0], [3.0, 0.0]])
    for _ in range(100):
        counter.bonus(corners)
        assert len(counter._buffer) < 8
    state = counter.state()
    # cells of 4 x 4 joint bins, row by row: (0, 0), (0, 3) and (3, 0)
    assert state["joint"].tolist() == [0, 3, 12]
    assert state["visits"].tolist() == [100, 100, 100]


def test_tables_are_folded_ever_more_rarely_while_they_grow(monkeypatch):
    # Eight new joint cells a step. A fold is due when the buffer is at least as long as the table, so the table doubles
    # from fold to fold: 2 steps, then 2 more, 4 more, 8 more, ...
    monkeypatch.setattr(sums_module, "_BUFFERED_STEPS", 2)
    counter = SumCounts([True, True], 1999, 0.01)
    counter.bonus(torch.tensor([[0.0, 0.0], [999.0, 999.0]]))
    counter.state()
    lengths = []
    for step in range(64):
        counter.bonus(torch.tensor([[float(step), float(other)] for other in range(1, 9)]))
        lengths.append(len(counter._joint))
    folds = [(old, new) for old, new in pairwise(lengths) if new != old]
    assert 3 <= len(folds) <= 6
    assert all(new >= 2 * old for old, new in folds)


def test_joint_cells_that_an_integer_cannot_hold_are_refused():
    # 2 bins of 63 variables are 2^63 cells, numbered 0 .. 2^63 - 1; of 64 they are too many
    assert ProgressBins([True] * 63, 2).decode(torch.tensor([2**63 - 1])).tolist() == [[1] * 63]
    with pytest.raises(ValueError, match="lower the number of cells"):
        ProgressBins([True] * 64, 2)
    # the counter itself: 234 bins of 8 variables fit, 1 872 cells of 8 variables; 235 do not
    assert SumCounts([True] * 8, 1872, 1.0).space.bins == 234
    with pytest.raises(ValueError, match="found 235 bins for each of 8"):
        SumCounts([True] * 8, 1873, 1.0)


@given(st.integers(1, 50), st.lists(st.lists(st.integers(0, 10**6), min_size=3, max_size=3), min_size=1, max_size=5))
def test_joint_cells_are_decoded_as_they_were_encoded(bins, rows):
    space = ProgressBins([True] * 3, bins)
    indices = torch.tensor(rows) % bins
    assert space.decode(space.encode(indices)).tolist() == indices.tolist()
