"""How long trainings are: what `train-population` needs of the schedule, apart from it, so that the rest retrains nobody."""

from porse.config import Params


def rung_epochs(params: Params) -> int:
    """Returns the epochs of one rung: those of `train`, or as many times more as train.length says."""
    times = 1
    if params.train.length != "iteration":
        times *= len(params.iterations)
    if params.train.length == "budget":
        times *= params.generate.candidates
    return params.train.rung_epochs * times


def probe_epochs(params: Params) -> int:
    """Returns the epochs of one short training of the search of alpha: its share of a rung, or probe.least_epochs if more."""
    rung = rung_epochs(params)
    return min(rung, max(round(params.probe.share * rung), params.probe.least_epochs))


def probe_trainings(params: Params) -> int:
    """Returns how many values of alpha are tried for a candidate: probe.trainings, or fewer if those are longer than their share.

    Those that another one beats cost no more than their shares together, so that the search stays within its budget. Two are
    tried in any case.
    """
    most = params.probe.trainings
    thrown_away = (most - 1) * params.probe.share * rung_epochs(params)
    # Rounded first: a product of shares may lie a last bit below a whole number.
    return min(most, max(2, 1 + int(round(thrown_away / probe_epochs(params), 6))))


def spread_trainings(params: Params) -> int:
    """Returns how many of a candidate's alphas are evenly spread: of fewer trainings, the same part as of all."""
    most = params.probe.trainings
    return max(2, round(probe_trainings(params) * min(params.probe.initial, most) / most))


def alpha_is_searched(params: Params, iteration: int) -> bool:
    """Returns whether the candidates of an iteration are trained with several values of alpha first (ROSKA)."""
    return params.probe.trainings > 0 and iteration > 1
