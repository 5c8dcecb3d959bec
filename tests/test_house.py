"""How the code reads, measured room by room; `python -m tests.test_house` prints the table.

These are alarms, not aims. A comment that says nothing is worse than none, and code is not clear
because it has few syntax nodes a line; but where the figures are far off, a reader has to solve the
code instead of reading it. `AIM` is what every room should reach. A room that is not there yet is
listed in `ROOMS` with its present figures: it may get better, and must not get worse. When it is
better, put the line that the table prints into `ROOMS`.

What is measured, in each room's Python files:

* nodes: syntax nodes (`ast`) a line of code. A line of code is one with a token that is no comment
  and no docstring.
* comments: a 1,000 lines of code. Trailing ones count, pragmas such as `# noqa` do not.
* pairs: assignments of a tuple to a tuple, `a, b = x, y`, a 1,000 lines of code.
* packed: calls with more than 7 positional arguments, and records made of more than 5, a 1,000
  lines of code. Calls between compiled kernels do not count.
* vague: docstrings that cannot be understood by themselves, for they begin with a word such as "Of"
  or "Likewise", a 1,000 lines of code.
* long: lines of more than 100 characters, a 1,000 lines of code.

Further tests hold the house to what it reached: folders of few files, classes with names of
their own, constants that say what they are, and the words of the field.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "gridpush_drake"

AT_THE_TOP = {
    ".ci",
    ".devcontainer",
    ".dockerignore",
    ".gitignore",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "README.md",
    "docs",
    "gridpush_drake",
    "models",
    "pyproject.toml",
    "systems",
    "tests",
}
"""What the repository holds at its top; no results of a bench or a demo."""

MAX_ARGUMENTS = 7
"""Positional arguments of a call that a reader can tell apart."""

MAX_FIELDS = 5
"""Fields of a record that may be filled by position."""

MAX_LENGTH = 100
"""Characters of a line."""

VAGUE = re.compile(r"(Of|Likewise|The same|Whether that)\b")
"""How a docstring begins that cannot be understood without reading another one first."""

PRAGMA = re.compile(r"#\s*(noqa|type:|fmt:|pragma|mypy:|ruff:)")
"""Comments that are for tools."""

RECORD = re.compile(r"_?[A-Z][a-zA-Z0-9]*[a-z][a-zA-Z0-9]*$")
"""How the name of a class is written. So are functions that take a Drake builder: verbs of Drake."""

VERBS = ("Add", "Apply", "Calc", "Connect", "Declare", "Draw", "Find", "Get", "Is", "Make", "Set")
"""How the name of a function in CamelCase begins."""


@dataclass(frozen=True)
class Figures:
    """How a room reads, see above. All but `comments` should be low."""

    nodes: float
    comments: float
    pairs: float
    packed: float
    vague: float
    long: float

    def list_worse(self, limit: "Figures") -> list[str]:
        """Says which figures are worse than those of a limit."""
        found = []
        for field in fields(self):
            mine = getattr(self, field.name)
            allowed = getattr(limit, field.name)
            if (mine < allowed) if field.name == "comments" else (mine > allowed):
                found.append(f"{field.name} {mine:g} (listed: {allowed:g})")
        return found


AIM = Figures(nodes=10.0, comments=25.0, pairs=2.0, packed=0.0, vague=0.0, long=0.0)
"""What every room should reach; comments in rooms of mathematics only."""

ROOMS = """
room              nodes  comments  pairs  packed  vague  long
(files)            10.1         5      0     0.0      0     0
bench               9.2         7      0     0.0      0     0
cli                 6.8         9      0     0.0      0     0
display            10.0         8      0     0.0      0     0
dynamics/kernels   11.0        40      2     0.4      0     0
geometry           11.0        60      0     0.0      0     0
gym                10.6        12      0     0.0      0     0
interop            10.4        25      0     0.0      0     0
jobs               10.0        20      0     0.0      0     0
multibody           8.7        11      0     0.0      0     0
objects             9.9        20      0     0.0      0     0
perception         10.9        58      0     0.0      0     0
pushes             10.2        16      0     0.0      0     0
report              9.1         6      0     0.0      0     0
station             8.5        15      1     0.0      0     0
systems             9.5        12      0     0.0      0     0
"""
"""The rooms that are not at `AIM` yet, each with a little more than it had when it was last listed.

Comments are asked of a room only once it is open: until then those beside constants become
docstrings below them, and the figure falls for a good reason."""


def read_rooms(table: str) -> dict[str, Figures]:
    """Reads a table like `ROOMS`."""
    rows = [line.split() for line in table.strip().splitlines()]
    return {
        room: Figures(**dict(zip(rows[0][1:], map(float, values), strict=True)))
        for room, *values in rows[1:]
    }


def list_rooms() -> dict[str, list[Path]]:
    """Finds every room's Python files. `dynamics/kernels` is a room by itself."""
    rooms: dict[str, list[Path]] = {}
    for folder in (PACKAGE, ROOT / "systems"):
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(ROOT).parts
            if parts[:2] == ("gridpush_drake", "systems"):
                continue  # a link to the folder that is visited by itself
            name = parts[0]
            if name == "gridpush_drake":
                name = parts[1] if len(parts) > 2 else "(files)"
            if parts[1:3] == ("dynamics", "kernels"):
                name = "dynamics/kernels"
            rooms.setdefault(name, []).append(path)
    return rooms


def measure(paths: list[Path]) -> Figures:
    """Measures a room."""
    nodes = 0
    code = 0
    comments = 0
    pairs = 0
    packed = 0
    vague = 0
    long = 0
    for path in paths:
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        docstrings = list(find_docstrings(tree))
        all_nodes = list(ast.walk(tree))
        nodes += len(all_nodes)
        pairs += sum(map(is_pair, all_nodes))
        in_kernels = collect_kernel_calls(tree)
        packed += sum(is_packed(node) for node in all_nodes if id(node) not in in_kernels)
        vague += sum(VAGUE.match(docstring.value.strip()) is not None for docstring in docstrings)
        long += sum(len(line) > MAX_LENGTH for line in text.splitlines())
        lines, here = count_lines(text, docstrings)
        code += lines
        comments += here
    per_line = 1.0 / max(code, 1)
    return Figures(
        nodes=round(nodes * per_line, 1),
        comments=round(1000 * comments * per_line),
        pairs=round(1000 * pairs * per_line),
        packed=round(1000 * packed * per_line, 1),
        vague=round(1000 * vague * per_line, 1),
        long=round(1000 * long * per_line, 1),
    )


def find_docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Finds the strings that stand as a statement: of modules, classes, functions and constants."""
    for node in ast.walk(tree):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value


def count_lines(text: str, docstrings: list[ast.Constant]) -> tuple[int, int]:
    """Counts lines of code, and comments that are not for tools."""
    told = {line for doc in docstrings for line in range(doc.lineno, (doc.end_lineno or 0) + 1)}
    blank = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    code = set()
    comments = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments += PRAGMA.match(token.string) is None
        elif token.type not in blank:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - told), comments


def is_pair(node: ast.AST) -> bool:
    """Whether a statement assigns a tuple to a tuple."""
    if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
        return False
    return isinstance(node.targets[0], ast.Tuple)


def is_packed(node: ast.AST) -> bool:
    """Whether a call has more positional arguments than a reader can tell apart."""
    if not isinstance(node, ast.Call):
        return False
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    is_record = RECORD.match(name) is not None and not name.startswith(VERBS)
    return len(node.args) > (MAX_FIELDS if is_record else MAX_ARGUMENTS)


def collect_kernel_calls(tree: ast.Module) -> set[int]:
    """Finds the calls of other kernels within kernels, by their `id`; not the records made there."""
    found = set()
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        if not any("kernel" in ast.dump(each) for each in function.decorator_list):
            continue
        for node in ast.walk(function):
            called = node.func if isinstance(node, ast.Call) else None
            if isinstance(called, ast.Name) and not RECORD.match(called.id):
                found.add(id(node))
    return found


LISTED = read_rooms(ROOMS)
FILES = list_rooms()


@pytest.mark.parametrize("room", FILES)
def test_a_room_reads_no_worse_than_it_did(room):
    worse = measure(FILES[room]).list_worse(LISTED.get(room, AIM))
    assert not worse, f"{room}: {', '.join(worse)}; see tests/test_house.py for what is meant"


@pytest.mark.skipif(not PACKAGE.is_dir(), reason="a wheel's tests have no sources beside them")
def test_every_room_listed_is_there():
    assert LISTED.keys() <= FILES.keys()


MAX_FILES = 15
"""Python files of a folder, besides its `__init__.py`, that a reader can survey."""

MAX_ONE_WORD_CONSTANTS = 150
"""Different names of one word that constants of modules may have in all: one word hardly says what
of a constant it is, as soon as it is read in another file."""

OLD_WORDS = {
    "told": "known",
    "untold": "unknown",
    "surely": "robust",
    "withstood": "no_tilt_count",
    "doubt": "inflation, ambiguity, warning",
    "doubts": "warnings",
    "odds": "evidence, log ratio",
    "share": "fraction, normalized load",
    "shares": "fractions",
    "surprises": "innovations",
    "wish": "cost",
    "ride": "run, progress",
}
"""Words of our own that may not come back in names, and what the field says instead."""

KEPT_NAMES = {"torque_share", "learned_share", "path_speed_share", "min_held_share"}
"""Names with such words that are keys of files, which people have written."""


def list_names(tree: ast.Module) -> Iterator[str]:
    """Yields all names that a file gives or uses, but those of imported modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.arg | ast.keyword):
            yield node.arg or ""
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name


def list_constants(tree: ast.Module) -> Iterator[str]:
    """Yields the names of a module's constants."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        yield from (each.id for each in targets if isinstance(each, ast.Name) and each.id.isupper())


@dataclass(frozen=True)
class Names:
    """What a file names: classes and constants that it defines, and all that it gives or uses."""

    classes: list[str]
    constants: list[str]
    all: set[str]


@pytest.fixture(scope="module")
def names() -> dict[Path, Names]:
    """The names of every file of the package, each parsed once."""
    found = {}
    for path in chain(*FILES.values()):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        classes = [node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        found[path] = Names(classes, list(list_constants(tree)), set(list_names(tree)))
    return found


def test_nothing_lies_at_the_top_that_does_not_belong_there():
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"git does not say what belongs here: {done.stderr.strip()}")
    assert {name.split("/")[0] for name in done.stdout.splitlines()} == AT_THE_TOP


def test_no_folder_has_more_files_than_can_be_surveyed():
    folders = Counter(
        path.parent.relative_to(ROOT).as_posix()
        for path in chain(*FILES.values())
        if path.name != "__init__.py"
    )
    assert not {folder: n for folder, n in folders.items() if n > MAX_FILES}


def test_every_class_has_a_name_of_its_own(names):
    classes = Counter(chain(*(each.classes for each in names.values())))
    assert not {name: n for name, n in classes.items() if n > 1}


def test_constants_say_what_they_are(names):
    constants = set(chain(*(each.constants for each in names.values())))
    of_one_word = sorted(name for name in constants if "_" not in name)
    assert len(of_one_word) <= MAX_ONE_WORD_CONSTANTS, of_one_word


def test_names_have_the_words_of_the_field(names):
    found = {
        f"{path.relative_to(ROOT)}: {name}: {OLD_WORDS[word]}"
        for path, here in names.items()
        for name in here.all - KEPT_NAMES
        for word in map(str.lower, re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name))
        if word in OLD_WORDS
    }
    assert not found, "\n".join(sorted(found))


def test_it_measures_what_it_says():
    text = '''"""Likewise."""

A, B = 1, 2  # trailing
x = Record(1, 2, 3, 4, 5, 6)  # noqa: F821


@kernel(allocates=False)
def inner():
    outer(1, 2, 3, 4, 5, 6, 7, 8)
    # why
    return Record(1, 2, 3, 4, 5, 6)


plain(1, 2, 3, 4, 5, 6, 7, 8)
MakeThing(1, 2, 3, 4, 5, 6, 7)
'''
    tree = ast.parse(text)
    inner = collect_kernel_calls(tree)
    docstrings = list(find_docstrings(tree))
    nodes = list(ast.walk(tree))
    assert count_lines(text, docstrings) == (8, 2)
    assert sum(map(is_pair, nodes)) == 1
    assert sum(is_packed(node) for node in nodes if id(node) not in inner) == 3
    assert VAGUE.match(docstrings[0].value)


def test_what_there_is_no_time_for_is_counted_and_named():
    late = ["test_a_log_holds_frozen_pushes", "test_copies_are_as_frozen_and_equal"]
    command = ["-m", "pytest", "-n", "0", "--budget", "0", "tests/test_frozen.py", "-k"]
    done = subprocess.run(
        [sys.executable, *command, f"{late[0]} or {late[1]} and deepcopy and Camera"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "not run, for the budget was used up: 2" in done.stdout
    assert all(f"\ntests/test_frozen.py::{name}" in done.stdout for name in late)


def main() -> None:
    """Prints the table of rooms, with the room's name starred where it is at `AIM`."""
    names = [field.name for field in fields(Figures)]
    print(f"{'room':18}" + "".join(f"{name:>10}" for name in names))
    for room, paths in sorted(FILES.items()):
        found = measure(paths)
        values = [getattr(found, name) for name in names]
        star = "" if found.list_worse(AIM) else " *"
        print(f"{room:18}" + "".join(f"{value:10g}" for value in values) + star)


if __name__ == "__main__":
    main()
