"""`gridpush bench`: `group` has the list of the benches, and each has a file of its own."""
