"""Sphinx's settings. Build with `sphinx-build -W docs /tmp/site`; the result needs no network to be read."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import ziamath

import gridpush_drake

project = "gridpush_drake"
author = "The gridpush_drake authors"
release = version = gridpush_drake.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "gridpush_site",
    "code_host",
    "notebooks",
]
exclude_patterns = ["_build", "_ext", "**.ipynb_checkpoints", "reference/generated/notebooks"]

html_theme = "furo"
html_title = "gridpush_drake"
html_static_path = [
    "_static",
    str(Path(ziamath.__file__).parent / "fonts"),
]  # a font with mathematics
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_math_renderer = "mathml"  # drawn by the browser itself: no script, no network

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
smartquotes_action = "qe"  # "--" may be that of an option

nb_execution_mode = "force"
nb_execution_in_temp = True  # notebooks write files
nb_execution_timeout = 120  # s a cell
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autoclass_content = "both"  # a constructor's arguments, too
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_use_ivar = True
suppress_warnings = ["config.cache"]
