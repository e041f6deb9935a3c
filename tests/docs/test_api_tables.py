"""Each call in the tables "to do X, call Y" of the API pages fits the signature of the public name it begins with."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PAGES = Path(__file__).parents[2] / "docs/api"


def list_calls() -> Iterator[tuple[str, str]]:
    """Package and call of every line."""
    for page in sorted(PAGES.glob("*.md")):
        for package, lines in re.findall(r"```{api} (\S+)\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            for line in lines.strip().splitlines():
                yield package, line.rpartition(" | ")[2]


def bind(package: str, call: str) -> None:
    """Bind the arguments of a call to its signature. Raises TypeError if they do not fit."""
    tree = ast.parse(call, mode="eval").body
    names = re.split(r"\W", re.match(r"[\w.]+", call)[0])  # type: ignore[index]
    thing = importlib.import_module(package)
    for name in names:
        is_method = inspect.isclass(thing) and inspect.isfunction(inspect.getattr_static(thing, name))
        thing = getattr(thing, name)
    if isinstance(tree, ast.Call):
        own = [object()] if len(names) > 1 and is_method else []
        inspect.signature(thing).bind(*own, *(object() for _ in tree.args), **{
            str(keyword.arg): object() for keyword in tree.keywords})


@pytest.mark.parametrize(("package", "call"), list(list_calls()))
def test_a_call_fits_its_signature(package: str, call: str):
    bind(package, call)


def test_every_package_with_a_page_has_a_table_and_a_wrong_call_is_found():
    assert len({package for package, _ in list_calls()}) == len(list(PAGES.glob("*.md"))) - 2  # index and errors
    with pytest.raises(TypeError):
        bind("hrl_escape.env", "generate(config, seed, size=3)")
    with pytest.raises(TypeError):
        bind("hrl_escape.planning", "RoomPlanner.plan(state)")
