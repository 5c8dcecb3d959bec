"""A scenario: its fields, and how its file is read and written."""
