"""Doors to other frameworks: pushes as differentiable functions in JAX and in torch."""
