"""What moves the robot and what it senses, as systems of a station."""
