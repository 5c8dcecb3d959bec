"""A camera calibrated by tags, and scale by a sheet of paper."""
