"""Pages that can be read in two places: as plain Markdown on a code host, and as a built site.

A code host shows a page as it lies in the repository. Directives of Sphinx would stand there as
text, and pages that are made when the site is built are missing. Therefore three rules hold for
all pages, and this extension undoes them when the site is built:

* What only the site can show stands in a comment. It begins with a line `<!-- site` and ends with
  a line `-->`. A code host hides it; the site shows it.
* What only a code host needs stands between the lines `<!-- code host -->` and
  `<!-- end of code host -->`. The site leaves it out.
* A link to a name or a command leads to a file of the package, which is always there, such as
  `gridpush_drake/station/tasks/task.py`. The site leads to the page that is made from that file.

`tests/cli/test_code_host.py` checks what a code host shows.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # a test converts pages where Sphinx is not installed
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]

SITE_ONLY = re.compile(r"^<!-- site\n(.*?)^-->$", re.MULTILINE | re.DOTALL)
CODE_HOST_ONLY = re.compile(
    r"^<!-- code host -->\n.*?^<!-- end of code host -->\n?", re.MULTILINE | re.DOTALL
)
LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)*[\w./-]+)\)")
CODE_NAME = re.compile(r"`(\w+)`")

SITE_PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "gridpush_drake/__init__.pyi": "reference/python.md",
    "gridpush_drake/cli": "reference/generated/command_line.md",
    "gridpush_drake/errors.py": "reference/generated/python/errors.rst",
}
"""Files and folders outside `docs`, and the page of the site that stands for each."""


def find_site_page(target: str) -> str | None:
    """Finds the site's page for a file of the repository.

    Args:
        target: path of a file or folder, from the repository's root.

    Returns:
        Path of the page from the folder `docs`, or None where the site has no page for it.
    """
    if target in SITE_PAGES:
        return SITE_PAGES[target]
    path = PurePosixPath(target)
    if path.parts[:1] == ("systems",):
        path = "gridpush_drake" / path
    if path.parts[:1] != ("gridpush_drake",):
        return None
    # A module is documented on the page of the package around it that has public names.
    for folder in (path, *path.parents):
        if len(folder.parts) > 1 and (ROOT / folder / "__init__.pyi").is_file():
            return f"reference/generated/python/{'.'.join(folder.parts[1:])}.rst"
    return None


def convert_page(text: str, page: str, public: dict[str, str]) -> str:
    """Makes the site's form of a page from the form that a code host shows.

    Args:
        text: the page.
        page: its path from the folder `docs`.
        public: full name of each public name of the package.

    Returns:
        The page with what only the site shows, without what only a code host needs, and with links
        into the package replaced by links to pages of the site.
    """
    folder = os.path.dirname(page)  # noqa: PTH120 (a path within the site, with forward slashes)

    def convert_link(found: re.Match[str]) -> str:
        title, link = found.groups()
        target = os.path.normpath(os.path.join("docs", folder, link))  # noqa: PTH118
        site_page = find_site_page(target)
        if site_page is None:
            return found[0]
        name = CODE_NAME.fullmatch(title)
        if name and name[1] in public:
            return f"{{py:obj}}`{name[1]} <{public[name[1]]}>`"
        return f"[{title}]({os.path.relpath(site_page, folder or '.')})"

    text = CODE_HOST_ONLY.sub("", text)
    text = SITE_ONLY.sub(r"\1", text)
    return LINK.sub(convert_link, text)


def convert_source(app: Sphinx, docname: str, content: list[str]) -> None:
    """Converts a page that Sphinx has just read."""
    page = str(app.env.doc2path(docname, base=False))
    if page.endswith(".md") and "generated" not in page:
        content[0] = convert_page(content[0], page, app.gridpush_public)  # type: ignore[attr-defined]


def setup(app: Sphinx) -> dict[str, Any]:
    """Connects the extension to Sphinx."""
    app.connect("source-read", convert_source)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
