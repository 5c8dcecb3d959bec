"""Tables of what was measured, for people and for machines; intervals; and figures as files."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from math import floor, isfinite, isnan, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rich.table
from numpy.typing import NDArray
from rich.cells import cell_len
from rich.text import Text

from gridpush_drake.errors import OutputError
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.units import PERCENT_PER_ONE

if TYPE_CHECKING:
    import rich.console
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Mean:
    """A mean and its confidence interval.

    Attributes:
        mean: the mean.
        low: the interval's lower end; None where there is no interval.
        high: its upper end.
        even: whether the ends are as far from the mean by construction, to be shown as one number.
    """

    mean: float
    low: float | None = None
    high: float | None = None
    even: bool = False

    def to_array(self) -> NDArray[np.float64]:
        """Returns the mean and the interval's ends, (3,); NaN where there is no interval."""
        return np.array([self.mean, self.low, self.high], dtype=np.float64)

    def describe(self) -> str:
        """Writes the mean, with its interval."""
        if self.low is None or self.high is None:
            return f"{self.mean:.2f}"
        if self.even:
            return f"{self.mean:.2f} ± {(self.high - self.low) / 2:.2f}"
        return f"{self.mean:.2f} ({self.low:.2f} to {self.high:.2f})"


Value = str | float | int | Mean | None

Column = Callable[[Any], Value]
"""Function that calculates a column's value from the results that a row is of."""


BORDER_WIDTH = 1
"""Width of the left border of a shown table, characters."""

COLUMN_PADDING = 3
"""Width of a column of a shown table beside its text, characters."""


@dataclass(frozen=True)
class Table:
    """Rows of figures under named columns.

    Attributes:
        title: what was measured, with its unit.
        columns: their names.
        rows: of as many values as there are columns; None or NaN where there is none.
        notes: how it was measured, and what else must be known to read it, a sentence each.
        digits: significant digits that numbers are shown with.
        keys: how many of the first columns say what a row is of; they are repeated where a table is
            too wide.
        figures: numbers by name that JSON has at its top, beside the tables.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = ()
    digits: int = 3
    keys: int = 1
    figures: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"{self.title}: a row of {len(row)} values; expected {len(self.columns)}"
                )

    @classmethod
    def of(
        cls,
        title: str,
        keys: Sequence[str],
        groups: Iterable[tuple[Sequence[Value], Sequence[Any]]],
        columns: Mapping[str, Column],
        notes: Sequence[str] = (),
        digits: int = 3,
    ) -> "Table":
        """Tabulates results by groups.

        Args:
            title: what was measured, with its unit.
            keys: names of the columns that say what a row is of.
            groups: values of these columns for each row, and the row's results; a row without
                results is left out.
            columns: the other columns by name, with what calculates their values.
            notes: how it was measured, a sentence each.
            digits: number of significant digits that numbers are shown with.

        Returns:
            The table.
        """
        rows = [
            [*key, *(calc(results) for calc in columns.values())]
            for key, results in groups
            if len(results)
        ]
        return cls(title, (*keys, *columns), rows, notes, digits, len(keys))

    def to_dict(self) -> dict[str, Any]:
        """Returns the table as JSON has it."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [[_to_json(value) for value in row] for row in self.rows],
            "notes": list(self.notes),
        }

    def __rich_console__(
        self, console: "rich.console.Console", options: "rich.console.ConsoleOptions"
    ) -> "Iterator[rich.console.RenderableType]":
        """Shows the table on a terminal, in as many parts as its width asks for."""
        parts = self.split(options.max_width)
        for i, part in enumerate(parts):
            yield self._to_rich(part, options.max_width, title=self.title if i == 0 else "")
        for note in self.notes:
            yield Text(note, style="table.caption", justify="left")

    def split(self, width: int) -> list[list[int]]:
        """Splits the table into parts that fit a width.

        Args:
            width: of what it is shown on, characters.

        Returns:
            The columns' numbers of each part, the keys in all of them. Where keys and one column
            are wider than the width, they are a part, and that column's values are broken between
            words when they are shown.
        """
        widths = [self._measure(i) + COLUMN_PADDING for i in range(len(self.columns))]
        keys = list(range(self.keys))
        parts = [list(keys)]
        for i in range(self.keys, len(self.columns)):
            if (
                len(parts[-1]) > self.keys
                and BORDER_WIDTH + sum(widths[j] for j in (*parts[-1], i)) > width
            ):
                parts.append(list(keys))
            parts[-1].append(i)
        return parts

    def to_markdown(self) -> str:
        """Returns the table as Markdown has it."""
        lines = [f"### {self.title}", "", f"| {' | '.join(self.columns)} |"]
        lines.append("|---|" + "---:|" * (len(self.columns) - 1))
        lines += [f"| {' | '.join(self.format(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", *(f"{note}  " for note in self.notes), ""])

    def format(self, value: Value) -> str:
        """Writes a value, a number to `digits` significant digits.

        Powers of ten are written from a million on, and below a millionth.
        """
        if value is None:
            return "-"
        if isinstance(value, Mean):
            return value.describe()
        if isinstance(value, str | int):
            return str(value)
        if isnan(value):
            return "-"
        if value == 0 or not 1e-6 <= abs(value) < 1e6:
            return f"{value:.{self.digits}g}"
        rounded = float(f"{value:.{self.digits}g}")
        return f"{rounded:.{max(self.digits - 1 - floor(log10(abs(rounded))), 0)}f}"

    def _measure(self, column: int) -> int:
        """Counts the characters that a column needs: its longest value or word of its name."""
        texts = [*self.columns[column].split(), *(self.format(row[column]) for row in self.rows)]
        return max(map(cell_len, texts))

    def _to_rich(self, part: Sequence[int], width: int, title: str) -> "rich.table.Table":
        """Makes a table of some of the columns, as Rich shows it.

        Keys are aligned left and the other columns right. Where these do not fit, they are aligned
        left and broken between words. Nothing is read as markup.
        """
        spare = width - BORDER_WIDTH - sum(self._measure(i) + COLUMN_PADDING for i in part)
        fits = spare >= 0
        whole = part if fits else part[: self.keys]
        table = rich.table.Table(
            title=Text(title) if title else None, title_justify="left", show_lines=not fits
        )
        for i in part:
            least = self._measure(i)
            more = max(0, min(spare, len(self.columns[i]) - least))
            spare -= more
            table.add_column(
                Text(self.columns[i]),
                justify="right" if fits and i >= self.keys else "left",
                width=least + more if i in whole else None,
            )
        for row in self.rows:
            table.add_row(*(Text(self.format(row[i]), no_wrap=i in whole) for i in part))
        return table


def _to_json(value: Value) -> Any:
    """Returns a value as JSON has it, a mean's figures by name."""
    return (
        {"mean": value.mean, "low": value.low, "high": value.high}
        if isinstance(value, Mean)
        else value
    )


INTERVAL_CONFIDENCE = 0.95
"""Confidence of the intervals of fractions and means."""


BOOTSTRAP_SAMPLES = 9999
"""Number of bootstrap samples of an interval."""


def calc_interval(values: Sequence[float], scale: float = 1.0) -> Mean:
    """Calculates the mean of some values, and its interval at INTERVAL_CONFIDENCE.

    Args:
        values: one or more.
        scale: what they are multiplied by.

    Returns:
        The mean, with a bootstrap interval by percentiles where some values differ.
    """
    from scipy.stats import bootstrap  # only where it is used: it takes long to import

    sample = scale * np.asarray(values, dtype=np.float64)
    if np.ptp(sample) == 0:
        return Mean(float(sample.mean()))
    ends = bootstrap(
        (sample,),
        np.mean,
        confidence_level=INTERVAL_CONFIDENCE,
        n_resamples=BOOTSTRAP_SAMPLES,
        method="percentile",
        random_state=np.random.default_rng(0),
    ).confidence_interval
    return Mean(float(sample.mean()), float(ends.low), float(ends.high))


@dataclass(frozen=True)
class Proportion:
    """How many of several episodes ended in one way.

    Attributes:
        count: number of those that did.
        total: number of all.
        low: the Wilson interval's lower end, at INTERVAL_CONFIDENCE.
        high: its upper end.
    """

    count: int
    total: int
    low: float
    high: float

    @classmethod
    def of(cls, count: int, total: int) -> "Proportion":
        """Calculates the interval of a fraction; `total` is 1 or more."""
        from scipy.stats import binomtest  # only where it is used: it takes long to import

        interval = binomtest(count, total).proportion_ci(INTERVAL_CONFIDENCE, method="wilson")
        return cls(count, total, float(interval.low), float(interval.high))

    def describe(self) -> str:
        """Writes the count, and the interval in percent."""
        return (
            f"{self.count} ({PERCENT_PER_ONE * self.low:.1f} to {PERCENT_PER_ONE * self.high:.1f} "
            "%)"
        )


def calc_mean(values: Iterable[float | None]) -> float:
    """Calculates the mean of those values that are numbers; NaN where there are none."""
    known = [value for value in values if value is not None and isfinite(value)]
    return sum(known) / len(known) if known else float("nan")


def mean_of(field: str, scale: float = 1.0) -> Column:
    """Makes a column of `Table.of`: the mean of a field of the results, times `scale`."""
    return lambda results: scale * calc_mean(getattr(result, field) for result in results)


def count_of(field: str, value: object) -> Column:
    """Makes a column of `Table.of`: how many of the results have this value of a field."""
    return lambda results: sum(getattr(result, field) == value for result in results)


ALL_RESULTS = "all"
"""Name of the row of all results."""


def by_object(
    results: Sequence[Any], names: Sequence[str], *keys: str, key: str = "name"
) -> list[tuple[tuple[str, ...], list[Any]]]:
    """Makes groups of `Table.of`: the results of each object, and of all.

    Args:
        results: the results.
        names: names of the objects.
        keys: values of columns before the object's name.
        key: field of a result that has its object's name.
    """
    groups = [
        ((*keys, name), [result for result in results if getattr(result, key) == name])
        for name in names
    ]
    return [*groups, ((*keys, ALL_RESULTS), list(results))]


FIGURE_DPI = 150
"""Resolution of a figure, pixels an inch."""

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
"""Endings of the names of figures."""

PANEL_SIZE = (3.6, 2.7)
"""Width and height of a figure's panel, inches."""

LEGEND_HEIGHT = 0.6
"""Height of a figure's legend, inches."""


def check_figure(path: Path | str, force: bool) -> None:
    """Checks, before long work begins, that a figure may be written.

    Raises:
        OutputError: it may not.
    """
    if Path(path).suffix.lower() not in FIGURE_SUFFIXES:
        raise OutputError(
            f"{path}: is of an unknown kind; expected a name that ends in "
            f"{', '.join(FIGURE_SUFFIXES)}"
        )
    check_writable(path, force)


def write_panels(
    path: Path | str,
    titles: Sequence[str],
    columns: int,
    labels: tuple[str, str],
    draw: "Callable[[Axes, str], None]",
    force: bool,
    *,
    from_zero: bool = False,
) -> None:
    """Writes a figure of alike panels, with one legend, in the format of the path's ending.

    Args:
        path: file of the figure: PNG, PDF or SVG.
        titles: titles of the panels.
        columns: number of columns of panels.
        labels: labels of the x and y axes, which all panels share.
        draw: draws the panel of a title.
        force: whether an existing file may be replaced.
        from_zero: whether the y axes begin there.

    Raises:
        OutputError: as `check_figure`.
    """
    from matplotlib.figure import Figure  # only where it is drawn: it takes long to import

    rows = -(-len(titles) // columns)
    figure = Figure(
        figsize=(PANEL_SIZE[0] * columns, PANEL_SIZE[1] * rows + LEGEND_HEIGHT),
        layout="constrained",
    )
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axis, title in zip(axes, titles, strict=False):
        draw(axis, title)
        axis.set_title(title)
    if from_zero:
        axes[0].set_ylim(bottom=0)  # shared by all panels, once everything is drawn
    for axis in axes[len(titles) :]:
        axis.set_visible(False)
    figure.supxlabel(labels[0])
    figure.supylabel(labels[1])
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False
    )
    buffer = BytesIO()
    figure.savefig(buffer, format=Path(path).suffix.lstrip("."), dpi=FIGURE_DPI)
    write_whole(path, buffer.getvalue(), force)
