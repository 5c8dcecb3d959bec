"""What cross-validation may choose between."""

import numpy as np

from gridpush_drake.identification.map_ensemble import MapEnsemble


class Problem:
    """Cell errors that grow with the distance from what was learned, z = 1, times a scale."""

    def __init__(self, scale):
        self._scale = scale

    def residuals(self, z):
        return z

    def calc_cell_errors(self, z):
        return 1e-3 + self._scale * np.abs(1.0 - z)


def explained(scale):
    return MapEnsemble()._explains(Problem(scale), np.zeros(4), np.ones(4)).tolist()


def test_every_mixture_counts_where_all_explain_the_pushes():
    assert explained(4e-3) == [True] * 5


def test_a_mixture_that_predicts_no_training_push_does_not_count():
    assert explained(20e-3) == [False, False, False, True, True]


def test_what_was_learned_always_counts():
    assert explained(1.0)[-1]
