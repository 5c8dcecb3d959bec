"""`gridpush bench reality`: every set of real pushes, predicted by models and simulators."""
