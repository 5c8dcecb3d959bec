"""How it moves: the LCP, the condensed step, pusher contact, gradients, rollout."""
