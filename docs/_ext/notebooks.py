"""The tutorials as notebooks (.ipynb) to be downloaded, and the wheel that they install.

A notebook that is opened elsewhere, for example in Google Colab, finds no package there. So its
first cell installs the wheel, which is uploaded beside it. Where the package is installed already
that cell does nothing. No public address of this project is assumed anywhere.

When the site is built, every tutorial page gets links to its notebook and to the wheel. Without the
site,

    python docs/_ext/notebooks.py FOLDER

writes all notebooks and the wheel into a folder.
"""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
from myst_nb.core.read import read_myst_markdown_notebook
from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs/tutorials"

FOLDER = "reference/generated/notebooks"
"""Where notebooks and wheel are written, below the site's sources; git ignores it."""

NOTEBOOK_PAGE = re.compile(r"\A---\n.*?file_format: mystnb.*?\n---\n", re.DOTALL)
TITLE = re.compile(r"^# .+\n", re.MULTILINE)
PAGE_LINK = re.compile(r"\[([^\]]+)\]\((?:\.\./)*[\w./-]+(?:#[\w-]+)?\)")

INTRODUCTION = """\
*This notebook needs the package `gridpush_drake`. If it is not installed where you run this, put the file
`{wheel}` beside the notebook (in Google Colab: click on the folder symbol at the left, then upload it).
The first cell installs it.*
"""

INSTALL = """\
# Installs the package, unless it is installed already.
import importlib.util
import subprocess
import sys
from pathlib import Path

if importlib.util.find_spec("gridpush_drake") is None:
    wheel = Path("{wheel}")
    if not wheel.is_file():
        raise FileNotFoundError(f"Upload {{wheel}} to {{Path.cwd()}}, then run this cell again.")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", str(wheel)], check=True)"""

LINKS = """
This page is a notebook. To run it yourself, download {{download}}`{notebook} </{folder}/{notebook}>` and open it in
Jupyter. To run it in Google Colab, download {{download}}`{wheel} </{folder}/{wheel}>`, too:
[how to open both there](index.md#to-run-a-tutorial-in-google-colab).
"""


def build_wheel(folder: Path) -> Path:
    """Builds the package's wheel into a folder and returns its path."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel"]
    subprocess.run(
        [*command, "--directory", str(folder)], cwd=ROOT, check=True, capture_output=True
    )
    return max(folder.glob("gridpush_drake-*.whl"), key=lambda path: path.stat().st_mtime)


def convert_tutorial(text: str, wheel: str) -> nbformat.NotebookNode:
    """Converts a tutorial to a notebook whose first cell installs the package.

    Args:
        text: the tutorial, in MyST's Markdown.
        wheel: name of the wheel's file.

    Returns:
        The notebook. Links to other pages, which would lead nowhere, are replaced by their text.
    """
    notebook = read_myst_markdown_notebook(text)
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = PAGE_LINK.sub(r"\1", cell.source)
        cell.metadata.pop("_source_map", None)
    notebook.cells[:0] = [
        nbformat.v4.new_markdown_cell(INTRODUCTION.format(wheel=wheel)),
        nbformat.v4.new_code_cell(INSTALL.format(wheel=wheel)),
    ]
    for i, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{i}"  # random ones would make a new file at every build
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    for key in ("file_format", "source_map"):
        notebook.metadata.pop(key, None)
    nbformat.validate(notebook)
    return notebook


def write_notebooks(folder: Path) -> str:
    """Writes the wheel and all tutorials as notebooks into a folder, and returns the wheel's name."""
    folder.mkdir(parents=True, exist_ok=True)
    wheel = build_wheel(folder).name
    for page in sorted(TUTORIALS.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if NOTEBOOK_PAGE.match(text):
            notebook = convert_tutorial(text, wheel)
            nbformat.write(notebook, folder / f"{page.stem}.ipynb")
    return wheel


def write_site_notebooks(app: Sphinx) -> None:
    """Writes wheel and notebooks where the site's pages find them."""
    app.gridpush_wheel = write_notebooks(Path(app.srcdir) / FOLDER)  # type: ignore[attr-defined]


def add_links(app: Sphinx, docname: str, content: list[str]) -> None:
    """Adds links to notebook and wheel below the title of a tutorial."""
    if docname.startswith("tutorials/") and NOTEBOOK_PAGE.match(content[0]):
        links = LINKS.format(
            notebook=f"{docname.rpartition('/')[2]}.ipynb",
            wheel=app.gridpush_wheel,  # type: ignore[attr-defined]
            folder=FOLDER,
        )
        content[0] = TITLE.sub(lambda title: title[0] + links, content[0], count=1)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connects the extension to Sphinx."""
    app.connect("builder-inited", write_site_notebooks)
    app.connect("source-read", add_links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write_notebooks(Path(sys.argv[1]).resolve())
