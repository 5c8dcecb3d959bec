"""Bodies in MuJoCo that do not obey the model: made, pushed, learned, and pushed over a table's edge."""
