"""Commands that read and make pushes, and learn from them."""
