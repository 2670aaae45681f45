"""What the exploration bonus means: bins, cells, counts, lifetimes and rarity by pencil, with asymmetric numbers."""

import pytest
import torch

from porse.exploration import Counts, ProgressSpace, SimHash, Visits, literal, relative
from porse.exploration.bins import bins_per_summand, bins_per_variable, centre_and_unit, unit_edges
from porse.exploration.simhash import hash_codes


def doubles(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def no_ends(cells):
    return torch.zeros(cells.shape, dtype=torch.bool)


# Bins of one variable.


def test_centre_and_unit_are_the_median_and_a_quarter_of_the_95_percent_quantile():
    # 20 values; the 10th is 1; distances from it: 19 up to 8, and 992: the 19th of 20 is 8, so s = 2
    values = torch.tensor([1.0] * 12 + [-7.0, 9.0, 5.0, 3.0, 8.5, 2.0, 993.0, -4.0], dtype=torch.float64)
    assert centre_and_unit(values) == (1.0, 2.0)
    # of an even number the lower one of the two in the middle
    assert centre_and_unit(doubles(10.0, 30.0, 20.0, 40.0).flatten()) == (20.0, 5.0)


def test_the_quantile_is_the_190th_of_200():
    # median 0, 189 values at most 2 from it, then one at 8, one at 16 and nine far off
    values = doubles(*([0.0] * 150 + [2.0] * 39 + [8.0, -16.0] + [400.0, -400.0] * 4 + [400.0])).flatten()
    assert centre_and_unit(values) == (0.0, 2.0)


def test_what_does_not_vary_has_bins_of_a_thousandth_of_it():
    # 2^-10 up to 1, times the value beyond
    assert centre_and_unit(doubles(0.25, 0.25, 0.25).flatten()) == (0.25, 2.0**-10)
    assert centre_and_unit(doubles(-12.0, -12.0).flatten()) == (-12.0, 12.0 * 2.0**-10)
    # a spread of 0.002 / 4 is less than 2^-10, one of 0.02 / 4 is not
    assert centre_and_unit(doubles(0.0, 0.0, 0.002).flatten()) == (0.0, 2.0**-10)
    assert centre_and_unit(doubles(0.0, 0.0, 0.02).flatten()) == (0.0, 0.005)


def test_edges_are_even_steps_of_asinh_up_to_a_thousand():
    # asinh(1000) = 7.6009; of 4 bins the edges are at half of it on both sides and at 0: sinh(3.80045) = 22.35
    assert unit_edges(4) == pytest.approx((-22.349, 0.0, 22.349), abs=1e-3)
    # of 5: sinh(7.6009 / 5) = 2.177 and sinh(3 x 1.52018) = 47.81
    assert unit_edges(5) == pytest.approx((-47.81, -2.177, 2.177, 47.81), abs=5e-3)
    assert (unit_edges(1), unit_edges(2)) == ((), (0.0,))


def test_a_value_lies_in_the_bin_whose_lower_edge_it_has_reached():
    space = ProgressSpace([True], 4, "grid")
    # 20 values: m = 3, s = 8 / 4 = 2; edges 3 - 44.70, 3, 3 + 44.70
    space.locate(torch.tensor([[3.0] * 18 + [11.0, 11.0]]).unsqueeze(-1))
    values = torch.tensor([[-1e30, -41.8, -41.6, 2.9999, 3.0, 47.6, 47.8, 1e30]]).unsqueeze(-1)
    assert space.locate(values).tolist() == [[0, 0, 1, 1, 2, 2, 3, 3]]
    assert space.state()["bins"].tolist() == [[3.0, 2.0]]


def test_bins_stay_as_the_first_values_fixed_them_until_they_are_forgotten():
    space = ProgressSpace([True], 4, "grid")
    first, later = torch.tensor([[[3.0]] * 19 + [[11.0]]]), torch.tensor([[[100.0]]] * 3)
    space.locate(first)
    space.locate(later)
    assert space.state()["bins"].tolist() == [[3.0, 2.0**-10 * 3.0]]
    space.forget()
    assert not space.is_fitted
    space.locate(later)
    assert space.state()["bins"].tolist() == [[100.0, 100.0 * 2.0**-10]]


def test_states_that_are_not_finite_fix_no_bins():
    space = ProgressSpace([True, True], 100, "grid")
    nan, inf = float("nan"), float("inf")
    assert space.locate(torch.tensor([[[nan, 5.0], [inf, 6.0]]])).tolist() == [[-1, -1]]
    assert not space.is_fitted
    space.locate(torch.tensor([[[nan, 5.0], [2.0, 7.0]]]))
    assert space.state()["bins"][:, 0].tolist() == [2.0, 7.0]


# Cells of several variables.


def test_a_grid_has_a_cell_for_each_combination_and_a_sum_adds_the_bins():
    # 4 bins each, m = 0 and s = 1 of both, edges -22.3, 0, 22.3; the second variable falls and is turned
    first = torch.tensor([[[0.0, 0.0]] * 18 + [[4.0, 4.0]] * 2])
    states = torch.tensor([[[-30.0, 30.0], [-30.0, -30.0], [-1.0, -9.0], [9.0, 9.0], [30.0, -30.0]]])
    # bins (0, 0), (0, 3), (1, 2), (2, 1), (3, 3)
    grid = ProgressSpace([True, False], 16, "grid")
    grid.locate(first)
    assert grid.locate(states).tolist() == [[0, 3, 6, 9, 15]]
    added = ProgressSpace([True, False], 7, "sum")
    added.locate(first)
    assert added.locate(states).tolist() == [[0, 3, 3, 3, 6]]
    assert (grid.cells, added.cells, grid.bins, added.bins) == (16, 7, 4, 4)


def test_bins_fill_the_cells_of_a_grid_and_of_a_sum():
    # grid: 3^4 = 81 <= 100 < 4^4; sum: 4 (25 - 1) + 1 = 97 <= 100 < 4 x 25 + 1
    assert bins_per_variable(100, 4) == 3
    assert bins_per_summand(100, 4) == 25
    assert (bins_per_variable(8, 3), bins_per_variable(7, 3)) == (2, 1)
    assert (bins_per_summand(101, 4), bins_per_summand(10, 1)) == (26, 10)


# Counts.


def test_a_step_is_counted_whole_before_it_is_read():
    counts = Counts(5, 3, False)
    cells = torch.tensor([[1, 1, 4], [1, 2, -1]])
    visits = counts.count(cells, no_ends(cells))
    # first step: two meet in cell 1, one in 4; second: a third visit of 1, a first of 2, and one that is not counted
    assert visits.own.tolist() == [[2, 2, 1], [3, 1, 0]]
    # 3 visits of 2 cells, then 5 visits of 3 cells, for all environments alike
    assert visits.mean.tolist() == [[1.5] * 3, [pytest.approx(5 / 3)] * 3]
    assert counts.table.tolist() == [0, 3, 1, 0, 1]
    assert (visits.new_cells, counts.share_visited) == (3, 0.6)
    again = counts.count(torch.tensor([[1, 4, 3]]), no_ends(torch.zeros(1, 3)))
    # 8 visits of 4 cells
    assert again.own.tolist() == [[4, 2, 1]]
    assert again.mean.tolist() == [[2.0] * 3]
    assert (again.new_cells, counts.share_visited) == (1, 0.8)


def test_where_nothing_was_ever_counted_the_mean_of_the_visits_is_zero():
    for each_episode in (False, True):
        counts = Counts(5, 2, each_episode)
        cells = torch.tensor([[-1, -1], [3, -1]])
        visits = counts.count(cells, no_ends(cells))
        assert visits.own.tolist() == [[0, 0], [1, 0]]
        # then one visit of one cell: the environments share it, or the second still has none
        assert visits.mean.tolist() == [[0.0, 0.0], [1.0, 0.0 if each_episode else 1.0]]


def test_an_episodes_counts_are_each_environments_own_and_end_with_it():
    counts = Counts(5, 2, True)
    cells = torch.tensor([[1, 1], [1, 3], [1, 1]])
    ends = torch.tensor([[False, False], [True, False], [False, False]])
    visits = counts.count(cells, ends)
    # the first ends after two visits of 1 and begins anew; the second goes on: 1, 3, 1
    assert visits.own.tolist() == [[1, 1], [2, 1], [1, 2]]
    assert visits.mean.tolist() == [[1.0, 1.0], [2.0, 1.0], [1.0, 1.5]]
    assert counts.table.tolist() == [[0, 1, 0, 0, 0], [0, 2, 0, 1, 0]]
    # cells that anybody ever visited: 1 and 3
    assert (visits.new_cells, counts.share_visited) == (2, 0.4)


def test_forgotten_counts_are_none():
    counts = Counts(5, 2, False)
    cells = torch.tensor([[1, 2]])
    counts.count(cells, no_ends(cells))
    counts.forget()
    assert (counts.table.tolist(), counts.share_visited) == ([0] * 5, 0.0)
    visits = counts.count(cells, no_ends(cells))
    assert (visits.own.tolist(), visits.mean.tolist(), visits.new_cells) == ([[1, 1]], [[1.0, 1.0]], 2)


def test_a_state_is_a_copy():
    counts = Counts(3, 2, False)
    cells = torch.tensor([[0, 2]])
    counts.count(cells, no_ends(cells))
    state = counts.state()
    counts.count(cells, no_ends(cells))
    assert state["counts"].tolist() == [1, 0, 1]
    counts.load_state(state)
    counts.count(cells, no_ends(cells))
    assert state["counts"].tolist() == [1, 0, 1]
    assert counts.table.tolist() == [2, 0, 2]


# Rarity.


def test_the_literal_bonus_falls_with_the_root_of_the_visits():
    visits = Visits(torch.tensor([[1, 4], [9, 0]]), doubles([7.0, 7.0], [7.0, 7.0]), 0)
    found = literal(visits)
    assert found.flatten().tolist() == pytest.approx([1.0, 0.5, 1 / 3, 0.0], rel=1e-6)
    assert found.dtype == torch.float32


def test_the_relative_bonus_is_one_where_a_cell_has_average_visits():
    # sqrt(12 / 12), sqrt(12 / 3), sqrt(12 / 48), and nothing for what is not counted
    visits = Visits(torch.tensor([[12, 3], [48, 0]]), doubles([12.0, 12.0], [12.0, 12.0]), 0)
    found = relative(visits)
    assert found.flatten().tolist() == pytest.approx([1.0, 2.0, 0.5, 0.0], rel=1e-6)
    # before anything is counted nothing is paid either
    assert relative(Visits(torch.tensor([[0]]), doubles([0.0]), 0)).tolist() == [[0.0]]


# Hashes.


def test_the_first_row_of_the_projection_is_the_lowest_bit():
    projection = doubles([1.0, 0.0], [0.0, 1.0], [-1.0, -1.0])
    # x >= 0 is 1, y >= 0 is 2, x + y <= 0 is 4
    states = torch.tensor([[1.0, 2.0], [1.0, -2.0], [-1.0, 2.0], [-1.0, -2.0], [-1.0, 1.0]])
    assert hash_codes(states, projection).tolist() == [3, 5, 2, 4, 6]


def test_a_hash_is_drawn_by_its_own_seed_alone():
    expected = torch.randn((3, 2), generator=torch.Generator().manual_seed(12), dtype=torch.float64)
    assert torch.equal(SimHash(2, 3, 12).projection, expected)
    assert SimHash(2, 3, 12).cells == 8
