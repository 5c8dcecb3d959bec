"""Several objects on a table: pushed by one pusher, and by each other.

`kernels` has the compiled step and rollout, `docs/theory/model.md` the model (section 9).
"""
