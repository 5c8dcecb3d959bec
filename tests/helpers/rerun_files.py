"""What is in a file of the Rerun viewer."""

import subprocess
import sys
from pathlib import Path

ENTITIES = (
    "/world/object",
    "/world/object/cells",
    "/world/object/center_of_mass",
    "/world/tip",
    "/world/push",
    "/known/pushes",
    "/known/center_of_mass_x_mm",
)
"""Entities that every run has in which something was learned."""


def print_rerun(path: Path) -> str:
    """Lets Rerun itself print what is in a file."""
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    return printed.stdout
