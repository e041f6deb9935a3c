"""Publish result pages: a person's words, with numbers of studies as fields and rules that guard the claims.

A page is `pages/NAME.py`, which names its studies and rules, and `pages/NAME.md.j2`, its words. `README.md` shows how
to write one.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

import jinja2
from jinja2 import nodes
from jinja2.ext import Extension
from jinja2.parser import Parser

from hrl_escape.errors import EscapeError, UnknownNameError
from hrl_escape.figures import save_figure
from hrl_escape.files import write_text
from hrl_escape.names import count_nouns, join_words
from studies.figures import THEMES
from studies.running import open_store
from studies.study import ROOT, Findings, find_study
from studies.tables import format_interval, format_short, format_span
from studies.titles import find_title

__all__ = ["ResultPage", "Rules", "UnsupportedClaimError", "check_form", "list_pages", "load_findings", "load_page",
           "publish", "render_page"]

FOLDER = ROOT / "pages"
LONGEST_FINDING, MOST_NUMBERS = 20, 1
NUMBER = re.compile(r"\d[\d,.]*")

Rules: TypeAlias = Mapping[str, Callable[[Any], bool]]
"""Name of a claim -> whether the numbers support it. The numbers come from all studies of the page, by name."""


class UnsupportedClaimError(EscapeError):
    """The data do not support a sentence of a page, or a page is not of the common form."""


@dataclass(frozen=True)
class ResultPage:
    """A published page.

    Attributes:
        name: of its file and address, such as `do-options-help`.
        studies: names of the studies it is about.
        rules: a rule for each claim.
        template: path of its words.
    """

    name: str
    studies: tuple[str, ...]
    rules: Rules
    template: Path


@dataclass
class _Rendering:
    """State of one rendering: the claims met, the failures found and the figures shown."""

    page: ResultPage
    numbers: SimpleNamespace
    claims: dict[str, str] = field(default_factory=dict[str, str])
    failures: list[str] = field(default_factory=list[str])
    figures: list[str] = field(default_factory=list[str])

    def check(self, name: str, line: int, sentence: str) -> str:
        """Check the rule of a claim, and return its sentence."""
        place = f"{self.page.template.parent.name}/{self.page.template.name}:{line}"
        if name not in self.page.rules:
            self.failures.append(f"{place}: no rule is named {name!r}")
        elif not self.page.rules[name](self.numbers):
            self.failures.append(f"{place}: the data do not support {sentence.strip()!r} (rule {name!r}). "
                                 "Rewrite the sentence and its rule")
        self.claims[name] = sentence
        return sentence

    def show(self, name: str, alternative: str) -> str:
        """Markdown of a figure."""
        self.figures.append(name)
        return f"![{alternative}](figures/{name}.svg)"


class _Claims(Extension):
    """`{% claim "name" %}sentence{% endclaim %}`: the rule of this name guards the sentence."""

    tags = {"claim"}

    def parse(self, parser: Parser) -> nodes.Node:
        """Read the block."""
        line = next(parser.stream).lineno
        name = parser.parse_expression()
        body = parser.parse_statements(("name:endclaim",), drop_needle=True)
        return nodes.CallBlock(self.call_method("check", [name, nodes.Const(line)]), [], [], body).set_lineno(line)

    def check(self, name: str, line: int, caller: Callable[[], str]) -> str:
        """Check the claim when it is rendered."""
        rendering: Any = self.environment.globals["rendering"]
        return rendering.check(name, line, caller())


def list_pages() -> list[str]:
    """Names of all pages."""
    return sorted(path.name.removesuffix(".md.j2").replace("_", "-") for path in FOLDER.glob("*.md.j2"))


def load_page(name: str) -> ResultPage:
    """A page by its name.

    Raises:
        UnknownNameError: no such page.
    """
    if name not in list_pages():
        raise UnknownNameError("result page", name, list_pages())
    stem = name.replace("-", "_")
    module = importlib.import_module(f"studies.pages.{stem}")
    return ResultPage(name, tuple(module.STUDIES), module.RULES, FOLDER / f"{stem}.md.j2")


@cache
def load_findings(study: str) -> Findings:
    """Analyse the committed raw data of a study, once in a process."""
    found = find_study(study)
    return found.analysis.analyse(found, open_store(found, None).load())


def render_page(page: ResultPage, findings: Mapping[str, Findings]) -> tuple[str, list[str]]:
    """Text of a page, and the names of its figures.

    Args:
        page: to render.
        findings: of each of its studies, by name.

    Raises:
        UnsupportedClaimError: the numbers do not support a claim, or the page is not of the common form; names the
            lines and sentences to rewrite.
    """
    numbers = SimpleNamespace(**{name.replace("-", "_"): found.numbers for name, found in findings.items()})
    rendering = _Rendering(page, numbers)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(page.template.parent), undefined=jinja2.StrictUndefined, autoescape=False,
        keep_trailing_newline=True, extensions=[_Claims])
    environment.filters |= {"num": format, "short": format_short, "interval": format_interval, "span": format_span,
                            "count": count_nouns, "words": join_words, "title": find_title}
    environment.globals |= vars(numbers) | {
        "rendering": rendering, "figure": rendering.show,
        "tables": {name: text for found in findings.values() for name, text in found.tables.items()}}
    text = environment.get_template(page.template.name).render()
    unused = sorted(page.rules.keys() - rendering.claims.keys())
    failures = [*rendering.failures, *(f"rule {name!r} guards no sentence" for name in unused),
                *check_form(text, rendering.claims.values())]
    if failures:
        raise UnsupportedClaimError("\n".join([f"page {page.name}:", *failures]))
    return text, rendering.figures


def check_form(text: str, claims: Iterable[str]) -> list[str]:
    """Departures of a page from the common form: parts in order, a short finding, claims where claims belong."""
    found = re.match(r"# [^\n]+\n\n\*\*(?P<finding>[^*]+)\*\*\n\n!\[[^\]]+\]\(figures/\S+\)\n(?:\n[^\n]+\n)?\n"
                     r"\*\*Takeaway\.\*\* (?P<takeaway>[^\n]+)\n\n## Setup\n\n(?P<setup>(?:- [^\n]+\n)+)\n"
                     r"Terms: [^\n]+\n\n## Limits\n\n(?:- [^\n]+\n)+\n(?:.*\n)?<details>", text, re.DOTALL)
    if not found:
        return ["the page is not in the order title, finding in bold, figure (and a caption), **Takeaway.**, ## Setup "
                "(a list), Terms: (a line with links to the glossary), ## Limits (a list), <details>"]
    failures, guarded = [], " ".join(claims)
    finding, takeaway = found["finding"], found["takeaway"]
    if len(finding.split()) > LONGEST_FINDING:
        failures.append(f"the finding has {len(finding.split())} words, {LONGEST_FINDING} at most")
    if len(NUMBER.findall(finding)) > MOST_NUMBERS:
        failures.append(f"the finding has more than {MOST_NUMBERS} number")
    if found["setup"].count("\n") > 3:
        failures.append("the setup has more than three lines")
    if ". " in takeaway:
        failures.append("the takeaway has more than one sentence")
    failures += [f"no rule guards the {part}" for part, words in (("finding", finding), ("takeaway", takeaway))
                 if words not in guarded]
    return failures


def publish(page: ResultPage, docs: Path, findings: Mapping[str, Findings] | None = None) -> None:
    """Write a page and its figures, in both themes.

    Args:
        page: to write.
        docs: folder that takes page and figures.
        findings: of each of its studies, by name; by default from committed raw data.

    Raises:
        UnsupportedClaimError: see `render_page`.
        FileWriteError: a file cannot be written.
    """
    findings = {name: load_findings(name) for name in page.studies} if findings is None else findings
    text, shown = render_page(page, findings)
    drawings = {name: draw for found in findings.values() for name, draw in found.figures.items()}
    for name in shown:
        for theme in THEMES:
            save_figure(docs / "figures" / f"{name}{theme.suffix}.svg", drawings[name](theme))
    write_text(docs / f"{page.name}.md", text)
