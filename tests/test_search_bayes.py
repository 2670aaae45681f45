import dataclasses
import math

import pytest

from porse.config import ProbeParams
from porse.search import bayes
from porse.search.bayes import GRID, best_alpha, expected_improvement, initial_alphas, next_alpha

PARAMS = ProbeParams(trainings=14, initial=6, share=0.4, least_epochs=1, length=0.2, noise=1e-6, xi=0.01)


def matern(distance, length):
    """Matern-5/2 by hand: (1 + r + r^2 / 3) exp(-r), r = sqrt(5) distance / length."""
    r = math.sqrt(5) * distance / length
    return (1 + r + r * r / 3) * math.exp(-r)


def mean_excess(mean, deviation):
    z = mean / deviation
    return mean * (1 + math.erf(z / math.sqrt(2))) / 2 + deviation * math.exp(-z * z / 2) / math.sqrt(2 * math.pi)


def search(score, evaluations):
    tried = initial_alphas(6)
    scores = [score(alpha) for alpha in tried]
    while len(tried) < evaluations:
        tried.append(next_alpha(tried, scores, PARAMS))
        scores.append(score(tried[-1]))
    return tried, scores


def test_initial_alphas_are_spread_evenly_over_the_grid():
    assert initial_alphas(6) == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert initial_alphas(2) == [0.0, 1.0]
    # thirds are not on the grid of hundredths: their neighbours are
    assert initial_alphas(4) == [0.0, 0.33, 0.67, 1.0]
    assert initial_alphas(101) == list(GRID)


@pytest.mark.parametrize("count", [0, 1, 102])
def test_a_number_of_initial_alphas_that_the_grid_cannot_hold_is_refused(count):
    with pytest.raises(ValueError, match=f"found {count}"):
        initial_alphas(count)


@pytest.mark.parametrize(
    ("optimum", "score"),
    [
        (0.37, lambda a: -((a - 0.37) ** 2)),
        (0.71, lambda a: 300 * math.exp(-((a - 0.71) ** 2) / 0.02) - 7),
        (1.0, lambda a: math.sin(a)),
        (0.0, lambda a: -a),
        # sin(5 pi a) + a has its maxima near 0.1, 0.5 and 0.9; the last is the highest:
        # 5 pi cos(5 pi a) = -1, so 5 pi a = 4 pi + pi / 2 + 0.0637, a = 0.904
        (0.904, lambda a: math.sin(5 * math.pi * a) + a),
    ],
)
def test_fourteen_evaluations_find_the_optimum_of_a_smooth_function(optimum, score):
    tried, scores = search(score, 14)
    assert best_alpha(tried, scores) == pytest.approx(optimum, abs=0.02)


def test_nothing_is_proposed_twice_and_everything_is_on_the_grid():
    tried, _ = search(lambda a: round(a, 1), 101)
    assert sorted(tried) == list(GRID)
    with pytest.raises(ValueError, match="all 101 tried"):
        next_alpha(tried, [0.0] * 101, PARAMS)


def test_the_expected_improvement_after_one_score():
    # One score, standardised, is 0: mean 0 everywhere, variance 1 - k^2 / (1 + noise), best 0.
    params = dataclasses.replace(PARAMS, length=0.5, noise=0.25, xi=0.1)
    k = matern(0.3, 0.5)
    expected = mean_excess(-0.1, math.sqrt(1 - k * k / 1.25))
    assert expected_improvement([0.2], [42.0], [0.5], params) == pytest.approx([expected])


def test_the_expected_improvement_between_two_scores():
    # Scores 3 and 7 become -1 and 1. At 0.5 the two pull equally: mean 0, variance 1 - 2 k^2 / (1 + noise + k01).
    # At 0.75: mean (k1 - k0) / (1 + noise - k01), as (-1, 1) is an eigenvector of [[1 + noise, k01], [k01, 1 + noise]].
    params = dataclasses.replace(PARAMS, length=0.4, noise=0.1, xi=0.0)
    k, k01 = matern(0.5, 0.4), matern(1.0, 0.4)
    middle = mean_excess(-1.0, math.sqrt(1 - 2 * k * k / (1.1 + k01)))
    k0, k1 = matern(0.75, 0.4), matern(0.25, 0.4)
    mean = (k1 - k0) / (1.1 - k01)
    # the other eigenvector is (1, 1): variance = 1 - (k0 + k1)^2 / 2 / (1.1 + k01) - (k1 - k0)^2 / 2 / (1.1 - k01)
    variance = 1 - (k0 + k1) ** 2 / 2 / (1.1 + k01) - (k1 - k0) ** 2 / 2 / (1.1 - k01)
    right = mean_excess(mean - 1.0, math.sqrt(variance))
    assert expected_improvement([0.0, 1.0], [3.0, 7.0], [0.5, 0.75], params) == pytest.approx([middle, right])


def test_the_best_score_lies_as_many_deviations_above_the_mean_as_it_does():
    # 3, 4 and 7: mean 14 / 3, and distances -5 / 3, -2 / 3 and 7 / 3 from it, so a deviation of sqrt(78 / 27) and a best of
    # 7 / sqrt(26) deviations. Where no score reaches, mean 0 and variance 1 are expected.
    params = dataclasses.replace(PARAMS, length=0.01, xi=0.1)
    expected = mean_excess(-7 / math.sqrt(26) - 0.1, 1.0)
    assert expected_improvement([0.0, 0.3, 1.0], [3.0, 4.0, 7.0], [0.6], params) == pytest.approx([expected])


def test_units_of_the_scores_do_not_matter():
    tried, scores = initial_alphas(6), [0.0, 1.0, 3.0, 2.0, 1.0, 0.0]
    wanted = next_alpha(tried, scores, PARAMS)
    assert next_alpha(tried, [1e-200 * score for score in scores], PARAMS) == wanted
    assert next_alpha(tried, [1e6 * score - 5e6 for score in scores], PARAMS) == wanted


@pytest.mark.parametrize("constant", [0.0, 2.7, -1e9])
def test_equal_scores_send_the_search_where_it_knows_least(constant):
    # farthest from 0 is 1; farthest from 0 and 1 is 0.5
    assert next_alpha([0.0], [constant], PARAMS) == 1.0
    assert next_alpha([0.0, 1.0], [constant] * 2, PARAMS) == 0.5
    # Of the gaps between six points the outer two are least known, having points on one side only; 0.1 and 0.9 tie.
    assert next_alpha(initial_alphas(6), [constant] * 6, PARAMS) == 0.1


def test_equal_improvements_go_to_the_smallest_alpha():
    # a score with the mirror image of another: x and 1 - x are equally good
    assert next_alpha([0.0, 0.5, 1.0], [0.0, 1.0, 0.0], PARAMS) < 0.5
    # with nothing to gain anywhere, the smallest that is left
    assert next_alpha([0.0, 1.0], [0.0, 1.0], dataclasses.replace(PARAMS, length=0.2, noise=1e-6, xi=100.0)) == 0.01


def test_improvements_that_differ_in_the_tenth_decimal_are_equal_and_in_the_ninth_are_not(monkeypatch):
    for later, expected in ((0.5 + 4e-10, 0.02), (0.5 + 1e-9, 0.03)):
        gains = [0.1, 0.5, later, *[0.2] * 96]
        monkeypatch.setattr(bayes, "expected_improvement", lambda *_, gains=gains: gains)
        # 0 and 1 are tried: the gains are of 0.01, 0.02, 0.03, ...
        assert next_alpha([0.0, 1.0], [1.0, 2.0], PARAMS) == expected


def test_the_best_alpha_is_that_of_the_highest_score_and_the_largest_of_equals():
    assert best_alpha([0.0, 0.8, 0.2], [1.0, 3.0, 2.0]) == 0.8
    assert best_alpha([0.0, 0.8, 0.2], [1.0, 3.0, 3.0]) == 0.8


@pytest.mark.parametrize("scores", [[], [1.0], [1.0, 2.0, 3.0], [1.0, float("nan")], [1.0, float("-inf")]])
def test_scores_that_are_missing_or_not_finite_are_refused(scores):
    with pytest.raises(ValueError, match="finite score for each alpha"):
        next_alpha([0.0, 1.0], scores, PARAMS)
    with pytest.raises(ValueError, match="finite score for each alpha"):
        best_alpha([0.0, 1.0], scores)
