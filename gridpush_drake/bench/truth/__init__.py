"""Bodies in MuJoCo that do not obey the model: how they are made, pushed and learned."""
