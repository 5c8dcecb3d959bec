"""Objects' poses followed from frame to frame."""
