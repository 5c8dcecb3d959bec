"""How well objects are found in photographs and tracked in videos."""
