"""Packages that only some uses need, and that are installed with one of the project's extras.

`pyproject.toml` has the extras. A module that needs one of these packages imports it by
`import_extra`, so that whoever lacks it reads what to install.
"""

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from gridpush_drake.errors import MissingExtraError


def is_installed(package: str) -> bool:
    """Whether a package that an extra installs is there."""
    return find_spec(package) is not None


def import_extra(package: str, extra: str) -> ModuleType:
    """Imports a package that an extra installs.

    Args:
        package: the package's name in Python.
        extra: the extra that installs it.

    Returns:
        The package.

    Raises:
        MissingExtraError: the package is not installed; the message names the extra.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise MissingExtraError(
            f"{package}: is not installed; expected pip install '.[{extra}]', in a clone of the "
            "repository"
        ) from error
