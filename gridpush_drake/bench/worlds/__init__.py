"""Worlds of Drake and MuJoCo in which benches push objects, and their names on the command line."""
