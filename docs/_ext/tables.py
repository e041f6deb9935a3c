"""Tables that are read from the package: knobs, agents' settings, logged metrics, names, the command line.

Each directive writes Markdown and has it parsed in place, so nothing on the site repeats by
hand what a dataclass or a registry says.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import re
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

from benchmarks import speed
from hrl_escape.agents.recommended import RECOMMENDED, format_answer
from hrl_escape.agents.registry import (
    KERAS_RL,
    get_agent_class,
    get_recipe,
    join_name,
    list_agents,
    list_hierarchy_agents,
    list_recipes,
)
from hrl_escape.agents.training.results import METRICS
from hrl_escape.cli import main
from hrl_escape.data.catalogue import RECORDING_KINDS, RUNGS, DataSpec
from hrl_escape.data.published import read_published
from hrl_escape.env.kinematics import Rules
from hrl_escape.env.observations.base import list_observations, make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.settings import describe_fields, read_field_documents
from studies.tuning import load_tuning


def find(path: str) -> Any:
    """What a dotted path names."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def make_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [list(head), ["---"] * len(head), *map(list, rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def run_command(*arguments: str) -> str:
    """What `hrl-escape` prints; a command that fails fails the build."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if main(arguments):
            raise ExtensionError(f"hrl-escape {' '.join(arguments)} failed")
    return printed.getvalue()


@cache
def list_hierarchical() -> dict[str, str]:
    """Agents with a task hierarchy, and the line of `hrl-escape list` about each."""
    (entries,) = json.loads(run_command("list", "hierarchical", "--json")).values()
    return entries


class Table(SphinxDirective):
    """A directive that is replaced by the Markdown it writes."""

    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Write and parse."""
        return self.parse_text_to_nodes(self.write())

    @abstractmethod
    def write(self) -> str:
        """The Markdown."""


class Knobs(Table):
    """`{knobs} hrl_escape.env.config.ShapeConfig`, under the path that `--set` knows: `:under: room`."""

    option_spec = {"under": directives.unchanged}

    def write(self) -> str:
        """One row a field; nested parts have tables of their own."""
        under = self.options.get("under", "")
        rows = []
        for field in describe_fields(find(self.arguments[0])):
            if field.is_section:
                continue
            path = f"{under}.{field.name}" if under else field.name
            allowed = re.sub(r"'([^']*)'", r"`\1`", field.allowed).removeprefix("one of ")
            rows.append((f"`{path}`", f"`{json.dumps(field.default)}`", allowed, field.document))
        return make_table(("field", "default", "allowed", "what it is"), rows)


class AgentSettings(Table):
    """`{settings} dqn`: an agent's settings, and those that `keras-rl-2019` changes."""

    def write(self) -> str:
        """One row a field; the last column only where there are settings `keras-rl-2019`."""
        name = self.arguments[0]
        documents = read_field_documents(get_agent_class(name).Settings)
        recommended = dataclasses.asdict(get_recipe(name))
        head, columns = ["setting", "default"], [recommended]
        for label, title in ((name, KERAS_RL), (join_name(name, True), f"{KERAS_RL}, options")):
            paper = list_recipes(label).get(KERAS_RL)
            if paper is not None and (settings := dataclasses.asdict(paper)) != columns[-1]:
                head.append(title)
                columns.append(settings)
        rows = []
        for field, value in recommended.items():
            cells = [f"`{json.dumps(column[field])}`" if number == 0 or column[field] != value else ""
                     for number, column in enumerate(columns)]
            rows.append((f"`{field}`", *cells, documents.get(field, "")))
        return make_table((*head, "what it is"), rows)


class Metrics(Table):
    """`{metrics}`: every logged name, explained once."""

    def write(self) -> str:
        """One row a name."""
        return make_table(("name", "what it is"), ((f"`{name}`", text) for name, text in METRICS.items()))


class TunedSettings(Table):
    """`{tuning}`: defaults that were chosen by trying them, then the agents without such a record."""

    def write(self) -> str:
        """One row an entry of the record."""
        record = load_tuning()
        rows = [(", ".join(f"`{agent}`" for agent in entry.agents),
                 ", ".join(f"`{name}={value}`" + (f" (was {entry.before[name]})" if name in entry.before else "")
                           for name, value in entry.settings.items()),
                 ", ".join(f"`{place}`" + (" (reported)" if place in entry.reported_in else "")
                           for place in entry.tried_in),
                 str(entry.trials or "not recorded"), entry.seeds or "not recorded",
                 " ".join(filter(None, (entry.note, f"({entry.source})"))))
                for entry in record]
        tuned = {agent for entry in record for agent in entry.agents}
        others = ", ".join(f"`{agent}`" for agent in (*list_agents(), *list_hierarchy_agents()) if agent not in tuned)
        head = ("agent", "defaults", "tried in", "settings tried", "training seeds", "note and source")
        return f"{make_table(head, rows)}\n\nNo trial is on record for {others}."


class Names(Table):
    """`{names} observations`: what `hrl-escape list` lists."""

    def write(self) -> str:
        """One row a name."""
        kind = self.arguments[0]
        (entries,) = json.loads(run_command("list", kind, "--json")).values()
        return make_table(("name", ""), ((f"`{name}`", re.sub(r"(?<!`)smdp-[\w-]+", r"`\g<0>`", line))
                                         for name, line in entries.items()))


class Recommended(Table):
    """`{recommended}`: the answer to "which agent?" in a line, then a table of why."""

    def write(self) -> str:
        """One row an agent."""
        rows = ((choice.use, f"{choice.title}, `{choice.label}`",
                 re.sub(r"(?<!`)smdp-[\w+-]+", r"`\g<0>`", choice.reason)) for choice in RECOMMENDED)
        return f"{format_answer()}\n\n{make_table(('for', 'agent', 'why'), rows)}"


class Rungs(Table):
    """`{rungs}`: every rung of the ladder, and what its certificate says."""

    def write(self) -> str:
        """One row a rung."""
        rungs = json.loads(run_command("ladder", "list", "--json"))["rungs"]
        return make_table(("rung", "asks for", "train, valid, test, test_task", "skipped", "test tasks in training"), (
            (f"`{rung['rung']}`", rung["isolates"], ", ".join(f"{count:,}" for count in rung["sets"].values()),
             str(rung["skipped"]), f"{rung['task_overlap']:.0%}") for rung in rungs))


class Layouts(Table):
    """`{layouts} arm-two-button`: the numbers of every vector observation in a real room, a section each."""

    def run(self) -> list[nodes.Node]:
        """Write and parse, headings included."""
        return self.parse_text_to_nodes(self.write(), allow_section_headings=True)

    def write(self) -> str:
        """One table an observation, one row a number."""
        rules = Rules(generate(get_preset(self.arguments[0]), 0))
        sections = []
        for observation in list_observations():
            if not observation.is_vector:
                continue
            observer = make_observer(observation.name, rules)
            table = make_table(("index", "number", "lowest", "highest"), (
                (str(index), f"`{name}`", f"{low:.4g}", f"{high:.4g}") for index, (name, low, high)
                in enumerate(zip(observer.names, observer.low, observer.high, strict=True))))
            sections.append(f"### {observation.name}\n\n{table}\n")
        return "\n".join(sections)


class Prices(Table):
    """`{prices}`: costs of textbook hierarchies, computed during the build."""

    def write(self) -> str:
        """One row a hierarchy."""
        rows = []
        for domain, hierarchy, price in find("tests.agents.hierarchy.priced.list_prices")():
            recursive = "" if price.recursive is None else f"{price.recursive:.3f}"
            rows.append((domain, hierarchy, f"{price.flat:.3f}", f"{price.hierarchical:.3f}", recursive))
        return make_table(("environment", "hierarchy", "flat", "hierarchical", "recursive"), rows)


class PublishedRecordings(Table):
    """`{recordings} 1m`: mean return and size of the published data sets of a size."""

    def write(self) -> str:
        """One row a rung, one column a kind."""
        published = read_published()

        def tell(spec: DataSpec) -> str:
            recording = published[spec.name]
            return f"{recording.scores['mean_return']:.1f} ({recording.bytes / 1000:.0f} kB)"

        return make_table(("rung", *RECORDING_KINDS), (
            (f"`{rung}`", *(tell(DataSpec(rung, kind, self.arguments[0])) for kind in RECORDING_KINDS))
            for rung in RUNGS))


class Usage(Table):
    """`{usage} room`: the help of a command."""

    def write(self) -> str:
        """The help as it is printed."""
        words = self.arguments[0].split() if self.arguments else []
        return f"```text\n{run_command(*words, '--help').strip()}\n```"


class SpeedTable(Table):
    """`{speed-table}`: the last run of `python -m benchmarks.speed`, with its machine and date."""

    def write(self) -> str:
        """One row a measurement."""
        return speed.make_table(speed.read_history()[-1])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    for name, directive in {"knobs": Knobs, "settings": AgentSettings, "metrics": Metrics, "names": Names,
                            "recommended": Recommended, "tuning": TunedSettings, "rungs": Rungs,
                            "layouts": Layouts, "prices": Prices, "recordings": PublishedRecordings,
                            "speed-table": SpeedTable, "usage": Usage}.items():
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
