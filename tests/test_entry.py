"""What people meet first: the package's page on an index, and the recipe of the container."""

import json
import re
import shlex
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from gridpush_drake.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
CONTAINER = ROOT / ".devcontainer"
HOOK = ROOT / "docs/_ext/long_description.py"

pytestmark = pytest.mark.skipif(
    not (HOOK.exists() and CONTAINER.exists()), reason="a wheel's tests have no repository"
)

LINK = re.compile(r"\]\(([^)]+)\)")


def convert(text):
    """Converts a page by the hook of the build."""
    spec = spec_from_file_location("long_description", HOOK)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.make_long_description(text)


def test_the_page_on_an_index_has_no_link_that_leads_nowhere_there():
    text = (ROOT / "README.md").read_text()
    page = convert(text)
    targets = LINK.findall(page)
    assert targets
    assert all(target.startswith(("https://", "#")) for target in targets), targets
    assert "![" not in page
    # Nothing else is lost: what remains of a link is its words
    words = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    for mark in (words, page):
        assert "A robot pushes an object that it has never seen before." in mark
    assert re.sub(r"\W+", "", LINK.sub("", words)) == re.sub(r"\W+", "", LINK.sub("", page))


def read_dockerfile():
    """The instructions of the recipe, each on a line, as pairs of a name and its text."""
    text = (CONTAINER / "Dockerfile").read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [tuple(line.split(maxsplit=1)) for line in lines]


def test_the_recipe_of_the_container_says_what_the_page_on_installing_says():
    steps = read_dockerfile()
    assert steps[0][0] == "FROM"
    assert {name for name, _ in steps} == {"FROM", "RUN", "WORKDIR", "COPY", "CMD"}
    page = (ROOT / "docs/install.md").read_text()
    (told,) = re.findall(r"sudo apt-get install (git .*)", page)
    (install,) = [text for name, text in steps if name == "RUN" and "apt-get install" in text]
    packages = install.partition("--no-install-recommends")[2].partition("&&")[0].split()
    # The image has its own Python, in which environments can be made
    assert set(packages) == set(told.split()) - {"python3-venv"}
    runs = " ".join(text for name, text in steps if name == "RUN")
    assert "pip install --no-cache-dir . && gridpush warm-up" in runs
    (command,) = [json.loads(text) for name, text in steps if name == "CMD"]
    assert command[0] == "gridpush" and command[1] in COMMANDS


def test_the_container_for_editors_is_that_of_the_recipe():
    told = json.loads((CONTAINER / "devcontainer.json").read_text())
    recipe = CONTAINER / told["build"]["dockerfile"]
    context = (CONTAINER / told["build"]["context"]).resolve()
    assert recipe.exists()
    assert context == ROOT
    folder = told["workspaceFolder"]
    mount = dict(part.split("=") for part in told["workspaceMount"].split(","))
    assert mount["target"] == folder
    words = shlex.split(told["postCreateCommand"])
    assert words[: words.index("&&")] == ["pip", "install", "-e", ".[dev]"]
    assert words[words.index("&&") + 1 :] == ["gridpush", "warm-up"]
