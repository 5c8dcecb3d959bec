"""`gridpush bench release`: measures what the pages state, over several sittings.

Each row of `ROWS` is a bench with its settings. Its jobs are run a few at a time, and each result
is kept in the row's own file with the commit, the date and a hash of the code that made it. So the
command can be ended at any time, and goes on where it was. What is there so far is written into
pages between two marks,

    <!-- release: grasp -->
    (the row's tables, and what they were measured with)
    <!-- release end -->

A row of which a result was made by other code than there is now says so by itself. Comments and
docstrings do not count.
"""

import ast
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cache, cached_property, partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from time import monotonic
from typing import Any, get_type_hints

import numpy as np

from gridpush_drake.bench.study import Done, Study, StudyOptions, option
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import write_whole
from gridpush_drake.jobs.results import DATA_SUFFIXES, hash_files, list_sources, open_results
from gridpush_drake.jobs.run import DEFAULT_WORKERS, Execution, Report, check_known, run_jobs
from gridpush_drake.report.table import Table, Value

PACKAGE = "gridpush_drake"
"""Name of the package."""

DEFAULT_FOLDER = Path("gridpush_release")
"""Folder in which results are kept by default."""

SECONDS_PER_MINUTE = 60.0
"""Seconds in a minute."""

MARK = re.compile(r"(<!-- release: (\w+) -->\n).*?(<!-- release end -->)", re.DOTALL)
"""Where a page has a row's tables."""

LAZY_PLACE = re.compile(r"([\w.]+):\w+")
"""How a file names what it imports only when it is asked for."""

DOTTED_NAME = re.compile(rf"{PACKAGE}(\.\w+)+")
"""Name of a package or module of the package."""

NO_DEPENDENCY = f"{PACKAGE}.jobs"
"""The part of the package that says where jobs are run and keeps their results; no result depends
on it."""

COMMIT_LENGTH = 8
"""Characters of a commit that are written."""


@dataclass(frozen=True)
class ReleaseRow:
    """What a page states, and the bench that measures it.

    Attributes:
        target: the bench, MODULE:ATTRIBUTE.
        settings: what is chosen of its options. The seeds were not used to choose any constant.
    """

    target: str
    settings: Mapping[str, Any]

    @property
    def module(self) -> str:
        """Name of the bench's module."""
        return self.target.partition(":")[0]

    def load(self) -> Study[Any]:
        """Imports the bench."""
        study: Study[Any] = getattr(import_module(self.module), self.target.partition(":")[2])
        return study

    @property
    def command(self) -> str:
        """What a reader types to measure the same."""
        study = self.load()
        flags = {
            each.name: each.metadata.get("name") or f"--{each.name.replace('_', '-')}"
            for each in fields(study.options)
        }
        kinds = get_type_hints(study.options)
        words = ["gridpush bench", study.name]
        for name, value in self.settings.items():
            if value is True:
                words.append(flags[name])
                continue
            values = value if isinstance(value, tuple) else (value,)
            # An option of any number of values is repeated; others have all of theirs behind them.
            if "..." in str(kinds[name]):
                words += [f"{flags[name]} {each}" for each in values]
            else:
                words.append(" ".join([flags[name], *map(str, values)]))
        return " ".join(words)


SIX_OBJECTS = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toothpaste_tube",
)
"""Objects of the rows of whole runs."""

GRASP = f"{PACKAGE}.bench.grasp:STUDY"
"""The bench of whole runs."""

SCENE_TASKS = f"{PACKAGE}.bench.multi_object.scene_tasks:STUDY"
"""The bench of tasks with several objects."""

STEERING = f"{PACKAGE}.bench.steering.experiments:STUDY"
"""The bench of pushing with feedback."""

ROWS: dict[str, ReleaseRow] = {
    "grasp": ReleaseRow(
        GRASP,
        {"objects": SIX_OBJECTS, "seeds": 7, "seed": 4100},
    ),
    "unknown_inertia": ReleaseRow(
        GRASP,
        {"objects": SIX_OBJECTS, "seeds": 7, "seed": 4200, "unknown_inertia": True},
    ),
    "unknown_inertia_camera": ReleaseRow(
        GRASP,
        {
            "objects": SIX_OBJECTS,
            "seeds": 7,
            "seed": 4000,
            "unknown_inertia": True,
            "camera": "rgbd",
        },
    ),
    "sliding": ReleaseRow(
        f"{PACKAGE}.bench.pregrasp.experiments:STUDY",
        {
            "truths": ("foundation", "three_feet"),
            "friction": (0.2, 0.6),
            "max_arm": 0.1,
            "mass_sets": 8,
            "seeds": 1,
            "seed": 9000,
        },
    ),
    "scene_tasks": ReleaseRow(
        SCENE_TASKS,
        {"seeds": 60, "seed": 2000},
    ),
    "paths": ReleaseRow(
        STEERING,
        {"kinds": ("path",), "runs": 15, "seed": 2000},
    ),
    "goals": ReleaseRow(
        STEERING,
        {"kinds": ("goal",), "runs": 5, "seed": 2000},
    ),
    "hidden_weight": ReleaseRow(
        STEERING,
        {"kinds": ("t_bottom", "t_top", "hammer"), "runs": 20, "seed": 2000},
    ),
    "tilt_tests": ReleaseRow(
        f"{PACKAGE}.bench.tilt_tests.experiments:STUDY",
        {"part": "scale", "bottom": "three_feet", "truths": 10, "seed": 6000},
    ),
    "hypotheses": ReleaseRow(
        f"{PACKAGE}.bench.truth.hypotheses:STUDY",
        {"bodies": 100, "seed": 3000},
    ),
    "paper": ReleaseRow(
        f"{PACKAGE}.bench.paper_figures:STUDY",
        {"methods": ("default",)},
    ),
}
"""What the pages state, by name. What needs real pushes or measures times is not among them: see
the commands on the pages."""

EXPECTED_MARKS = (
    f"expected <!-- release: NAME --> and <!-- release end --> with some of {', '.join(ROWS)}"
)
"""What is said to be expected of a page."""


@dataclass(frozen=True)
class ReleaseOptions(StudyOptions):
    """What is measured, for how long, and where it is written.

    Attributes:
        rows: names of rows; all where None.
        minutes: no job begins after so many minutes; None for no end.
        folder: where results are kept.
        pages: pages into which the tables are written, or folders of such pages.
        workers: number of worker processes.
        renew: whether results of other code are measured anew.
    """

    rows: tuple[str, ...] | None = option(
        None,
        f"{', '.join(tuple(ROWS)[:-1])} or {tuple(ROWS)[-1]}; may be repeated.",
        name="--row",
        metavar="NAME",
        shown="all",
    )
    minutes: float | None = option(None, "Begin no job after so many minutes.", metavar="MINUTES")
    folder: Path = option(DEFAULT_FOLDER, "Where results are kept.", metavar="DIR")
    pages: tuple[str, ...] | None = option(
        None,
        "A page whose tables between `<!-- release: NAME -->` and `<!-- release end -->` are "
        "written anew, or a folder of pages; may be repeated.",
        name="--page",
        metavar="PATH",
    )
    workers: int = option(DEFAULT_WORKERS, "Worker processes; 0 for none.", least=0)
    renew: bool = option(False, "Measure anew what was measured with other code.")


@dataclass(frozen=True, eq=False)
class MeasuredRow:
    """What is known of a row.

    Attributes:
        name: its name.
        row: the row.
        options: the bench's options by which it was measured.
        job_count: number of its jobs.
        done: those that are done, with their results.
        stamps: commit, date and hash of the code of each.
        code: hash of the code that there is now.
    """

    name: str
    row: ReleaseRow
    options: StudyOptions
    job_count: int
    done: Done
    stamps: Sequence[Mapping[str, str]]
    code: str

    @property
    def old_count(self) -> int:
        """Number of results that were made by other code than there is now."""
        return sum(stamp["code"] != self.code for stamp in self.stamps)

    @property
    def commits(self) -> str:
        """The commits that results were made by, in the order in which they were done."""
        return ", ".join(dict.fromkeys(stamp["commit"] for stamp in self.stamps))

    def describe(self) -> str:
        """Says in a sentence or two what was measured, when and with what."""
        if not self.stamps:
            return f"`{self.row.command}`: not measured yet."
        dates = sorted({stamp["date"] for stamp in self.stamps})
        when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
        said = (
            f"`{self.row.command}`: {len(self.stamps)} of {self.job_count} jobs, {when}, commit "
            f"{self.commits}."
        )
        if self.old_count == 0:
            return said
        since = "" if self.old_count == len(self.stamps) else f" {self.old_count} of them"
        return f"{said} **The code has changed since{since}.**"

    @cached_property
    def tables(self) -> list[Table]:
        """The bench's own tables of what is done so far."""
        return self.row.load().tabulate(self.options, self.done) if self.done.pairs else []


def measure(options: ReleaseOptions, report: Report | None) -> list[Table]:
    """Measures rows for as long as may be, and writes the pages.

    Raises:
        GridPushError: a row is not known, a file of results is of another form, or a page has no
            place for any row.
    """
    names = tuple(ROWS) if options.rows is None else options.rows
    check_known("rows", names, tuple(ROWS))
    pages = {page: text for given in options.pages or () for page, text in _read_pages(Path(given))}
    end = float("inf")
    if options.minutes is not None:
        end = monotonic() + SECONDS_PER_MINUTE * options.minutes
    measured = [_measure_row(name, options, end, report) for name in names]
    for page, text in pages.items():
        write_whole(page, write_into(text, measured), force=True)
    rows: list[list[Value]] = [
        [each.name, len(each.stamps), each.job_count, each.commits or "-", each.old_count]
        for each in measured
    ]
    columns = ("row", "jobs done", "jobs", "commits", "of other code")
    return [
        Table("What the pages state", columns, rows),
        *(table for each in measured for table in each.tables),
    ]


def write_into(text: str, measured: Sequence[MeasuredRow]) -> str:
    """Writes the tables of rows into a page's text, where it has marks for them."""
    by_name = {each.name: each for each in measured}

    def write(found: re.Match[str]) -> str:
        begin, name, end = found.groups()
        each = by_name.get(name)
        if each is None:
            return found.group()
        tables = "\n".join(table.to_markdown() for table in each.tables)
        return f"{begin}{each.describe()}\n\n{tables}{end}"

    return MARK.sub(write, text)


def _read_pages(given: Path) -> list[tuple[Path, str]]:
    """Reads a page, or those pages of a folder, that have a place for some row."""
    found = []
    for page in sorted(given.glob("*.md")) if given.is_dir() else [given]:
        try:
            text = page.read_text(encoding="utf-8")
        except OSError as error:
            raise GridPushError(f"{page}: cannot be read: {error.strerror}") from error
        names = [name for _, name, _ in MARK.findall(text)]
        unknown = [name for name in names if name not in ROWS]
        if unknown:
            raise GridPushError(f"{page}: has {', '.join(unknown)}; {EXPECTED_MARKS}")
        if names:
            found.append((page, text))
    if not found:
        raise GridPushError(f"{given}: has no row; {EXPECTED_MARKS}")
    return found


def _measure_row(
    name: str, options: ReleaseOptions, end: float, report: Report | None
) -> MeasuredRow:
    """Runs a row's jobs that are not done yet, until a time of the monotonic clock, s."""
    row = ROWS[name]
    study = row.load()
    chosen = study.options(**row.settings)
    chosen = study.shorten(chosen) if options.quick else chosen
    jobs = list(study.make_jobs(chosen))
    code = hash_code(row.module)
    stamp = {"commit": find_commit(), "date": f"{datetime.now(UTC):%Y-%m-%d}", "code": code}
    settings = dict(row.settings) | {"quick": options.quick}
    options.folder.mkdir(exist_ok=True)
    open_row = partial(
        open_results, options.folder / f"{name}.jsonl", study.name, settings, stamp=stamp
    )
    # What was measured is begun anew only where it cannot be gone on with.
    try:
        results = open_row(force=False)
    except GridPushError:
        if not options.force:
            raise
        results = open_row(force=True)
    if options.renew:
        for job in jobs:
            if results.find_stamp(job).get("code", code) != code:
                results.forget(job)
    pairs: list[tuple[Any, Any]] = []
    for kind in study.tasks:
        mine = [job for job in jobs if type(job) is kind.job]
        done = results.find(kind.run, mine)
        # In any order, so that what is done of a row at any time stands for the whole.
        order = np.random.default_rng(chosen.seed).permutation(len(mine)).tolist()
        left = [mine[i] for i in order if i not in done]
        shown = _count_from(report, name, len(mine) - len(left), len(mine))
        execution = Execution(options.workers, shown, results, begin_until=end)
        run_jobs(kind.run, left, kind.describe, execution)
        pairs += [(mine[i], result) for i, result in results.find(kind.run, mine).items()]
    return MeasuredRow(
        name=name,
        row=row,
        options=chosen,
        job_count=len(jobs),
        done=Done(pairs),
        stamps=[results.find_stamp(job) for job, _ in pairs],
        code=code,
    )


def _count_from(report: Report | None, name: str, known: int, total: int) -> Report | None:
    """Makes what reports the progress of a part of a row's jobs as that of all."""
    if report is None:
        return None
    return lambda said, done, _: report(f"{name}: {said}", known + done, total)


@cache
def find_commit() -> str:
    """Returns the commit of the checkout in which the package is, with + where it was changed.

    It is "unknown" where the package is in no checkout.
    """
    folder = Path(str(files(PACKAGE)))
    said = []
    for command in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]):
        try:
            run = subprocess.run(
                ["git", "-C", str(folder), *command], capture_output=True, text=True, check=True
            )
        except (OSError, subprocess.CalledProcessError):
            return "unknown"
        said.append(run.stdout.strip())
    return said[0][:COMMIT_LENGTH] + ("+" if said[1] else "")


@cache
def hash_code(module: str) -> str:
    """Hashes the code that a module of the package stands on (`list_code`), and all data.

    Comments and docstrings do not count, and nor does the layout of the lines.
    """
    package = Path(str(files(PACKAGE)))
    paths = [*list_code(package, module).values(), *list_sources(package, DATA_SUFFIXES)]
    return hash_files(package, paths, read_code)


def read_code(path: Path) -> bytes:
    """Reads a file; of one in Python, what is left without comments and docstrings."""
    content = path.read_bytes()
    return _keep_code(content) if path.suffix == ".py" else content


@cache
def _keep_code(content: bytes) -> bytes:
    """Leaves comments and docstrings out of a file's content; all rows stand on many such files."""
    tree = ast.parse(content)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [each for each in node.body if not _is_docstring(each)]
    return ast.unparse(tree).encode()


def _is_docstring(node: ast.stmt) -> bool:
    """Whether a statement is a text that is used for nothing."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def list_code(package: Path, module: str) -> dict[str, Path]:
    """Finds the files of a module, of all modules that it imports, which these import, and so on.

    `NO_DEPENDENCY` is left out.

    Returns:
        The files by the modules' names.
    """
    known: dict[str, Path] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        path = _find_file(package, name)
        if path is not None and name not in known and not name.startswith(NO_DEPENDENCY):
            known[name] = path
            todo += list_imports(path)
    return known


def list_imports(path: Path) -> list[str]:
    """Lists the names of the package's modules, and of things in them, that a file may import.

    It may import what texts name as "MODULE:NAME", too, such as those in the table of tasks: there
    MODULE is within the package, or within a package that another text of the file names.
    """
    return list(_find_imports(path.read_text(encoding="utf-8")))


@cache
def _find_imports(text: str) -> frozenset[str]:
    """Finds what a file's text imports; all rows stand on many of the same files."""
    found: set[str] = set()
    bases = {PACKAGE}
    places: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found.update(each.name for each in node.names if each.name.startswith(PACKAGE))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            found.add(str(node.module))
            found.update(f"{node.module}.{each.name}" for each in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            place = LAZY_PLACE.fullmatch(node.value)
            if place is not None:
                places.add(place[1])
            elif DOTTED_NAME.fullmatch(node.value):
                bases.add(node.value)
    found.update(place for place in places if place.startswith(PACKAGE))
    found.update(f"{base}.{place}" for base in bases for place in places)
    return frozenset(found)


def _find_file(package: Path, name: str) -> Path | None:
    """Finds the file of a module; None where the name is of no module."""
    place = package.joinpath(*name.split(".")[1:])
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None


STUDY = Study(
    name="release",
    help="Measure what the pages state, over several sittings, and write their tables.",
    options=ReleaseOptions,
    measure=measure,
)
"""`gridpush bench release`."""
