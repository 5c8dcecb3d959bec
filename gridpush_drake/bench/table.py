"""A table of measured figures, for people and for machines."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, isnan, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import rich.table

Value = str | float | int | None


@dataclass(frozen=True)
class Table:
    """Rows of figures under named columns.

    Attributes:
        title: what was measured, with its unit.
        columns: their names.
        rows: of as many values as there are columns; None or NaN where there is none.
        notes: how it was measured, and what else must be known to read it, a sentence each.
        digits: significant digits that numbers are shown with.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = ()
    digits: int = 3

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{self.title}: a row of {len(row)} values; expected {len(self.columns)}")

    def to_dict(self) -> dict[str, Any]:
        """The table as JSON has it."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [list(row) for row in self.rows],
            "notes": list(self.notes),
        }

    def to_rich(self) -> "rich.table.Table":
        """The table as a terminal shows it: first column left, the others right."""
        import rich.table

        table = rich.table.Table(title=self.title, title_justify="left", caption_justify="left")
        for i, column in enumerate(self.columns):
            table.add_column(column, justify="right" if i else "left")
        for row in self.rows:
            table.add_row(*(self.format(value) for value in row))
        table.caption = "\n".join(self.notes)
        return table

    def to_markdown(self) -> str:
        """The table as Markdown has it."""
        lines = [f"### {self.title}", "", f"| {' | '.join(self.columns)} |"]
        lines.append("|---|" + "---:|" * (len(self.columns) - 1))
        lines += [f"| {' | '.join(self.format(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", *(f"{note}  " for note in self.notes), ""])

    def format(self, value: Value) -> str:
        """A value as text: numbers to `digits` significant digits, without powers of ten below a million."""
        if value is None:
            return "-"
        if isinstance(value, str | int):
            return str(value)
        if isnan(value):
            return "-"
        if value == 0 or not 1e-6 <= abs(value) < 1e6:
            return f"{value:.{self.digits}g}"
        rounded = float(f"{value:.{self.digits}g}")
        return f"{rounded:.{max(self.digits - 1 - floor(log10(abs(rounded))), 0)}f}"
