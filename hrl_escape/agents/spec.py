"""Agent specs: one short text names an agent, its settings, and what it observes and chooses among.

| spec | meaning |
|---|---|
| `dqn` | DQN, which acts with primitives |
| `smdp-dqn` | DQN, which chooses among options |
| `smdp-dqn+primitives` | DQN, which chooses among options and primitives |
| `smdp-ppo+objects+memory` | parts after `+`, see `PARTS` |
| `dqn@patient` | named settings after `@`, see `registry.list_recipes` |
| `dqn(gamma=0.95,hidden=[64,64])` | settings by name |
| `maxq-q+planned` | a hierarchy of the room, with a planned low level |

Every command and every function that takes an agent reads its spec here.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.frozen import FrozenAgent
from hrl_escape.agents.hierarchy_kinds import LowLevel, find_kind, list_privileges
from hrl_escape.agents.old_specs import refuse_old
from hrl_escape.agents.registry import (
    DEFAULT_RECIPE,
    SMDP_PREFIX,
    agents,
    check_agent_name,
    find_agent_name,
    find_given_agent,
    get_agent_class,
    get_recipe,
    split_name,
)
from hrl_escape.agents.text_agent import TEXT_AGENT, TextAgentSettings
from hrl_escape.agents.titles import find_title
from hrl_escape.errors import AgentSettingsError, GridError, UnknownNameError
from hrl_escape.files import read_text
from hrl_escape.settings import Range, Settings, replace_settings

LARGEST = 100_000_000

SWEEP, SWEEP_RANDOM = "sweep", "sweep-random"
SEARCH_RANDOM, SEARCH_NEAREST, SEARCH_BACKTRACK = "search-random", "search-nearest", "search-backtrack"
SEARCH_MEMORY, COUNT_CUES = "search-memory", "count-cues"
BAYES, ORACLE = "bayes", "oracle"
REFERENCES = (SWEEP, SWEEP_RANDOM, SEARCH_RANDOM, SEARCH_NEAREST, SEARCH_BACKTRACK, SEARCH_MEMORY, COUNT_CUES, BAYES,
              ORACLE)
"""Agents that follow a fixed rule; `benchmark.references` makes them."""
_ALONE = (*REFERENCES, TEXT_AGENT)
"""Agents that are made from a room instead of spaces and settings."""


@dataclass(frozen=True)
class OptionsView(Settings):
    """Options that an agent chooses among; see `OptionsEnv`."""

    _section = "options"
    include_primitives: bool = False
    """Include the primitives among the choices."""
    option_set: str = "press"
    """Meta-actions: press one button, press its ancestors first, or press one by a function of the state."""
    interruptible: bool = False
    """Options return to the agent after every primitive."""
    max_duration: Annotated[int, Range(1, LARGEST)] | None = None
    """Maximum primitives of an option."""
    memory: bool = False
    """Append an episode's failures and successes to the rows of the observation `objects`; see `DecisionMemory`."""


@dataclass(frozen=True)
class AgentPart:
    """Part of a spec, after `+`."""

    about: str  # effect, for help texts
    title: str  # in display names; empty where another part says it
    settings: Mapping[str, Any] = field(default_factory=dict)  # settings of the agent
    options: Mapping[str, Any] = field(default_factory=dict)  # fields of `OptionsView`
    low_level: Literal["planned", "learned"] | None = None  # low level of a hierarchy of the room


PARTS: dict[str, AgentPart] = {
    "objects": AgentPart("a network over rows of objects, with the observation `objects`", "with object rows",
                         {"network": "objects"}),
    "memory": AgentPart("a memory of the episode in these rows", "with memory", options={"memory": True}),
    "gru": AgentPart("a recurrent network", "with a recurrent network", {"memory": "gru"}),
    "reactive": AgentPart("options that are functions of the state", "", options={"option_set": "press-reactive"}),
    "ancestors": AgentPart("options that press first what must be on before", "",
                           options={"option_set": "press-with-ancestors"}),
    "interruptible": AgentPart("options that return after every primitive", "with interruption",
                               options={"interruptible": True}),
    "primitives": AgentPart("primitives in addition to the options", "", options={"include_primitives": True}),
    "planned": AgentPart("a hierarchy synthesised from the room, with a planned low level", "with a planned low level",
                         low_level="planned"),
    "learned": AgentPart("the same, with a learned low level", "with a learned low level", low_level="learned"),
}
"""Parts of a spec after `+`, in their written order."""

_GRAMMAR = re.compile(r"(?P<name>[^(@+]*)(?:\((?P<settings>.*)\))?(?:@(?P<recipe>[^@+()]*))?(?P<parts>(?:\+[^+()@]*)*)",
                      re.DOTALL)
_IN_OPTIONS = "options."
"""Prefix of the names of fields of `OptionsView` among the settings in parentheses."""


class FrozenSettings(dict[str, Any]):
    """Settings by name that cannot be changed; lists in them become tuples."""

    def __init__(self, values: Mapping[str, Any] | Iterable[tuple[str, Any]] = ()) -> None:
        super().__init__({name: _freeze(value) for name, value in dict(values).items()})

    def __hash__(self) -> int:  # type: ignore[override]  # a dict has none
        return hash(json.dumps(self, sort_keys=True, default=str))

    def __reduce__(self) -> tuple[Any, ...]:
        return FrozenSettings, (dict(self),)

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError("the settings of a spec cannot be changed: make another with dataclasses.replace")

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse  # type: ignore  # as frozen


def _freeze(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return tuple(map(_freeze, value))
    return FrozenSettings(value) if isinstance(value, Mapping) else value


@dataclass(frozen=True)
class AgentSpec(Settings):
    """An agent: its name, named settings, changed settings and options. `str` gives its text, `parse` reads it."""

    _section = "agent"
    name: str = "random"
    """Name in the registry, with `smdp-` in front to choose options; or one of `REFERENCES`, which follow fixed
    rules."""
    label: str = dataclasses.field(default="", compare=False)
    """Name in tables and curves; empty for the text of the spec."""
    recipe: str = DEFAULT_RECIPE
    """Named settings, such as keras-rl-2019; `hrl-escape list recipes` lists them for each agent."""
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Settings that differ from the named ones."""
    options: OptionsView = OptionsView()
    """Options it chooses among, if it does."""
    low_level: Literal["planned", "learned"] | None = None
    """Low level of the hierarchy that is synthesised from the room, for agents such as maxq-q or hamq, or None for no
    hierarchy."""

    def check(self) -> None:
        """Check the name of the agent, and fill in the label."""
        refuse_old(self.name)
        check_agent_name(self.name, _ALONE)
        object.__setattr__(self, "settings", FrozenSettings(self.settings))
        if not self.chooses_options:
            object.__setattr__(self, "options", OptionsView())
        if self.name in _ALONE and self.options.include_primitives:
            raise AgentSettingsError("agent", f"{self.name}+primitives",
                                     f"{self.name}, which chooses among options alone")
        if not self.label:
            object.__setattr__(self, "label", str(self))

    @classmethod
    def parse(cls, agent: str | AgentSpec | type[Agent] | Agent) -> AgentSpec:
        """Convert any form of an agent to a spec, for all commands and functions.

        Args:
            agent: the text of a spec, such as `dqn`, `smdp-dqn@keras-rl-2019` or `smdp-ppo+objects+memory`; a spec;
                a class derived from `Agent`; an instance of one, of which only the settings are used; or a
                `FrozenAgent`. A class that has no registered name is registered under its `name`, so that
                `smdp-NAME` chooses among options.

        Returns:
            The spec. Its named settings and settings are looked up by `resolve_settings`.

        Raises:
            UnknownNameError: no such agent or part; the message names the closest.
            AgentSettingsError: a spec of version 0.3, whose message gives the new text; or parts that contradict each
                other or the agent.
        """
        if isinstance(agent, AgentSpec):
            return agent
        if not isinstance(agent, str):
            return cls._describe(agent)
        refuse_old(agent)
        match = _GRAMMAR.fullmatch(agent)
        if match is None:
            raise AgentSettingsError("agent", agent, "a spec such as smdp-dqn, dqn(gamma=0.95)@patient or "
                                     "smdp-ppo+objects+memory")
        name, recipe, words = match["name"], match["recipe"], match["parts"].split("+")[1:]
        for word in words:
            if word not in PARTS:
                known = [agent.replace(f"+{word}", f"+{part}", 1) for part in PARTS if part not in words]
                raise UnknownNameError("agent spec", agent, known)
        parts = [PARTS[word] for word in words]
        given = dict(_split_settings(agent, match["settings"] or ""))
        settings = {key: value for part in parts for key, value in part.settings.items()}
        options = {key: value for part in parts for key, value in part.options.items()}
        for key, value in given.items():
            if key.startswith(_IN_OPTIONS):
                options[key.removeprefix(_IN_OPTIONS)] = value
            else:
                settings[key] = value
        levels: set[LowLevel] = {part.low_level for part in parts if part.low_level is not None}
        if len(levels) > 1:
            raise AgentSettingsError("agent", agent, "either +planned or +learned")
        if options and not cls(name).chooses_options:
            others = "".join(f"+{word}" for word in words if not PARTS[word].options)
            raise AgentSettingsError("agent", agent, f"{name}{others}, which acts with primitives, or {SMDP_PREFIX}"
                                     f"{agent}, which chooses among options")
        return cls(name, "", recipe or DEFAULT_RECIPE, settings, OptionsView.from_dict(options),
                   levels.pop() if levels else None)

    @classmethod
    def _describe(cls, agent: type[Agent] | Agent) -> AgentSpec:
        if isinstance(agent, FrozenAgent):
            return cls(find_agent_name(agent.player))
        kind = agent if isinstance(agent, type) else type(agent)
        if not issubclass(kind, Agent):
            raise AgentSettingsError("agent", agent, "the text of a spec, an AgentSpec, or an agent or its class")
        name = find_agent_name(kind)
        if isinstance(agent, type):
            return cls(name)
        chosen, default = (dataclasses.asdict(settings) for settings in (agent.settings, get_recipe(name)))  # type: ignore
        return cls(name, settings={key: value for key, value in chosen.items() if value != default[key]})

    def __reduce__(self) -> tuple[Any, ...]:
        # A class that only this process registered goes along, so that other processes can make the agent.
        return _restore_spec, (type(self), dict(vars(self)), self.algorithm, find_given_agent(self.name))

    def __str__(self) -> str:
        words, given = self._split()
        inner = ",".join(f"{key}={_write_value(value)}" for key, value in given.items())
        return (self.name + (f"({inner})" if inner else "") + (f"@{self.recipe}" * (self.recipe != DEFAULT_RECIPE))
                + "".join(f"+{word}" for word in words))

    def _split(self) -> tuple[list[str], dict[str, Any]]:
        """Parts of the spec by their words, and what no part sets, by name."""
        options = {_IN_OPTIONS + key: value for key, value in self.options.to_dict().items()
                   if value != _PLAIN_OPTIONS[key]}
        words, given = [], {**self.settings, **options}
        for word, part in PARTS.items():
            fields = {**part.settings, **{_IN_OPTIONS + key: value for key, value in part.options.items()}}
            if part.low_level in (None, self.low_level) and fields.items() <= given.items():
                words.append(word)
                given = {key: value for key, value in given.items() if key not in fields}
        return words, given

    @property
    def title(self) -> str:
        """Display name in prose, tables and legends, such as "DQN over options, with memory"; a label of its own."""
        if self.label != str(self):
            return self.label
        words = [find_title(self.name)]
        if self.chooses_options and self.name not in _ALONE:
            kind = {"press-with-ancestors": "options with ancestors", "press-reactive": "reactive options"}
            words.append(f"over {kind.get(self.options.option_set, 'options')}")
            words += ["and primitives"] * self.options.include_primitives
        parts, given = self._split()
        shown = [PARTS[part].title for part in parts if not (part == "objects" and self.options.memory)]
        named = f"{self.recipe} settings" if self.recipe != DEFAULT_RECIPE else ""
        return ", ".join(filter(None, (" ".join(words), *shown, named,
                                       *(f"{key} {_write_value(value)}" for key, value in given.items()))))

    @property
    def chooses_options(self) -> bool:
        """True if the agent acts on the SMDP view of a room."""
        return split_name(self.name)[1] if self.name not in _ALONE else self.name != ORACLE

    @property
    def algorithm(self) -> str:
        """Name in the registry without its prefix: `dqn` of `smdp-dqn`, `random` of `random-options`."""
        return split_name(self.name)[0]

    @property
    def is_reference(self) -> bool:
        """True if the agent is not trained: one of `REFERENCES`, `text-agent`, or a `FrozenAgent`."""
        return self.name in _ALONE or self.is_frozen

    @property
    def is_frozen(self) -> bool:
        """True if the agent is a `FrozenAgent`."""
        given = find_given_agent(self.name)
        return given is not None and given.is_frozen

    @property
    def learns(self) -> bool:
        """True if the agent learns, unlike the random policy and references."""
        return not self.is_reference and self.algorithm != "random"

    def resolve_settings(self) -> dict[str, Any]:
        """Return all settings as a JSON value; among references only `text-agent` has settings.

        Raises:
            EscapeError: no such agent, named settings or setting, an impossible value, or no hierarchy for this agent.
        """
        if self.low_level is not None:
            find_kind(self.name, self.low_level)
        if self.name == TEXT_AGENT:
            return self._resolve_text_agent()
        if self.name in _ALONE:
            if self.settings or self.recipe != DEFAULT_RECIPE:
                raise GridError(f"{self.label}: a reference has no settings")
            return {}
        chosen = replace_settings(get_recipe(self.name, self.recipe), self.settings)
        return json.loads(json.dumps(dataclasses.asdict(chosen)))

    def _resolve_text_agent(self) -> dict[str, Any]:
        """Settings of the text agent; of recorded games the content counts, not the file's name alone."""
        chosen = dataclasses.asdict(replace_settings(TextAgentSettings(), self.settings))
        recorded = chosen["model"].endswith(".jsonl")
        content = read_text(chosen["model"], "recorded game") if recorded else ""
        return chosen | ({"recorded": hashlib.sha256(content.encode()).hexdigest()[:12]} if recorded else {})

    @property
    def drives_velocities(self) -> bool:
        """True if the agent acts in a Box alone: rooms then take velocities in place of primitives."""
        if self.chooses_options or self.is_reference:
            return False
        return "discrete" not in get_agent_class(self.name).acts_in

    @property
    def remembers(self) -> bool:
        """True if the agent keeps its memory of a room across trials."""
        return self.settings.get("memory", "none") != "none" or self.options.memory

    @property
    def reads_objects(self) -> bool:
        """True if the agent needs the observation `objects`."""
        return self.settings.get("network") == "objects" or self.options.memory

    @property
    def default_observation(self) -> str:
        """Default observation of the agent; `state` for velocities, because goals on the floor are in its units."""
        return "objects" if self.reads_objects else "state" if self.drives_velocities else "features"

    @property
    def privileges(self) -> tuple[str, ...]:
        """Information of its hierarchy that other agents lack; printed in tables."""
        return () if self.low_level is None else list_privileges(self.name, self.low_level)

    @property
    def needs_trace(self) -> bool:
        """True if the agent learns from the primitives inside options."""
        return self.chooses_options and not self.is_reference and get_agent_class(self.name).needs_trace


_PLAIN_OPTIONS = OptionsView().to_dict()


def _restore_spec(kind: type[AgentSpec], fields: Mapping[str, Any], name: str, given: type[Agent] | None) -> AgentSpec:
    if given is not None and find_given_agent(name) is None:
        agents.register(name, given)
    made = object.__new__(kind)
    vars(made).update(fields)
    return made


def parse_specs(names: Iterable[str]) -> tuple[AgentSpec, ...]:
    """Specs of several agents."""
    return tuple(map(AgentSpec.parse, names))


def _split_settings(spec: str, text: str) -> Iterator[tuple[str, Any]]:
    """Settings in the parentheses of a spec; commas within brackets, braces and quotes belong to a value."""
    depth, quoted, start = 0, False, 0
    ends = []
    for place, sign in enumerate(text):
        quoted ^= sign == '"' and text[place - 1 : place] != "\\"
        depth += 0 if quoted else (sign in "[{(") - (sign in ")}]")
        if sign == "," and not (depth or quoted):
            ends.append(place)
    for end in (*ends, len(text)) if text else ():
        name, equals, value = text[start:end].strip().partition("=")
        if not equals or not name:
            raise AgentSettingsError("agent", spec, "settings as name=value, such as dqn(gamma=0.95)")
        try:
            yield name.strip(), json.loads(value)
        except json.JSONDecodeError:
            yield name.strip(), value.strip()
        start = end + 1


def _write_value(value: Any) -> str:
    text = json.dumps(value, separators=(",", ":"))
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z_/][\w./-]*", value) and value not in ("true", "false", "null"):
        return value
    return text
