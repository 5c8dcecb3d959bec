"""Drake LeafSystems, one a file: the LCP model, the identifier, and what pushes and shows."""
