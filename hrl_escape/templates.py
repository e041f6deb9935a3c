"""HTML pages from jinja2 templates: every value is escaped, and data becomes JSON that cannot leave its script."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup


def render_template(package: str, name: str, **values: Any) -> str:
    """Fill the template `templates/<name>` of a package; text among the values is escaped, `Markup` is not."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     undefined=jinja2.StrictUndefined)
    page = environment.from_string((files(package) / "templates" / name).read_text(encoding="utf-8")).render(values)
    return page.encode("utf-8", "replace").decode("utf-8")  # a name from JSON may hold half a character


def embed_json(value: Any) -> Markup:
    """A JSON value as it can stand inside a script element; no tag and no comment can open in it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
