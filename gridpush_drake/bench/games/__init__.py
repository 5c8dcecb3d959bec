"""How well players do in the Gymnasium environments and in PushT."""
