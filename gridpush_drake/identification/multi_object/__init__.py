"""Several objects that are learned together."""
