"""`Bus`: what `HardwareLink`, `TwinLink` and `PictureTracker` need of a network for messages."""

from collections.abc import Callable
from typing import Any, Protocol


class Bus(Protocol):
    """A network for LCM messages: Drake's `DrakeLcm`, or a `LinkBus` before another network."""

    def Subscribe(self, channel: str, handler: Callable[[bytes], None]) -> Any:
        """Has a handler take all messages of a channel."""

    def Publish(self, channel: str, buffer: bytes) -> None:
        """Sends a message."""

    def HandleSubscriptions(self, timeout_millis: int) -> int:
        """Hands on what has come; waits up to so many milliseconds where nothing has."""
