import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from porse.exploration.ranges import Range, first_range, grow
from porse.exploration.visits import VisitCounts, bins_per_variable

FLOATS = st.floats(-1e6, 1e6, allow_nan=False, width=32)


def test_the_bins_fill_the_cells_and_no_more():
    # 1000 = 10^3; 31^2 = 961 < 1000 < 32^2; 5^4 = 625 < 1000 < 6^4
    assert [bins_per_variable(1000, d) for d in (1, 2, 3, 4)] == [1000, 31, 10, 5]


def test_growing_upward_merges_pairs_from_below():
    # [0, 4) in bins of 1 -> [0, 8) in bins of 2: bins 0 and 1 become bin 0, bins 2 and 3 become bin 1.
    assert grow(Range(0.0, 1.0, 4), 5.0) == (Range(0.0, 2.0, 4), [0, 0, 1, 1])


def test_growing_downward_merges_pairs_from_above():
    # [0, 4) -> [-4, 4) in bins of 2: bins 2 and 3 become bin 3, bins 0 and 1 become bin 2.
    assert grow(Range(0.0, 1.0, 4), -0.5) == (Range(-4.0, 2.0, 4), [2, 2, 3, 3])


@given(st.lists(FLOATS, min_size=1, max_size=30), st.integers(2, 40))
@settings(deadline=None, max_examples=200)
def test_merged_counts_are_the_counts_that_the_last_range_would_have_given(values, bins):
    counts = VisitCounts([True], bins, 1.0)
    for value in values:
        counts.bonus(torch.tensor([[value]]))
    [last] = counts.space.ranges
    expected = torch.bincount(last.index(torch.tensor(values, dtype=torch.float64)), minlength=bins)
    assert counts.counts.tolist() == expected.tolist()


@given(FLOATS, st.floats(0, 1e3, width=32), st.integers(2, 100))
@settings(deadline=None)
def test_a_first_range_covers_its_values(low, spread, bins):
    covered = first_range(low, low + spread, bins)
    assert covered.low <= low
    assert low + spread < covered.high


def test_the_bonus_is_lambda_over_the_root_of_the_visits_after_counting():
    visits = VisitCounts([True], 10, 0.01)
    # Three environments in one cell, one alone: 0.01 / sqrt(3) and 0.01 / sqrt(1).
    bonus = visits.bonus(torch.tensor([[0.0], [0.0], [0.0], [9.0]]))
    torch.testing.assert_close(bonus, torch.tensor([0.01 / 3**0.5] * 3 + [0.01]))
    bonus = visits.bonus(torch.tensor([[0.0]]))
    torch.testing.assert_close(bonus, torch.tensor([0.01 / 4**0.5]))


def test_a_falling_variable_is_turned_round():
    rising, falling = VisitCounts([True], 8, 1.0), VisitCounts([False], 8, 1.0)
    values = torch.tensor([[0.0], [1.0], [7.0]])
    rising.bonus(values)
    falling.bonus(-values)
    assert rising.counts.tolist() == falling.counts.tolist()


def test_what_is_not_finite_is_not_counted_and_earns_nothing():
    visits = VisitCounts([True, True], 100, 0.01)
    bonus = visits.bonus(torch.tensor([[0.0, 1.0], [float("nan"), 1.0], [0.0, float("inf")]]))
    assert bonus.tolist()[1:] == [0.0, 0.0]
    assert int(visits.counts.sum()) == 1
    assert visits.bonus(torch.full((2, 2), float("nan"))).tolist() == [0.0, 0.0]


def test_counts_continue_from_a_state():
    steps = [torch.randn(16, 2, generator=torch.Generator().manual_seed(i)) * (1 + i) for i in range(6)]
    whole, first = VisitCounts([True, False], 100, 0.01), VisitCounts([True, False], 100, 0.01)
    expected = [whole.bonus(step) for step in steps]
    for step in steps[:3]:
        first.bonus(step)
    second = VisitCounts([True, False], 100, 0.01)
    second.load_state(first.state())
    assert [second.bonus(step).tolist() for step in steps[3:]] == [bonus.tolist() for bonus in expected[3:]]


def test_an_untouched_counter_has_a_state_too():
    fresh = VisitCounts([True], 100, 0.01)
    fresh.load_state(VisitCounts([True], 100, 0.01).state())
    assert int(fresh.counts.sum()) == 0
    fresh.bonus(torch.tensor([[1.0]]))
    assert int(fresh.counts.sum()) == 1
