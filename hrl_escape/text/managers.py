"""The agent `text-agent` and its scripted managers: callers that read only the transcript, like a language model.

| name | what it does | what it reads |
|---|---|---|
| `random` | runs a random option that can start | names |
| `search-random` | a random target that is off and untried since the last change | names, what is on |
| `search-nearest` | the same, nearest first, by the revealed places | names, what is on, places |
| `oracle` | solves the revealed PDDL in as few actions as possible, and leaves | the symbolic model |

They show that the text suffices to play, and are the rows that a model is compared with. `search-random` makes the same
choices as the agent of that name, which reads the room directly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.agents.text_agent import TextAgentSettings
from hrl_escape.errors import PlanningFailed, PlanningReason, UnknownNameError
from hrl_escape.planning.goals import LEAVE
from hrl_escape.registry import Registry
from hrl_escape.text.recordings import RecordedModel
from hrl_escape.text.text_env import ToolCall, Turn, find_text_env

Model: TypeAlias = Callable[[Sequence[Turn], Sequence[Mapping[str, Any]]], ToolCall]
"""Function from a transcript and the tools' schemas to the tool call. If it has an attribute `rng`, an evaluation sets
it to the episode's generator."""

_PRESSED = re.compile(r'Pressed ("[^"]*"(?:(?:, | and )"[^"]*")*): ((?:[^".]|"[^"]*")*)\.')
_ON, _OUT = (re.compile(rf'("[^"]*"(?:(?:, | and )"[^"]*")*) {word}') for word in ("came on", "went out"))
_HERE = re.compile(r"You are at \((-?[\d.]+), (-?[\d.]+)\)")
_THING = re.compile(r'"([^"]*)"(?: at \((-?[\d.]+), (-?[\d.]+)\))?, (on|off)')
_QUOTED = re.compile(r'"([^"]*)"')
_ACT = re.compile(r"(?:push-(?:east|north|west|south)|[a-z]+)-(.*)")


class RandomManager:
    """Runs a random option that can start; leaves once the exit is open."""

    name = "random"

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)

    def __call__(self, transcript: Sequence[Turn], tools: Sequence[Mapping[str, Any]]) -> ToolCall:
        """Return the next call: an option, or `move` if no option but leaving can start."""
        schemas = {tool["name"]: tool["inputSchema"]["properties"] for tool in tools}
        options: list[str] = schemas["run_option"]["option"]["enum"]
        legal = _read_legal(transcript[-1].text, options)
        if _is_open(transcript) and LEAVE in legal:
            return _run(LEAVE)
        presses = [option for option in legal if option != LEAVE]
        if not presses and "move" in schemas:
            return ToolCall("move", {"primitive": schemas["move"]["primitive"]["enum"][0]})
        return _run(self._choose(presses, transcript, options) if presses else LEAVE)

    def _choose(self, presses: list[str], transcript: Sequence[Turn], options: Sequence[str]) -> str:
        return presses[int(self.rng.integers(len(presses)))]


class SearchRandomManager(RandomManager):
    """Tries a random target that is off and untried since the last change."""

    name = "search-random"

    def _choose(self, presses: list[str], transcript: Sequence[Turn], options: Sequence[str]) -> str:
        tried, lit, before = set[str](), set[str](), transcript[0].text
        for turn in transcript:
            if turn.call is None:
                tried.clear()
                lit = {name for name, *_, state in _THING.findall(turn.text) if state == "on"}
            elif turn.call.name != "look":
                able = [option for option in _read_legal(before, options) if option != LEAVE]
                if not set(able) - tried:
                    tried.clear()
                _note(turn, options, tried, lit)
            before = turn.text if turn.call is None or turn.call.name != "look" else before
        fresh = [option for option in presses if option not in tried] or presses
        dark = [option for option in fresh if _get_thing(option) not in lit]
        return self._pick(dark or fresh, transcript)

    def _pick(self, presses: list[str], transcript: Sequence[Turn]) -> str:
        return presses[int(self.rng.integers(len(presses)))]


class SearchNearestManager(SearchRandomManager):
    """Tries the nearest target that is off and untried since the last change; a random one without places."""

    name = "search-nearest"

    def _pick(self, presses: list[str], transcript: Sequence[Turn]) -> str:
        places = {name: (float(x), float(y)) for name, x, y, _ in _THING.findall(transcript[0].text) if x}
        here = next((tuple(map(float, found[-1])) for turn in reversed(transcript)
                     if (found := _HERE.findall(turn.text))), None)
        if here is None:
            return super()._pick(presses, transcript)
        return min(presses, key=lambda press: math.dist(here, places.get(_get_thing(press), (math.inf, 0.0))))


class PDDLPlanner(RandomManager):
    """Solves the PDDL in the transcript with a planner of unified-planning, follows the plan, and leaves.

    Raises:
        MissingExtraError: unified-planning is not installed.
        PlanningFailed: the transcript has no model, or none that can be solved.
    """

    name = "oracle"

    def __init__(self) -> None:
        super().__init__()
        self._plans: dict[str, list[str]] = {}

    def _choose(self, presses: list[str], transcript: Sequence[Turn], options: Sequence[str]) -> str:
        begun = transcript[0].text
        if begun not in self._plans:
            self._plans = {begun: _solve(begun, options)}  # replaces the plans of earlier games
        done, plan = 0, self._plans[begun]
        for turn in transcript:
            failed = turn.is_error or "No way on" in turn.text
            done += done < len(plan) and turn.call == _run(plan[done]) and not failed
        if done < len(plan) and plan[done] in presses:
            return plan[done]
        return super()._choose(presses, transcript, options)


def _solve(begun: str, options: Sequence[str]) -> list[str]:
    """Options that execute a plan for the revealed model, in order."""
    from hrl_escape.planning.symbolic.pddl import clean_name, read_problem, run_engine

    domain, problem = begun.find("(define (domain"), begun.find("(define (problem")
    if min(domain, problem) < 0:
        raise PlanningFailed(PlanningReason.PRECONDITION_UNMET, "the model in the transcript",
                             nearest="no symbolic model in the transcript: the session must reveal the level model")
    text, _, unlike = begun[problem:].partition("Options of actions: ")
    named = {clean_name(option): option for option in options}
    named |= dict(re.findall(r'([a-z0-9_-]+): "([^"]*)"', unlike))
    plan, status = run_engine(read_problem(begun[domain:problem], text), "fast-downward-opt", 60.0)
    if plan is None:
        raise PlanningFailed(PlanningReason.PRECONDITION_UNMET, "the model in the transcript",
                             nearest=f"status {status}")
    return [named[action.action.name] for action in plan.actions]


def _run(option: str) -> ToolCall:
    return ToolCall("run_option", {"option": option})


def _get_thing(option: str) -> str:
    """Name of the thing that an option presses, grips, releases, uses or pushes one cell; otherwise empty."""
    found = _ACT.fullmatch(option)
    return found[1] if found else ""


def _read_legal(text: str, options: Sequence[str]) -> list[str]:
    """Options that can start after an answer."""
    for words, wanted in (("Not now: ", False), ("Now only: ", True)):
        if words in text:
            named = set(_QUOTED.findall(text.rpartition(words)[2].partition("\n")[0]))
            return [option for option in options if (option in named) is wanted]
    return list(options)


def _is_open(transcript: Sequence[Turn]) -> bool:
    for turn in reversed(transcript):
        last = max((turn.text.rfind(words), words.endswith(("opened", "open")))
                   for words in ("exit opened", "exit shut", "Exit: open", "Exit: shut"))
        if last[0] >= 0:
            return last[1]
        if turn.call is None:
            return re.search(r"Exit at \([^)]*\): open", turn.text) is not None
    return False


def _note(turn: Turn, options: Sequence[str], tried: set[str], lit: set[str]) -> None:
    """Record a call's presses, in order, and the option itself if it pressed no target of its own."""
    assert turn.call is not None
    noted, changed = set[str](), "came on" in turn.text or "went out" in turn.text
    for names, said in _PRESSED.findall(turn.text):
        for press in (f"press-{name}" for name in _QUOTED.findall(names)):
            if press in options:
                noted.add(press)
                tried.add(press) if said == "nothing changed" else tried.clear()
    chosen = str(turn.call.arguments.get("option")) if isinstance(turn.call.arguments, dict) else ""
    if chosen in options and chosen != LEAVE and chosen not in noted:
        tried.clear() if changed or "now shows" in turn.text else tried.add(chosen)
    for names, said in _PRESSED.findall(turn.text):
        pressed = set(_QUOTED.findall(names))
        lit.update(pressed if "it came on" in said else ())
        lit.difference_update(pressed if "it went out" in said else ())
    for found, change in ((_ON, lit.update), (_OUT, lit.difference_update)):
        for names in found.findall(turn.text):
            change(_QUOTED.findall(names))


models: Registry[Callable[..., Any]] = Registry("model", "a callable", callable)
"""Models by name. Those in this module are classes, which are called once to make the model."""
for _manager in (RandomManager, SearchRandomManager, SearchNearestManager, PDDLPlanner):
    models.register(_manager.name, _manager)


def make_model(name: str) -> Model:
    """Return a manager, a replay of recorded games (`.jsonl`), or a model of another package.

    A package provides a callable under the entry-point group `hrl_escape.models`:

        [project.entry-points."hrl_escape.models"]
        my-model = "my_package.my_module:choose_call"

    Raises:
        UnknownNameError: no model of that name.
        FileReadError: the file is missing or damaged.
        PluginError: another package's model fails to load.
    """
    if name.endswith(".jsonl"):
        return RecordedModel(name)
    if name not in models:
        raise UnknownNameError("model", name, [*models, "a file of recorded games (.jsonl)"])
    model = models.get(name)
    return model() if isinstance(model, type) and issubclass(model, RandomManager) else model


class ToolsAgent(FixedPolicy):
    """Asks a model for a tool call at every decision. It does not learn.

        env = TextEnv(OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1")), reveal="names")
        evaluate(ToolsAgent(env, model), env, episodes=20)

    Args:
        env: environment with a `TextEnv` among its wrappers, which reads the calls.
        model: function from transcript and tools' schemas to a call. Invalid calls do not end the game; see
            `RoomSession.call`.

    Attributes:
        caller: name of the model in the records of runs: its attribute `name`, or the name of its function or class.
    """

    Settings: ClassVar[type] = TextAgentSettings
    STATE = ("caller",)

    def __init__(self, env: gymnasium.Env, model: Model) -> None:
        self.settings = TextAgentSettings()
        self.text_env, self.model = find_text_env(env), model
        self.caller = str(getattr(model, "name", None) or getattr(model, "__qualname__", type(model).__qualname__))
        self._rng = np.random.default_rng(0)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Act as in an evaluation, with the agent's own random generator."""
        return self.act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the action of the call in progress or of the next call; for an invalid call the first legal action."""
        if hasattr(self.model, "rng"):
            vars(self.model)["rng"] = rng
        while self.text_env.action is None:
            self.text_env.begin(self.model(self.text_env.transcript, self.text_env.tools))
        return self.text_env.action if self.text_env.action >= 0 else int(np.flatnonzero(action_mask)[0])
