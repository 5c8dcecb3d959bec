"""LCM as a link: its messages, and the network that they are on."""
