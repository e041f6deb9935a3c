"""How the site is built: `make docs`, or sphinx-build docs build/docs."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from hrl_escape import __version__  # noqa: E402  # the checkout's, not an installed one

project = "hrl-escape"
author = "The hrl-escape contributors"
version = release = __version__

extensions = [
    "agent_table",
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "api",
    "environments",
    "findings",
    "gallery",
    "mathematics",
    "pictures",
    "redirects",
    "reference",
    "tables",
    "themes",
    "tutorials",
]
exclude_patterns = ["_build", "_ext", "images"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
default_role = "code"  # docstrings write `names` as Markdown does
suppress_warnings = ["toc.empty_glob"]  # results arrive as their commands write them

napoleon_use_ivar = True  # fields of a NamedTuple or dataclass are listed once, with their class
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
add_module_names = False
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = "hrl-escape"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
templates_path = []
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1d4474", "color-brand-content": "#2f6db5"},
    "dark_css_variables": {"color-brand-primary": "#8fbcf0", "color-brand-content": "#8fbcf0"},
}
