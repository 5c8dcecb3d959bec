"""The paper's own method and those it was compared with."""
