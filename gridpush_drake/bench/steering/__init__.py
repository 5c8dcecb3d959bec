"""How well learned objects are pushed with feedback, along paths and to goals."""
