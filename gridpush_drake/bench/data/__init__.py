"""What benches learn from: the paper's protocol, and logs of real pushes."""
