"""Contact of the pusher with an outline: distances, modes, and the walk round it."""
