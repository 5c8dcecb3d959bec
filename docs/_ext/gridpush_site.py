"""What the site needs beyond Sphinx: equations as MathML, port diagrams, and pages made from the package itself."""

import html
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import Any, get_args
from urllib.parse import unquote

import yaml
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from latex2mathml.converter import convert
from pydantic import BaseModel
from pygments.lexers.special import TextLexer
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import gridpush_drake

LOGGER = logging.getLogger(__name__)

GENERATED = "reference/generated"
"""Where the pages go that are made from the package, below the sources; git ignores it."""

CODE = re.compile(r"(``.+?``|`[^`]+`)", re.DOTALL)
MARKUP = re.compile(r"(?<!\\)(\||(?<=\S)\*|\*(?=\S)|(?<=\w)_(?!\w))")


ARRAY = re.compile(r"~?numpy\.ndarray\[~?tuple\[.*?\], ~?numpy\.dtype\[~?numpy\.(\w+?)\d*\]\]")
ARRAY_LIKE = re.compile(
    r"~?numpy\._typing\._array_like\._Buffer.*?_NestedSequence\[complex \| bytes \| str\]"
)
CALLABLE = re.compile(r"~?collections\.abc\.Callable\[\[.*?\], .*?\](?=$|[ ,|\]])")
UNIT_ALONE = re.compile(r"^(:\w+ \w+:) (\w\.)$")
PYDANTIC = "Create a new model by parsing and validating input data from keyword arguments."
"""How the docstring of every model's constructor begins."""

FUNCTION = re.compile(r"(<m[io]>(?:log|exp|det|cov|diag|tr|asinh|clip|Huber)</m[io]>)")
LITERAL = re.compile(
    r"(^ *::\n\n(?:(?: {4,}.*)?\n)+|^ *\.\. \w+::\n(?:(?: {3,}.*)?\n)+)", re.MULTILINE
)
BARE_REPR = re.compile(r"&lt;Figure size [^&]*&gt;|&lt;[\w.]+(?: object)? at 0x[0-9a-f]+&gt;")
"""How a page shows a figure, or another object, that nobody has told it how to draw."""

INDENT = 4
"""Columns by which an equation stands to the right of the text about it."""


def to_mathml(latex: str, display: str) -> str:
    """Converts an equation; `aligned` is not known to the converter, `align*` is. Functions get a thin space."""
    text: str = convert(latex.replace("{aligned}", "{align*}"), display=display)
    return FUNCTION.sub(r'\1<mspace width="0.17em" />', text)


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Writes an inline equation as MathML."""
    translator.body.append(to_mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """Writes a displayed equation as MathML."""
    translator.body.append(f'<div class="math">{to_mathml(node.astext(), "block")}</div>\n')
    raise nodes.SkipNode


class PydrakeSystem(Directive):
    """`.. pydrake_system::`: a system between its input and its output ports, as Drake's documentation draws it."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Makes the table."""
        system = yaml.safe_load("\n".join(self.content))
        names = [
            [html.escape(str(port)) for port in system.get(side) or []]
            for side in ("input_ports", "output_ports")
        ]
        inputs = "<br>".join(f"{name} &rarr;" for name in names[0])
        outputs = "<br>".join(f"&rarr; {name}" for name in names[1])
        text = (
            f'<table class="drake-system"><tr><td class="drake-inputs">{inputs}</td>'
            f'<td class="drake-name">{html.escape(system["name"])}</td><td>{outputs}</td></tr></table>'
        )
        return [nodes.raw("", text, format="html")]


class StationDiagram(SphinxDirective):
    """`{station-diagram}`: the Diagram that `MakePushStation` makes of a scenario, drawn by Drake and Graphviz's `dot`.

    Without `dot` the description that Drake gives of it is shown as text.
    """

    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Draws the station."""
        from gridpush_drake import MakePushStation, PushScenario

        station = MakePushStation(
            PushScenario(object=self.arguments[0] if self.arguments else "claw_hammer")
        )
        text = station.GetGraphvizString(max_depth=1)
        if shutil.which("dot") is None:
            return [nodes.literal_block(text, text)]
        drawn = subprocess.run(
            ["dot", "-Tsvg"], input=text, capture_output=True, text=True, check=True
        ).stdout
        return [
            nodes.raw(
                "",
                f'<label class="drake-diagram" title="Click to enlarge"><input type="checkbox" hidden>'
                f"{drawn[drawn.index('<svg') :]}</label>",
                format="html",
            )
        ]


class PublicNames(SphinxDirective):
    """`{public-names}`: the names of `gridpush_drake` itself, each with the first line of what is said of it."""

    def run(self) -> list[nodes.Node]:
        """Makes the list."""
        public = self.env.app.gridpush_public
        lines = []
        for name in gridpush_drake.__all__:
            said = (getattr(gridpush_drake, name).__doc__ or "").partition("\n")[0]
            lines.append(f"* {{py:obj}}`{name} <{public[name]}>`: {said}")
        node = nodes.container()
        self.state.nested_parse(StringList(lines), 0, node)
        return [node]


def list_sections(schema: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yields the schemas of all parts of a scenario, those of its tasks among them, and of their parts."""
    from gridpush_drake.station.schema.fields import Config

    for field in schema.model_fields.values():
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, Config):
                yield part
                yield from list_sections(part)


class ScenarioSections(SphinxDirective):
    """`{scenario-sections}`: every part of a scenario's file, with its fields."""

    def run(self) -> list[nodes.Node]:
        """Makes the list."""
        from gridpush_drake import PushScenario

        lines = ["```{eval-rst}"]
        for part in dict.fromkeys(list_sections(PushScenario)):
            lines.append(f".. autoclass:: {part.__module__}.{part.__name__}")
        node = nodes.container()
        self.state.nested_parse(StringList([*lines, "```"]), 0, node)
        return [node]


def make_rst(
    app: Sphinx, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]
) -> None:
    """Makes reStructuredText of a docstring: indented equations stay as they are, |, * and _ are no markup."""
    out: list[str] = []
    directive = block = None
    last = ""
    for line in lines:
        indent = _indent(line)
        if line.strip():
            directive = None if directive is not None and indent <= directive else directive
            block = None if block is not None and indent < block else block
            if line.lstrip().startswith(".. "):
                directive = indent
            begins = (
                bool(out)
                and not out[-1].strip()
                and bool(last.strip())
                and indent >= _indent(last) + INDENT
            )
            if (
                begins
                and directive is None
                and block is None
                and not last.lstrip().startswith("* ")
            ):
                block = indent
                out += [" " * _indent(last) + "::", ""]
            last = line
        out.append(line)
    public = app.gridpush_public  # type: ignore[attr-defined]
    lines[:] = _escape("\n".join(out) + "\n", public).split("\n")[:-1]


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _escape(text: str, public: dict[str, str]) -> str:
    """Escapes what would be markup, outside literal blocks and directives; code in backticks leads to public names."""

    def mark(code: str) -> str:
        name = code.strip("`")
        return f":py:obj:`{name} <{public[name]}>`" if name in public else f"``{name}``"

    parts = LITERAL.split(text)
    for i in range(0, len(parts), 2):
        pieces = CODE.split(parts[i])
        pieces[::2] = [MARKUP.sub(r"\\\1", piece) for piece in pieces[::2]]
        pieces[1::2] = [mark(piece) for piece in pieces[1::2]]
        parts[i] = "".join(pieces)
    return "".join(parts)


def shorten_types(
    app: Sphinx,
    _what: str,
    name: str,
    obj: Any,
    _options: Any,
    _args: str | None,
    returns: str | None,
) -> tuple[str, str | None] | None:
    """Calls an array an array: shape and unit are in the docstring. Of a file's schema the fields say the defaults."""
    annotations = app.env.current_document.autodoc_annotations.get(name, {})
    for key, text in annotations.items():
        annotations[key] = ARRAY_LIKE.sub("array_like", ARRAY.sub(r"array of \1", text))
    return ("(**fields)", returns) if isinstance(obj, type) and issubclass(obj, BaseModel) else None


def shorten_field_types(
    _app: Sphinx, _what: str, _name: str, obj: Any, _options: Any, lines: list[str]
) -> None:
    """Does the same with the attributes' types, which stand in the docstring by now.

    Takes out Pydantic's own text, and keeps an "m." from being the first item of a list.
    """
    if isinstance(obj, type) and issubclass(obj, BaseModel) and PYDANTIC in lines:
        del lines[lines.index(PYDANTIC) :]
    for i, line in enumerate(lines):
        if line.startswith(":vartype"):
            lines[i] = CALLABLE.sub("function", ARRAY.sub(r"array of \1", line))
        else:
            lines[i] = UNIT_ALONE.sub(r"\1 \\\2", line)


def skip_settings(
    _app: Sphinx, _what: str, name: str, _obj: Any, skip: bool, _options: Any
) -> bool:
    """Leaves out how Pydantic is set."""
    return skip or name == "model_config"


def link_public_name(
    app: Sphinx, env: Any, node: pending_xref, contnode: nodes.Element
) -> nodes.Node | None:
    """Leads a name that stands in a module to where its package shows it."""
    target = node.get("reftarget", "")
    short = target.rsplit(".", 1)[-1]
    found = app.gridpush_public.get(target) or app.gridpush_public.get(short)  # type: ignore[attr-defined]
    if node.get("refdomain") != "py" or found is None or found == target:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", found, node, contnode)


def drop_symbols(app: Sphinx, doctree: nodes.document) -> None:
    """Takes the links off symbols, such as the n of a shape (n, 2), which are no names."""
    for node in list(doctree.findall(pending_xref)):
        target = node.get("reftarget", "")
        if (
            node.get("refdomain") == "py"
            and "." not in target
            and target not in app.gridpush_public
        ):  # type: ignore[attr-defined]
            node.replace_self(node.children)


class LinkReader(HTMLParser):
    """Collects where a page leads to, and what in it can be led to."""

    def __init__(self) -> None:
        """Has read nothing."""
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = {""}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Notes one element."""
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value and not value.startswith(("data:", "mailto:")):
                self.links.append(value)
                if tag in ("script", "img", "iframe", "link") and "//" in value:
                    self.links.append(f"{value} needs the network")


def check_links(app: Sphinx, error: Exception | None) -> None:
    """Warns of every link inside the site that leads nowhere, and of everything that a page would fetch elsewhere."""
    if error is not None or app.builder.format != "html":
        return
    root = Path(app.outdir)
    pages = {}
    for path in root.rglob("*.html"):
        pages[path.resolve()] = reader = LinkReader()
        reader.feed(path.read_text(encoding="utf-8"))
    for path, reader in pages.items():
        for link in reader.links:
            place, _, anchor = link.partition("#")
            target = (path.parent / unquote(place.partition("?")[0])).resolve() if place else path
            if "needs the network" not in link and (
                "//" in place
                or (
                    target.exists()
                    and (target not in pages or unquote(anchor) in pages[target].anchors)
                )
            ):
                continue
            LOGGER.warning("%s: %s leads nowhere", path.relative_to(root), link)


def find_bare_reprs(page: str) -> list[str]:
    """What a page shows as a line of text such as <Figure size 690x430>, where a picture should be."""
    return [html.unescape(found) for found in BARE_REPR.findall(page)]


def check_pictures(app: Sphinx, error: Exception | None) -> None:
    """Warns of every page that shows the name of a figure, or of another object, instead of a picture."""
    if error is not None or app.builder.format != "html":
        return
    root = Path(app.outdir)
    for path in sorted(root.rglob("*.html")):
        for found in find_bare_reprs(path.read_text(encoding="utf-8")):
            LOGGER.warning(
                "%s: shows the text %s; expected a picture, or a sentence",
                path.relative_to(root),
                found,
            )


def write_pages(app: Sphinx) -> None:
    """Writes the pages of the command line and of every package; files that are as they should be stay untouched."""
    folder = Path(app.srcdir) / GENERATED
    (folder / "python").mkdir(parents=True, exist_ok=True)
    _write(folder / "command_line.md", make_command_line_page())
    public: dict[str, str] = {}
    home = Path(gridpush_drake.__file__).parent
    stubs = [*home.glob("*/__init__.pyi"), *home.glob("*/*/__init__.pyi")]
    packages = sorted(".".join(stub.parent.relative_to(home).parts) for stub in stubs)
    for package in [*packages, "errors"]:
        module = import_module(f"gridpush_drake.{package}")
        for name in getattr(module, "__all__", vars(module)):
            if name.startswith("_"):
                continue
            thing = getattr(module, name)
            full = f"{module.__name__}.{name}"
            public.setdefault(f"{getattr(thing, '__module__', '')}.{name}", full)
            public.setdefault(name, full)
        title = f"gridpush_drake.{package}"
        text = f"{title}\n{'=' * len(title)}\n\n.. automodule:: {title}\n   :members:\n   :imported-members:\n"
        _write(folder / "python" / f"{package}.rst", text)
    app.gridpush_public = public  # type: ignore[attr-defined]


def make_command_line_page() -> str:
    """Returns the help of every command as a page in Markdown.

    It is what Typer writes, with two changes. In the lists of commands, Typer cuts long sentences
    off; here they are whole. And examples and options in the text are marked as code, for
    otherwise the site would turn the two hyphens of an option into a dash.
    """
    command = [
        sys.executable,
        "-m",
        "typer",
        "gridpush_drake.cli.main",
        "utils",
        "docs",
        "--name",
        "gridpush",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise ExtensionError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    text = done.stdout
    said = dict(re.findall(r"^#+ `(gridpush[ \w-]*)`\n\n(.+)$", text, re.MULTILINE))
    parts = re.split(r"^(#+ `(gridpush[ \w-]*)`)$", text, flags=re.MULTILINE)
    for i in range(3, len(parts), 3):
        above = parts[i - 1]
        parts[i] = re.sub(
            r"^\* `(\w[\w-]*)`: .*$",
            lambda found, above=above: (
                f"* `{found[1]}`: {said.get(f'{above} {found[1]}', found[0])}"
            ),
            parts[i],
            flags=re.MULTILINE,
        )
        parts[i - 1] = ""
    return "\n".join(map(mark_code, "".join(parts).split("\n")))


def mark_code(line: str) -> str:
    """Marks a line's example, or the options in its text, as code; what is code already stays."""
    if line.startswith("Example: "):
        return f"Example: `{line.removeprefix('Example: ')}`"
    pieces = line.split("`")
    # every other piece stands between two backquotes
    pieces[::2] = [re.sub(r"(?<![\w-])--[a-z][\w-]*", r"`\g<0>`", piece) for piece in pieces[::2]]
    return "`".join(pieces)


def allow_breaks(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Lets a page's browser break the names of files in tables after a slash or an underscore."""
    if "body" in context:
        context["body"] = add_break_places(context["body"])


def add_break_places(body: str) -> str:
    """Adds to the code in the tables of a page where a browser may break it.

    Otherwise a column with names of files is either so wide that nothing is left for the others, or
    breaks the names anywhere.
    """

    def mark(cell: re.Match[str]) -> str:
        return re.sub(r"(?<=[\w.])([/_])(?=\w)", r"\1<wbr>", cell[0])

    code = r'(?<=<span class="pre">)[^<]+'
    return re.sub(r"<td.*?</td>", lambda cell: re.sub(code, mark, cell[0]), body, flags=re.DOTALL)


def _write(path: Path, text: str) -> None:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Tells Sphinx of all this."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.add_lexer("csv", TextLexer)
    app.add_directive("pydrake_system", PydrakeSystem)
    app.add_directive("public-names", PublicNames)
    app.add_directive("scenario-sections", ScenarioSections)
    app.add_directive("station-diagram", StationDiagram)
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", make_rst, priority=100)
    app.connect("autodoc-process-docstring", shorten_field_types, priority=900)
    app.connect("autodoc-skip-member", skip_settings)
    app.connect("doctree-read", drop_symbols)
    app.connect("build-finished", check_links)
    app.connect("build-finished", check_pictures)
    app.connect("autodoc-process-signature", shorten_types, priority=900)
    app.connect("missing-reference", link_public_name)
    app.connect("html-page-context", allow_breaks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
