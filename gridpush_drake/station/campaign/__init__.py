"""Many episodes, their table, and their recordings as a LeRobot dataset."""
