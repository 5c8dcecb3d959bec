"""What an object is: cells, outline, per-cell parameters."""
