"""The long description of a built package: README without links into the repository.

A package index shows README as its page. There, links to files of the repository lead nowhere and
its pictures are missing, for the repository has no fixed public address yet. Hatchling calls the
hook when it builds a wheel or a source distribution; see `pyproject.toml`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

try:
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ModuleNotFoundError:  # a test converts README where hatchling is not installed
    MetadataHookInterface = object  # type: ignore[assignment,misc]

README = "README.md"

INSIDE = r"\((?!https?:|mailto:|#)[^)\s]+\)"
"""Target of a link that is neither an address on the web nor a place on the same page."""

PICTURE = re.compile(rf"^!\[[^\]]*\]{INSIDE}\n+", re.MULTILINE)
"""A picture of the repository, which has a paragraph of its own."""

LINK = re.compile(rf"\[([^\]]*)\]{INSIDE}")
"""A link to a file of the repository."""


def make_long_description(text: str) -> str:
    """Takes pictures of the repository out of a page, and leaves of links into it their words."""
    return LINK.sub(r"\1", PICTURE.sub("", text))


class CustomMetadataHook(MetadataHookInterface):
    """Sets the long description of a package that is built."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Adds it to the other metadata."""
        text = (Path(self.root) / README).read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": make_long_description(text),
        }
