"""The searches that `identify` knows by name: the paper's descent and the baselines it was compared with."""

from gridpush_drake.identification.baselines import (
    search_cma_es,
    search_finite_difference,
    search_nelder_mead,
    search_random,
    search_weighted,
)
from gridpush_drake.identification.paper import search_paper
from gridpush_drake.identification.search import SearchMethod

SEARCH_METHODS: dict[str, SearchMethod] = {
    "paper": search_paper,
    "random_search": search_random,
    "weighted_sampling": search_weighted,
    "finite_difference": search_finite_difference,
    "cma_es": search_cma_es,
    "nelder_mead": search_nelder_mead,
}
"""By name."""

DEFAULT_BUDGET_PER_PUSH = 100
"""Simulations of each training push where no budget is given."""
