"""HTML pages from jinja2 templates: values are escaped, and data becomes JSON that cannot leave its script."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup


def render_template(package: str, name: str, **values: Any) -> str:
    """Render the template `templates/<name>` of a package; text values are escaped, `Markup` is not."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     undefined=jinja2.StrictUndefined)
    page = environment.from_string((files(package) / "templates" / name).read_text(encoding="utf-8")).render(values)
    return page.encode("utf-8", "replace").decode("utf-8")  # names from JSON may contain half a character


def embed_json(value: Any) -> Markup:
    """Return a JSON value for use inside a script element: it cannot open a tag or a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
