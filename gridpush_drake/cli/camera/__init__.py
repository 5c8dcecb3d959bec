"""Commands that look through a camera."""
