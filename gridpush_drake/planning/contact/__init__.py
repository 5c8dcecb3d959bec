"""Contact-point optimization: where on the outline, in which direction and how far to push."""
