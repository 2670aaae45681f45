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
    """Returns the epochs of one short training of the search of alpha, at least 1."""
    return max(1, round(params.probe.share * rung_epochs(params)))


def alpha_is_searched(params: Params, iteration: int) -> bool:
    """Returns whether the candidates of an iteration are trained with several values of alpha first (ROSKA)."""
    return params.probe.trainings > 0 and iteration > 1
