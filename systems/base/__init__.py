"""What other systems are made of: messages, workers, and the base of controllers."""
