"""What was observed: the push log, its CSV form, and importers for public data sets."""
