"""What is learned: parameters, their spread, and what cannot be known.

`learning` has `identify` and `baselines` the searches that it is compared with. The theory is written out in
`docs/theory/identification.md`. The names below are imported on first use.
"""

from typing import TYPE_CHECKING

from gridpush_drake.lazy import make_lazy_names

if TYPE_CHECKING:
    from gridpush_drake.identification.identifiability import Identifiability
    from gridpush_drake.identification.learning import METHODS, describe_prior, identify
    from gridpush_drake.identification.map_ensemble import MapEnsemble
    from gridpush_drake.identification.map_fit import NoiseModel
    from gridpush_drake.identification.model_file import read_model, write_model
    from gridpush_drake.identification.posterior import Posterior
    from gridpush_drake.identification.prediction import predict
    from gridpush_drake.identification.result import Identification, IdentificationStatus

__all__ = [
    "METHODS",
    "Identifiability",
    "Identification",
    "IdentificationStatus",
    "MapEnsemble",
    "NoiseModel",
    "Posterior",
    "describe_prior",
    "identify",
    "predict",
    "read_model",
    "write_model",
]

_HOMES = {
    "METHODS": "learning",
    "Identifiability": "identifiability",
    "Identification": "result",
    "IdentificationStatus": "result",
    "MapEnsemble": "map_ensemble",
    "NoiseModel": "map_fit",
    "Posterior": "posterior",
    "describe_prior": "learning",
    "identify": "learning",
    "predict": "prediction",
    "read_model": "model_file",
    "write_model": "model_file",
}

__getattr__ = make_lazy_names(globals(), _HOMES)
