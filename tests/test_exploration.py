"""The affordance state space and its counts as properties: outliers, values that are no numbers, splits, lifetimes."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from porse.exploration import Counts, ProgressSpace, literal, relative
from porse.exploration.bins import bins_per_summand, bins_per_variable, centre_and_unit, unit_edges

FLOATS = st.floats(-1e6, 1e6, allow_nan=False, width=32)
ANY_FLOATS = st.floats(width=32)


def normal(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def no_ends(cells):
    return torch.zeros(cells.shape, dtype=torch.bool)


def test_the_bins_fill_the_cells_and_no_more():
    # 1000 = 10^3; 31^2 = 961 < 1000 < 32^2; 5^4 = 625 < 1000 < 6^4
    assert [bins_per_variable(1000, d) for d in (1, 2, 3, 4)] == [1000, 31, 10, 5]
    # 1 x 999 + 1 = 1000; 2 x 499 + 1 = 999; 3 x 333 + 1 = 1000; 8 x 124 + 1 = 993, and 8 x 125 + 1 = 1001 are too many
    assert [bins_per_summand(1000, d) for d in (1, 2, 3, 8)] == [1000, 500, 334, 125]
    assert [ProgressSpace([True] * d, 1000, "grid").cells for d in (1, 2, 3, 4)] == [1000, 961, 1000, 625]
    assert [ProgressSpace([True] * d, 1000, "sum").cells for d in (1, 2, 3, 8)] == [1000, 999, 1000, 993]


@given(st.integers(2, 2000), st.integers(1, 40))
def test_no_larger_number_of_bins_would_fit(cells, variables):
    bins = bins_per_summand(cells, variables)
    assert variables * (bins - 1) + 1 <= cells < variables * bins + 1
    bins = bins_per_variable(cells, variables)
    assert bins**variables <= cells < (bins + 1) ** variables


@pytest.mark.parametrize("bins", [1, 2, 3, 10, 31, 1000])
def test_edges_are_even_in_asinh_between_the_ends(bins):
    edges = unit_edges(bins)
    top = math.asinh(1000.0)
    expected = [math.sinh(top * (2 * index - bins) / bins) for index in range(1, bins)]
    assert edges == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert [-edge for edge in reversed(edges)] == list(edges)


@pytest.mark.parametrize("discretiser", ["grid", "sum"])
@pytest.mark.parametrize("variables", [1, 2, 3])
@pytest.mark.parametrize("epoch", [0, 1])
def test_one_value_a_thousand_times_too_large_costs_a_tenth_of_the_resolution_at_most(discretiser, variables, epoch):
    """Resolution: cells that the 95 % of states nearest to the median lie in, after two epochs."""
    epochs = [normal(32, 128, variables, seed=seed) + 3.0 for seed in (1, 2)]
    ordinary = torch.cat(epochs).reshape(1, -1, variables)
    near = (ordinary - 3.0).abs().amax(dim=-1) < 1.96

    def resolution(spoiled):
        space = ProgressSpace([True] * variables, 1000, discretiser)
        for index, values in enumerate(epochs):
            values = values.clone()
            if spoiled and index == epoch:
                values[7, 5] *= 1000.0
            space.locate(values)
        return len(set(space.locate(ordinary)[near].tolist()))

    clean = resolution(False)
    assert clean >= {1: 200, 2: 50, 3: 20}[variables] or discretiser == "sum"
    assert resolution(True) >= 0.9 * clean


def test_half_of_the_values_could_lie_before_bins_follow_an_outlier():
    values = normal(4096).double()
    centre, unit = centre_and_unit(values)
    # four percent of them a million times too large move the quantile, but not by their size
    spoiled = values.clone()
    spoiled[::25] *= 1e6
    other_centre, other_unit = centre_and_unit(spoiled)
    assert abs(other_centre - centre) < 0.1
    assert unit <= other_unit < 2.0 * unit


@given(st.lists(st.tuples(ANY_FLOATS, ANY_FLOATS), min_size=1, max_size=30), st.sampled_from(["grid", "sum"]))
@settings(deadline=None, max_examples=200)
def test_every_finite_state_has_a_cell_and_no_other_one_has(rows, discretiser):
    space = ProgressSpace([True, False], 60, discretiser)
    cells = space.locate(torch.tensor([rows]))[0].tolist()
    for row, cell in zip(rows, cells, strict=True):
        assert (0 <= cell < space.cells) if all(map(math.isfinite, row)) else cell == -1
    assert space.is_fitted == any(cell >= 0 for cell in cells)


@given(st.lists(FLOATS, min_size=1, max_size=40), st.integers(1, 60))
@settings(deadline=None, max_examples=200)
def test_a_larger_value_has_no_lower_bin_and_cells_never_change(values, bins):
    space = ProgressSpace([True], bins, "grid")
    rising = torch.tensor(sorted(values)).reshape(1, -1, 1)
    first = space.locate(rising)
    assert first[0].tolist() == sorted(first[0].tolist())
    space.locate(1e6 * rising)
    assert torch.equal(space.locate(rising), first)


def test_a_falling_variable_is_turned_round():
    rising, falling = (ProgressSpace([up], 8, "grid") for up in (True, False))
    values = normal(4, 5, 1)
    assert torch.equal(rising.locate(values), falling.locate(-values))


@given(
    st.lists(st.lists(st.integers(-1, 6), min_size=3, max_size=3), min_size=2, max_size=12),
    st.booleans(),
    st.integers(0, 2**31 - 1),
)
@settings(deadline=None, max_examples=200)
def test_counts_are_those_of_a_dictionary(steps, each_episode, seed):
    """The same rules in plain Python: after each step of all environments, N, and the mean over the visited cells."""
    cells = torch.tensor(steps)
    ends = torch.rand(cells.shape, generator=torch.Generator().manual_seed(seed)) < 0.3
    counts = Counts(7, 3, each_episode)
    cut = len(steps) // 2
    found = [counts.count(cells[:cut], ends[:cut]), counts.count(cells[cut:], ends[cut:])]
    own = torch.cat([visits.own for visits in found]).tolist()
    mean = torch.cat([visits.mean for visits in found])
    books = [{}, {}, {}] if each_episode else [{}] * 3
    ever = set()
    for step, row in enumerate(steps):
        for book, cell in zip(books, row, strict=True):
            if cell >= 0:
                book[cell] = book.get(cell, 0) + 1
                ever.add(cell)
        for env, (book, cell) in enumerate(zip(books, row, strict=True)):
            assert own[step][env] == (book[cell] if cell >= 0 else 0)
            assert mean[step][env].item() == pytest.approx(sum(book.values()) / max(1, len(book)))
        if each_episode:
            for env in ends[step].nonzero().flatten().tolist():
                books[env] = {}
    assert sum(visits.new_cells for visits in found) == len(ever)
    assert counts.share_visited == len(ever) / 7


@pytest.mark.parametrize("each_episode", [False, True])
@pytest.mark.parametrize("cut", [0, 1, 4, 9])
def test_counts_and_bins_continue_from_a_state(each_episode, cut):
    progress = [normal(6, 4, 2, seed=seed) * (1 + seed) for seed in range(9)]
    ends = [torch.rand(6, 4, generator=torch.Generator().manual_seed(seed)) < 0.1 for seed in range(9)]

    def made():
        space = ProgressSpace([True, False], 50, "grid")
        return space, Counts(space.cells, 4, each_episode)

    def paid(space, counts, epochs):
        visits = [counts.count(space.locate(progress[epoch]), ends[epoch]) for epoch in epochs]
        return [(literal(v).tolist(), relative(v).tolist(), v.new_cells) for v in visits]

    whole, first, second = made(), made(), made()
    expected = paid(*whole, range(9))
    assert paid(*first, range(cut)) == expected[:cut]
    for old, new in zip(first, second, strict=True):
        new.load_state(old.state())
    assert paid(*second, range(cut, 9)) == expected[cut:]
    for old, new in zip(whole, second, strict=True):
        for name, value in old.state().items():
            assert torch.equal(new.state()[name], value)


def test_states_of_other_shapes_are_refused():
    one, two = ([True], [True] * 2)
    for have, want in ((one, two), (two, one)):
        with pytest.raises(ValueError, match=f"of {len(have)} progress variables, not of {len(want)}"):
            ProgressSpace(want, 9, "grid").load_state(ProgressSpace(have, 9, "grid").state())
    with pytest.raises(ValueError, match=r"\(3, 7\) numbers, not \(7,\)"):
        Counts(7, 3, False).load_state(Counts(7, 3, True).state())
    with pytest.raises(ValueError, match=r"\(7,\) numbers, not \(3, 7\)"):
        Counts(7, 3, True).load_state(Counts(7, 3, False).state())
    # as many counts, and another number of cells beside them
    for cells in (5, 9):
        visited = torch.zeros(cells, dtype=torch.bool)
        with pytest.raises(ValueError, match=r"\(7,\) numbers, not \(7,\)"):
            Counts(7, 3, False).load_state({**Counts(7, 3, False).state(), "visited": visited})


def test_the_cost_of_a_count_does_not_grow_with_the_steps_taken():
    counts = Counts(50, 4, False)
    sizes = set()
    for seed in range(20):
        cells = torch.randint(0, 50, (5, 4), generator=torch.Generator().manual_seed(seed))
        counts.count(cells, no_ends(cells))
        sizes.add(tuple(value.numel() for value in counts.state().values()))
    assert sizes == {(50, 50)}
    assert int(counts.table.sum()) == 400
