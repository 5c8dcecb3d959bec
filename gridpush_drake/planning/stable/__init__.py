"""Stable pushes, under which an object goes with the pusher, and paths of such pushes."""
