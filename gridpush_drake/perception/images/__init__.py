"""Cameras, frames and depth, and the table in a picture."""
