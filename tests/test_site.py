"""The site's own checks, and what its tutorials need."""

import ast
import re
import sys
from importlib.metadata import requires
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"

INSTALLED = {"cv2": "opencv-python-headless", "pydrake": "drake", "yaml": "pyyaml", "PIL": "pillow"}
"""Names under which packages are imported that are installed under another."""


pytestmark = pytest.mark.skipif(
    not DOCS.is_dir(), reason="a wheel's tests have no docs beside them"
)


@pytest.fixture
def site(monkeypatch):
    for package in ("sphinx", "latex2mathml"):
        pytest.importorskip(package)
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    import gridpush_site

    return gridpush_site


def test_a_page_with_a_figure_s_name_in_place_of_a_picture_is_found(site):
    page = (
        "<p>A sentence &lt;b&gt; of words</p><pre>&lt;Figure size 690x430 with 1 Axes&gt;</pre>"
        "<pre>&lt;matplotlib.lines.Line2D at 0x7f0a&gt; &lt;some.Thing object at 0x12ab&gt;</pre>"
    )
    assert site.find_bare_reprs(page) == [
        "<Figure size 690x430 with 1 Axes>",
        "<matplotlib.lines.Line2D at 0x7f0a>",
        "<some.Thing object at 0x12ab>",
    ]
    assert site.find_bare_reprs("<img src='x.png'> a &lt;Figure&gt; at 0x12") == []


def test_a_help_that_cannot_be_made_says_why(site, monkeypatch, tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho cma: is not installed >&2\nexit 2\n")
    python.chmod(0o755)
    monkeypatch.setattr(site.sys, "executable", str(python))
    with pytest.raises(site.ExtensionError, match=r"ended with 2:\ncma: is not installed"):
        site.make_command_line_page()


@pytest.mark.parametrize(
    "tutorial", sorted(DOCS.glob("tutorials/*.md")), ids=lambda path: path.stem
)
def test_tutorials_need_the_package_and_what_comes_with_it_only(tutorial):
    come_along = {
        re.split(r"[^\w-]", line)[0]
        for line in requires("gridpush-drake")
        if "extra ==" not in line
    }
    for code in re.findall(r"^```{code-cell}\n(.*?)^```", tutorial.read_text(), re.M | re.S):
        for node in ast.walk(ast.parse(code)):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [node.module]
            for module in modules:
                name = module.partition(".")[0]
                known = name == "gridpush_drake" or name in sys.stdlib_module_names
                assert known or INSTALLED.get(name, name) in come_along, f"{tutorial}: {module}"


def test_names_of_files_in_tables_break_between_their_words(site):
    code = '<code class="docutils literal"><span class="pre">a_b/c_d.py</span></code>'
    broken = site.add_break_places(f"<p>{code}</p><td><p>{code} and/or</p></td>")
    assert broken.count("<wbr>") == 3
    assert (
        '<td><p><code class="docutils literal"><span class="pre">a_<wbr>b/<wbr>c_<wbr>d.py<'
        in broken
    )


def test_the_page_of_commands_marks_examples_and_options_as_code(site):
    assert site.mark_code("Example: gridpush demo --out x") == "Example: `gridpush demo --out x`"
    marked = "With `--go` or `--pose-delay` a-b--c, `gridpush --help`"
    assert site.mark_code("With --go or --pose-delay a-b--c, `gridpush --help`") == marked


def test_the_page_of_commands_has_whole_sentences(site):
    page = site.make_command_line_page()
    said = re.findall(r"^\* `([a-z][\w-]*)`: (.*)$", page, re.MULTILINE)
    assert len(said) > 30
    assert [name for name, sentence in said if not sentence.endswith(".")] == []
    assert "* `--version`: Print the version." in page
