"""The pages of the project as a code host shows them, and how the site is made of them.

On a code host every page is plain Markdown: links must lead to files of the repository, and nothing
that only Sphinx understands may be visible.
"""

import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted(page for page in DOCS.rglob("*.md") if "generated" not in page.parts),
]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES if page.is_file()}
NAMES = {page: str(page.relative_to(ROOT)) for page in TEXTS}

CODE = re.compile(r"^```([^\n]*)\n.*?^```", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
SHOWS_CODE = ("{code-cell}", "{code-block}")
"""Directives that a code host shows as the code that is in them."""

pytestmark = pytest.mark.skipif(
    not DOCS.is_dir(), reason="a wheel's tests have no docs beside them"
)
each_page = pytest.mark.parametrize(
    "page", sorted(TEXTS), ids=[NAMES[page] for page in sorted(TEXTS)]
)


def load_extension(name):
    """Imports an extension of the site from its file."""
    spec = spec_from_file_location(name, DOCS / f"_ext/{name}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def find_anchors(text):
    """The anchors that a code host makes of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", text), re.MULTILINE)
    headings = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@each_page
def test_links_lead_to_files_of_the_repository(page):
    tracked = set(
        subprocess.run(
            ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT, capture_output=True, text=True, check=False,
        ).stdout.splitlines()
    )  # fmt: skip
    lost = []
    for link in LINK.findall(CODE.sub("", TEXTS[page])):
        place, _, anchor = link.partition("#")
        if "://" in link or link.startswith("mailto:"):
            continue
        target = (page.parent / place).resolve() if place else page
        found = target.exists()
        if found and tracked:
            name = str(target.relative_to(ROOT))
            found = target.is_dir() or name in tracked
        if found and anchor:
            found = anchor in find_anchors(target.read_text(encoding="utf-8"))
        if not found:
            lost.append(link)
    assert lost == []


def find_markup(text):
    """What a code host would show of markup that is Sphinx's alone."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    visible = COMMENT.sub("", text)
    found = [
        info for info in CODE.findall(visible) if "{" in info and not info.startswith(SHOWS_CODE)
    ]
    visible = CODE.sub("", visible)
    found += re.findall(r"^:::.*$|^\([\w-]+\)=$|^% .*$", visible, re.MULTILINE)
    return found + re.findall(r"\{[a-z]+(?::[a-z]+)?\}`[^`]*`", visible)


@each_page
def test_nothing_is_visible_that_only_sphinx_understands(page):
    assert find_markup(TEXTS[page]) == []


def test_markup_is_found():
    text = "# Page\n\n```{toctree}\na\n```\n\n(label)=\n:::{note}\n{py:obj}`Push`\n"
    assert len(find_markup(text)) == 4
    hidden = "<!-- site\n```{toctree}\na\n```\n-->\n```{code-cell}\n1\n```\n"
    assert find_markup(hidden) == []


def test_comments_that_the_site_opens_are_whole():
    code_host = load_extension("code_host")
    opened = 0
    for page, text in TEXTS.items():
        if "docs" not in page.parts or page.parent == ROOT:
            continue
        site = code_host.convert_page(text, str(page.relative_to(DOCS)), {})
        assert "<!-- site" not in site, NAMES[page]
        assert "code host -->" not in site, NAMES[page]
        opened += "<!-- site" in text
    assert opened >= 8


def test_the_site_shows_its_own_form_of_a_page():
    convert_page = load_extension("code_host").convert_page
    text = (
        "<!-- code host -->\nSeen on a code host.\n<!-- end of code host -->\n"
        "<!-- site\n```{toctree}\na\n```\n-->\n"
        "[`StationTask`](../gridpush_drake/station/tasks/task.py) "
        "[the tasks](../gridpush_drake/station/tasks/task.py) "
        "[`PushStatus` and others](../systems/base/messages.py) [commands](../gridpush_drake/cli) "
        "[install](install.md) [scenario](../models/scenarios/default.yaml)\n"
    )
    public = {"StationTask": "gridpush_drake.station.StationTask"}
    made = "reference/generated"
    assert convert_page(text, "extending.md", public) == (
        "```{toctree}\na\n```\n\n"
        "{py:obj}`StationTask <gridpush_drake.station.StationTask>` "
        f"[the tasks]({made}/python/station.rst) "
        f"[`PushStatus` and others]({made}/python/systems.rst) "
        f"[commands]({made}/command_line.md) "
        "[install](install.md) [scenario](../models/scenarios/default.yaml)\n"
    )
    link = "[`gridpush_drake.gym`](../../gridpush_drake/gym/__init__.pyi)"
    assert convert_page(link, "howto/gym.md", public) == (
        "[`gridpush_drake.gym`](../reference/generated/python/gym.rst)"
    )


def test_every_package_is_listed():
    home = ROOT / "gridpush_drake"
    stubs = [*home.glob("*/__init__.pyi"), *home.glob("*/*/__init__.pyi")]
    packages = {
        ".".join(("gridpush_drake", *stub.parent.relative_to(home).parts)) for stub in stubs
    }
    assert len(packages) > 10
    listed = re.findall(r"^\| \[`([\w.]+)`\]", TEXTS[DOCS / "reference/python.md"], re.MULTILINE)
    # a module, and a package whose modules are imported one by one, for each needs an extra
    without_stub = {"gridpush_drake.errors", "gridpush_drake.interop"}
    assert set(listed) == packages | without_stub


def test_every_tutorial_becomes_a_notebook_that_installs_the_package(tmp_path, monkeypatch):
    pytest.importorskip("myst_nb", reason="the site's packages are not installed")
    notebooks = load_extension("notebooks")
    wheel = "gridpush_drake-1.2.3-py3-none-any.whl"
    tutorials = [text for text in TEXTS.values() if notebooks.NOTEBOOK_PAGE.match(text)]
    assert len(tutorials) >= 7
    for text in tutorials:
        notebook = notebooks.convert_tutorial(text, wheel)
        sources = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
        assert sources[1:] == [
            re.sub(r"\A(:[^\n]*\n)+\n?", "", code).strip("\n")
            for code in re.findall(
                r"^```\{code-cell\}[^\n]*\n(.*?)\n?^```", text, re.MULTILINE | re.DOTALL
            )
        ]
        assert wheel in notebook.cells[0].source
        assert not re.search(r"\]\([\w./]+\.md", "".join(cell.source for cell in notebook.cells))
    exec(compile(sources[0], "install", "exec"), {})  # the package is here: nothing happens
    monkeypatch.chdir(tmp_path)
    elsewhere = sources[0].replace('find_spec("gridpush_drake")', 'find_spec("not_installed")')
    with pytest.raises(FileNotFoundError, match=rf"Upload {wheel} to {tmp_path}"):
        exec(compile(elsewhere, "install", "exec"), {})
    (tmp_path / wheel).touch()
    commands = []
    monkeypatch.setattr(subprocess, "run", lambda command, **_options: commands.append(command))
    exec(compile(elsewhere, "install", "exec"), {})
    assert commands == [[sys.executable, "-m", "pip", "install", "--quiet", wheel]]
