"""A robot: its file, its measures, its postures and the driver of its joints."""
