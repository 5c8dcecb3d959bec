"""YAML read strictly and within bounds, and checked against a schema.

Errors name the line or the field. No key stands twice. What is a number is decided as in YAML 1.2:
1e-3 is one, 010 is ten, and 1:30 and 1_000 are texts, as are yes, no, on and off. libyaml reads the
text where PyYAML has it, which is many times as fast.

An alias or a merge key of a few bytes can stand for billions of values. So a document is composed
first, which costs no more than its text, and measured with its aliases written out, before anything
is made of it.
"""

import gc
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from gridpush_drake.errors import GridPushError, ObjectError
from gridpush_drake.files import read_text
from gridpush_drake.units import BYTES_PER_MEGABYTE

MAX_YAML_SIZE = 64 * BYTES_PER_MEGABYTE
"""Largest size of a YAML file, bytes."""

MAX_NODES = 500_000
"""Largest number of keys and values in a document, its aliases written out. It is three times what
a mask's longest outline needs."""

MAX_LINES = 2_000_000
"""Largest number of lines of a document, blank ones included."""

MAX_DEPTH = 200
"""Largest number of lists and mappings within each other."""

MAX_NUMBER_LENGTH = 400
"""Largest number of characters of a number."""

MAX_PROBLEM = 160
"""Largest number of characters of PyYAML's complaint that a message repeats."""

MAX_SHOWN = 60
"""Largest number of characters of a refused value that a message repeats."""

KEYS_AND_VALUES = "`key: value` lines"
"""The expected form of a mapping of which a schema says nothing else."""

UNKNOWN_KEY = ("extra_forbidden", "invalid_key")
"""Pydantic's names for a key that the schema does not have. It is said first, for a misspelled key
explains a missing one."""

NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
"""Tags of numbers."""

NOT_YAML = (ValueError, LookupError, TypeError, AttributeError, OverflowError)
"""Errors that PyYAML raises, besides its own, on values that are not of the tag they have."""

_TOO_DEEP = "maximum nesting depth"
"""Part of libyaml's message about a document that is nested too deeply."""

_TOO_MANY = f"the document holds more than {MAX_NODES} keys and values"


class StrictSchema(BaseModel):
    """What a YAML mapping may hold: these keys and no others, each of its type, numbers finite.

    A field's `description` says in a message what is expected of it.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


Schema = TypeVar("Schema", bound=StrictSchema)


class _CoreResolver(yaml.resolver.BaseResolver):
    """Knows null, truth values, numbers and merge keys as YAML 1.2's core schema has them."""


_FORMS = (
    ("merge", r"<<", "<"),
    ("null", r"~|null|Null|NULL|", "~nN"),
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
        r"|[-+]?(\.inf|\.Inf|\.INF)|\.nan|\.NaN|\.NAN",
        "-+.0123456789",
    ),
)
"""Each tag's name, the pattern of a plain scalar of it, and the letters with which one begins."""

_BASES = {"0o": 8, "0x": 16}
"""Bases of whole numbers, by the characters with which they begin."""


def add_core_forms(resolver: type[yaml.resolver.BaseResolver]) -> None:
    """Lets a resolver know the core schema.

    A dumper then puts texts in quotes that look like one of its numbers.
    """
    for tag, form, beginnings in _FORMS:
        pattern = re.compile(f"(?:{form})$")
        first = list(beginnings)
        if tag == "null":
            first.append("")
        resolver.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", pattern, first)


add_core_forms(_CoreResolver)


def _find_parser() -> Any:
    """Finds the class that makes nodes of a text: libyaml's, else PyYAML's own."""
    if yaml.__with_libyaml__:
        return yaml.cyaml.CParser

    class Parser(
        yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser, yaml.composer.Composer
    ):
        def __init__(self, text: str) -> None:
            yaml.reader.Reader.__init__(self, text)
            yaml.scanner.Scanner.__init__(self)
            yaml.parser.Parser.__init__(self)
            yaml.composer.Composer.__init__(self)

    return Parser


_Parser: Any = _find_parser()


class _StrictLoader(_Parser, yaml.constructor.SafeConstructor, _CoreResolver):
    """Makes plain values only, and stops at a document that is too large or too deep."""

    def __init__(self, text: str) -> None:
        _Parser.__init__(self, text)
        yaml.constructor.SafeConstructor.__init__(self)
        _CoreResolver.__init__(self)
        self.nodes = 0
        self.depth = 0

    def descend_resolver(self, parent: yaml.Node | None, index: Any) -> None:
        """Counts a node that begins; both parsers call it for each."""
        self.nodes += 1
        self.depth += 1
        if self.nodes > MAX_NODES:
            mark = parent.start_mark if parent else None
            raise yaml.composer.ComposerError(None, None, _TOO_MANY, mark)
        if self.depth > MAX_DEPTH:
            raise RecursionError

    def ascend_resolver(self) -> None:
        """Counts a node that ends."""
        self.depth -= 1

    def construct_whole(self, node: yaml.ScalarNode) -> int:
        """A whole number, decimal but for 0o17 and 0x1F."""
        text = self._construct_form(node, "int", "a whole number")
        return int(text, _BASES.get(text[:2], 10))

    def construct_number(self, node: yaml.ScalarNode) -> float:
        """A number, infinite or none, too."""
        text = self._construct_form(node, "(?:int|float)", "a number").lower()
        return float(text.replace(".inf", "inf").replace(".nan", "nan"))

    def construct_truth(self, node: yaml.ScalarNode) -> bool:
        """True or false."""
        return self._construct_form(node, "bool", "true or false").lower() == "true"

    def refuse_tag(self, node: yaml.Node) -> Any:
        """Refuses a tag of YAML 1.1 whose name YAML 1.2's core schema does not have."""
        name = node.tag.removeprefix(_CORE_TAG)
        problem = f"the tag !!{name} is not known; expected a plain value"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    def _construct_form(self, node: yaml.ScalarNode, tags: str, expected: str) -> str:
        """Reads the text of a value whose tag may be given, against the value's own form."""
        text: str = self.construct_scalar(node)
        forms = [form for tag, form, _ in _FORMS if re.fullmatch(tags, tag)]
        if not any(re.fullmatch(form, text) for form in forms):
            name = node.tag.removeprefix(_CORE_TAG)
            problem = f"!!{name} stands before {text[:MAX_SHOWN]!r}; expected {expected}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return text


_CORE_TAG = "tag:yaml.org,2002:"
"""How the full names of tags begin that are written with two exclamation marks."""

for _name, _constructor in (
    ("int", _StrictLoader.construct_whole),
    ("float", _StrictLoader.construct_number),
    ("bool", _StrictLoader.construct_truth),
):
    _StrictLoader.add_constructor(_CORE_TAG + _name, _constructor)
for _name in ("timestamp", "binary", "omap", "pairs", "set"):
    _StrictLoader.add_constructor(_CORE_TAG + _name, _StrictLoader.refuse_tag)


class _StrictDumper(yaml.SafeDumper):
    """Puts in quotes what either version of YAML would take for something else than text."""


add_core_forms(_StrictDumper)


def dump_yaml(data: Any, **options: Any) -> str:
    """Writes plain values as YAML that `parse_yaml` and programs that know YAML 1.1 read alike.

    Args:
        data: dictionaries, lists, texts, numbers.
        options: PyYAML's, such as `default_flow_style`.

    Returns:
        The text, with keys in their order.
    """
    text: str = yaml.dump(data, Dumper=_StrictDumper, sort_keys=False, **options)
    return text


NO_MAPPING = "does not consist of `key: value` lines"
"""What is wrong with a YAML file that holds a list, a number or plain text, for messages."""


def read_mapping(path: Path, what: str, error: type[GridPushError] = ObjectError) -> dict[str, Any]:
    """Reads a YAML file whose top level is `key: value` lines.

    Args:
        path: the file.
        what: what it should hold, for messages ("an object file").
        error: raised where it does not.

    Returns:
        The mapping.

    Raises:
        GridPushError: `error`: the file cannot be read, is not YAML, is too large, is empty, or is
            no mapping.
    """
    data = parse_yaml(path, read_text(path, what, error, MAX_YAML_SIZE), what, error)
    if data is None:
        raise error(f"{path}: is empty; expected {what}")
    if not isinstance(data, dict):
        raise error(f"{path}: {NO_MAPPING}; expected {what}")
    return data


TAG_KEY = "!"
"""Key under which a mapping's tag is kept, where tags are wanted."""


class _TaggedLoader(_StrictLoader):
    """Knows mappings of any tag, and keeps the tag's name beside their keys."""


def _construct_tagged(loader: _TaggedLoader, tag: str, node: yaml.Node) -> Any:
    """Makes a mapping with its tag beside its keys; refuses a tag on anything else."""
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(
            None, None, f"tag {tag} on what is no mapping", node.start_mark
        )
    return loader.construct_mapping(node, deep=True) | {TAG_KEY: tag}


for _prefix in ("!", "tag:yaml.org,2002:opencv-"):
    _TaggedLoader.add_multi_constructor(_prefix, _construct_tagged)


def parse_yaml(
    path: Path, text: str, what: str, error: type[GridPushError], *, tagged: bool = False
) -> Any:
    """Makes plain values of a YAML document; no code is ever run, whatever its tags say.

    Args:
        path: the file, for messages.
        text: the document.
        what: what it should hold, for messages.
        error: raised where it does not.
        tagged: whether mappings may have tags, Drake's or OpenCV's; a tag's name is then kept under
            the key TAG.

    Returns:
        Dictionaries, lists, texts, numbers; None where the document is empty.

    Raises:
        GridPushError: `error`: the text is not YAML, is nested too deeply, has a key twice, or
            holds too much.
    """
    with _explained(path, what, error), _collecting_later():
        loader = _open(text, _TaggedLoader if tagged else _StrictLoader)
        try:
            root = _compose(loader)
            return None if root is None else loader.construct_document(root)
        finally:
            loader.dispose()


def check_mapping(
    path: Path,
    data: dict[str, Any],
    schema: type[Schema],
    error: type[GridPushError],
    renamed: Mapping[str, str] | None = None,
) -> Schema:
    """Checks a mapping against a schema.

    Args:
        path: the file, for messages.
        data: as `read_mapping` gives it.
        schema: what it should hold.
        error: raised where it does not.
        renamed: the present names of keys that had others before, see `explain`.

    Returns:
        The content, checked.

    Raises:
        GridPushError: `error`: a key is missing, unknown or renamed, or a value is of the wrong
            form; the message names the file, the field and the expected form.
    """
    try:
        return schema.model_validate(data)
    except ValidationError as cause:
        raise error(f"{path}: {explain(cause, list_expected(schema), renamed)}") from None


def list_expected(schema: type[BaseModel], place: str = "") -> dict[str, str]:
    """Lists what each field of a schema should hold, as its `description` says.

    Args:
        schema: the schema.
        place: where it stands within a larger one.

    Returns:
        The descriptions by the fields' places, without indices; "" of a field that has none, unless
        it holds a mapping.
    """
    expected = {}
    for name, field in schema.model_fields.items():
        place_of_field = f"{place}.{name}" if place else name
        parts = (field.annotation, *get_args(field.annotation))
        inner = [part for part in parts if isinstance(part, type) and issubclass(part, BaseModel)]
        expected[place_of_field] = field.description or (KEYS_AND_VALUES if inner else "")
        for part in inner:
            expected |= list_expected(part, place_of_field)
    return expected


def explain(
    error: ValidationError, expected: Mapping[str, str], renamed: Mapping[str, str] | None = None
) -> str:
    """Says the first thing that is wrong, with the field's place and what is expected there.

    Args:
        error: pydantic's.
        expected: what each field should hold, by its place without indices, see `list_expected`.
        renamed: what to say of keys that were once known, by their places without indices.

    Returns:
        A sentence such as "camera.rate is -1; expected a positive number, in Hz".
    """
    first = min(error.errors(), key=lambda e: e["type"] not in UNKNOWN_KEY)
    place = first["loc"]
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in place]
    field = "".join(steps).lstrip(".")
    names = [step for step in place if isinstance(step, str)]
    message = str(first["msg"]).removeprefix("Value error, ")
    if first["type"] in UNKNOWN_KEY:
        known_once = (renamed or {}).get(".".join(names))
        if known_once:
            return f"{field}: {known_once}"
        # A key may also be a number, which is no name.
        above = names[:-1] if isinstance(place[-1], str) else names
        return f"{field}: unknown key{_suggest(above, str(place[-1]), expected)}"
    form = expected.get(".".join(names))
    if first["type"] == "value_error" and (not form or isinstance(first["input"], dict)):
        return f"{field}: {message}" if field else message
    if first["type"] == "missing":
        return f"{field} is missing" + (f"; expected {form}" if form else "")
    wanted = form or message[:1].lower() + message[1:]
    return f"{field} is {shorten(first['input'])}; expected {wanted}"


def suggest(word: str, known: list[str]) -> str:
    """Makes the end of a message about an unknown word: the nearest known one, and all."""
    near = get_close_matches(word, known, n=1)
    guess = f"; did you mean {near[0]}?" if near else ";"
    return f"{guess} expected one of {', '.join(known)}"


def shorten(value: Any) -> str:
    """Writes a refused value for a message."""
    text = "empty" if value is None else repr(value)
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


def _suggest(above: list[str], key: str, expected: Mapping[str, str]) -> str:
    """Makes the end of a message about an unknown key below others."""
    paths = [path.split(".") for path in expected]
    return suggest(key, [path[-1] for path in paths if path[:-1] == above])


@contextmanager
def _explained(path: Path, what: str, error: type[GridPushError]) -> Iterator[None]:
    """Turns PyYAML's complaints into `error`, with the place."""
    try:
        yield
    except yaml.MarkedYAMLError as cause:
        if _TOO_DEEP in str(cause.problem):
            raise error(f"{path}: is nested too deeply; expected {what}") from cause
        mark = cause.problem_mark or cause.context_mark
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise error(
            f"{path}{where}: is not valid YAML: {_shorten(cause.problem or cause.context)}"
        ) from cause
    except (yaml.YAMLError, *NOT_YAML) as cause:
        raise error(f"{path}: is not valid YAML: {_shorten(cause)}") from cause
    except RecursionError as cause:
        raise error(f"{path}: is nested too deeply; expected {what}") from cause


@contextmanager
def _collecting_later() -> Iterator[None]:
    """Keeps Python from looking for garbage meanwhile.

    It would look over and over as nodes pile up, though there is none.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _open(text: str, kind: type[_StrictLoader]) -> _StrictLoader:
    """Makes a loader, unless the text has too many lines, which even blank take their time."""
    if text.count("\n") > MAX_LINES:
        raise yaml.YAMLError(f"the document has more than {MAX_LINES} lines")
    return kind(text)


def _compose(loader: _StrictLoader) -> yaml.Node | None:
    """Makes a document's nodes, and checks them before anything is made of them."""
    root = loader.get_single_node()
    if root is not None:
        _check_keys(root)
        _check_extent(root)
    return root


def _check_keys(root: yaml.Node) -> None:
    """Refuses a key that occurs twice, and a number that is too long.

    YAML's loader would take the last of two keys in silence.
    """
    for node in _walk(root):
        if isinstance(node, yaml.ScalarNode):
            if node.tag in NUMBER_TAGS and len(node.value) > MAX_NUMBER_LENGTH:
                problem = (
                    f"a number has {len(node.value)} characters; "
                    f"expected at most {MAX_NUMBER_LENGTH}"
                )
                raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
            continue
        if not isinstance(node, yaml.MappingNode):
            continue
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key '{key.value}' occurs twice", key.start_mark
                )
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))


def _check_extent(root: yaml.Node) -> None:
    """Refuses a document that is too large with its aliases written out, or that holds itself."""
    extent: dict[int, int] = {}
    open_nodes: set[int] = set()

    def measure(node: yaml.Node) -> int:
        """Counts a node with all below it; one that an alias names again is not walked again."""
        if id(node) in extent:
            return extent[id(node)]
        if id(node) in open_nodes:
            raise yaml.composer.ComposerError(
                None,
                None,
                "an alias (*name) stands inside the value that it names",
                node.start_mark,
            )
        open_nodes.add(id(node))
        extent[id(node)] = 1 + sum(map(measure, _children(node)))
        if extent[id(node)] > MAX_NODES:
            raise yaml.composer.ComposerError(
                None, None, f"{_TOO_MANY}, its aliases written out", node.start_mark
            )
        return extent[id(node)]

    measure(root)


def _walk(root: yaml.Node) -> Iterator[yaml.Node]:
    """Finds every node once."""
    seen = {id(root)}
    left = [root]
    while left:
        node = left.pop()
        yield node
        for child in _children(node):
            if id(child) not in seen:
                seen.add(id(child))
                left.append(child)


def _children(node: yaml.Node) -> list[yaml.Node]:
    """Lists the nodes right below a node; those of a mapping are its keys and its values."""
    if isinstance(node, yaml.SequenceNode):
        return list(node.value)
    if isinstance(node, yaml.MappingNode):
        return [child for pair in node.value for child in pair]
    return []


def _shorten(problem: Any) -> str:
    """Writes PyYAML's complaint on one line, not too long."""
    text = " ".join(str(problem).split())
    return text if len(text) <= MAX_PROBLEM else text[: MAX_PROBLEM - 3] + "..."
