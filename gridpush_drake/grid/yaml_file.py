"""YAML read strictly: no key twice, 1e-3 is a number, and errors that name the line."""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from gridpush_drake.errors import ObjectError


class _StrictLoader(yaml.SafeLoader):
    """Safe, refuses a key that occurs twice, and reads 1e-3 as YAML 1.2 does."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key.value}' occurs twice", key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)


_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def read_mapping(path: Path, what: str) -> dict[str, Any]:
    """Reads a YAML file whose top level is `key: value` lines.

    Args:
        path: the file.
        what: what it should hold, for messages ("an object file").

    Returns:
        The mapping.

    Raises:
        ObjectError: the file cannot be read, is not YAML, is empty, or is something else than a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
        data = yaml.load(text, Loader=_StrictLoader)
    except IsADirectoryError as error:
        raise ObjectError(f"{path}: is a folder; expected {what}") from error
    except OSError as error:
        raise ObjectError(f"{path}: cannot be read: {error.strerror}; expected {what}") from error
    except UnicodeDecodeError as error:
        raise ObjectError(f"{path}: is not UTF-8 text; expected {what}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ObjectError(f"{path}{where}: is not valid YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ObjectError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ObjectError(f"{path}: is nested too deeply; expected {what}") from error
    if data is None:
        raise ObjectError(f"{path}: is empty; expected {what}")
    if not isinstance(data, dict):
        raise ObjectError(f"{path}: is a {type(data).__name__} at its top level; expected {what}: `key: value` lines")
    return data
