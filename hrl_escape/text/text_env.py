"""Text interface to a room: describes states in words and accepts tool calls as actions.

`TextEnv` changes no number of the `OptionsEnv` that it wraps. It keeps a transcript of every game, for any player. A
caller begins a call. The next steps of the environment, made by a `RoomSession` or by a loop over a `ToolsAgent`,
execute it. Except at the level `model`, the text contains only what an agent's observation contains.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, SupportsFloat

import gymnasium
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker

from hrl_escape.agents.agent import SMDPTransition, make_transition, read_action_mask
from hrl_escape.agents.text_agent import REVEAL_LEVELS, Level
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.errors import ResetNeededError, UnknownNameError, UnsupportedError
from hrl_escape.figures import make_svg
from hrl_escape.names import count_nouns, join_words
from hrl_escape.notebook import make_caption, make_html_table
from hrl_escape.options.domain import DomainStep, find_layer
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.best_known import compute_expected_escape, find_best_known
from hrl_escape.planning.goals import find_new_name, make_goal, name_goal
from hrl_escape.planning.symbolic.pddl import clean_name, export_pddl
from hrl_escape.settings import ExactCount
from hrl_escape.step_info import read_action
from hrl_escape.text.coercion import normalise_call
from hrl_escape.text.words import clean, list_option_names, place, tell_changes, tell_room

MOST_LOOKS, MOST_TIMES, MOST_TEXT = 10, 50, 200
"""Free looks between two moves; most repeats of a primitive; most characters of an invalid value in the transcript."""


SHOWN_TURNS = 4
"""Turns that a notebook shows of a session."""


class ToolCall(NamedTuple):
    """A call of a tool.

    Attributes:
        name: name of the tool.
        arguments: arguments by name; for a malformed call the given value, converted to plain JSON.
    """

    name: str
    arguments: Any


@dataclasses.dataclass(frozen=True)
class Turn:
    """A call and the room's answer.

    Attributes:
        call: the call, or None for the text that begins a game.
        text: the answer.
        is_error: whether the call was invalid.
    """

    call: ToolCall | None
    text: str
    is_error: bool = False


@dataclasses.dataclass(frozen=True)
class Score:
    """Score of a game so far.

    Attributes:
        reward: undiscounted return.
        escaped: whether the robot has escaped.
        efficiency: fewest known primitives of an escape divided by this one's, at most 1; 0 without an escape.
        decisions: number of calls that took primitives.
        primitives: number of primitives.
        invalid_calls: number of invalid calls, and of calls of options that could not start.
        characters: characters sent to the caller, who reads tools and transcript again before every call.
    """

    reward: float
    escaped: bool
    efficiency: float
    decisions: ExactCount
    primitives: ExactCount
    invalid_calls: ExactCount
    characters: ExactCount


def tell_score(score: Score) -> str:
    """Return a sentence on a score, for the end of a game."""
    return (f"Score: {'escaped' if score.escaped else 'not escaped'}, efficiency {score.efficiency:.2f}, "
            f"{count_nouns(score.primitives, 'primitive')}, {count_nouns(score.decisions, 'call')}, "
            f"{score.invalid_calls} wrong.")


def count_characters(turns: Sequence[Turn], tools: Sequence[Mapping[str, Any]]) -> int:
    """Return the characters of a transcript and of the tools' schemas, as a model reads them once."""
    said = [tools, *([turn.call.name, turn.call.arguments] for turn in turns if turn.call is not None)]
    return sum(len(json.dumps(each, separators=(",", ":"))) for each in said) + sum(len(turn.text) for turn in turns)


class TextEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Keeps the transcript of a room's games, and executes tool calls.

    Args:
        env: options over a room, or a flat room, which gets its meta-actions and primitives.
        reveal: level of revealed text, one of `REVEAL_LEVELS`.

    Attributes:
        seed: seed of the game, or None if the environment drew its start.
        transcript: the turns since the last reset with a seed.
        log: one SMDP transition per call that took primitives; action -1 is an invalid call.
        decisions: primitives of each call that took any, in order.
        start: first state of the game.
        is_over: whether the game is over, or none has begun.
        characters: characters that the caller has read; it reads tools and transcript again before every call.
        action: action of the call in progress; -1 for the idle primitive of an invalid call, None without a call.

    Raises:
        UnknownNameError: no such level.
        UnsupportedError: `env` has no room, or other options below.
    """

    env: Any

    def __init__(self, env: gymnasium.Env, reveal: Level = "places") -> None:
        RecordConstructorArgs.__init__(self, reveal=reveal)
        if reveal not in REVEAL_LEVELS:
            raise UnknownNameError("reveal level", reveal, REVEAL_LEVELS)
        while isinstance(env, (OrderEnforcing, PassiveEnvChecker)):
            env = env.env
        options = env if isinstance(env, OptionsEnv) else OptionsEnv(env)
        if options.level or not hasattr(options.unwrapped, "get_state"):
            raise UnsupportedError("a session needs a room: pass an OptionsEnv over a room, not over other options")
        super().__init__(options)
        self.reveal: Level = reveal
        self.transcript: list[Turn] = []
        self.log: list[SMDPTransition] = []
        self.decisions: list[tuple[DomainStep, ...]] = []
        self.action: int | None = None
        self.characters = 0
        self.seed: int | None = None
        self.is_over, self._room_id = True, ""

    # --- the game ------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a game. Without a seed and in the same room, the transcript continues with another trial."""
        observation, info = self.env.reset(seed=seed, options=options)
        instance = self.instance
        if seed is not None or instance.id != self._room_id:
            self.transcript, self.seed = [], seed
        self._names = list_option_names(self.env.options)
        first = self.env.primitive_count
        self._actions = {name: first + number for name, number in self._names.items()}
        self._primitives = {clean(name): number for number, name in enumerate(self.env.action_names[:first])}
        self._room_id, self.is_over, self.action, self.log = instance.id, False, None, []
        self.decisions = []
        self.start, self._rewards, self._invalid, self.characters, self._looks = self.state, [], 0, 0, 0
        self._end = EpisodeEnd.STOPPED
        self._observation, self._mask = observation, read_action_mask(info, len(self.env.action_names))
        self.tools = self._make_tools()
        self.transcript.append(Turn(None, self._describe_start()))
        self._size = count_characters(self.transcript, self.tools)
        return observation, info

    def step(self, action: int) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Execute one step of the call in progress, for any action; without a call, the action is a call by itself."""
        if self.action is None:
            self.begin(self.name_action(action))
        taken = self.action
        assert taken is not None
        step = self.env.idle("the call was wrong") if taken < 0 else self.env.step(taken)
        self._hear(taken, step)
        return step

    def begin(self, call: ToolCall) -> Turn | None:
        """Begin a call; `call` can be any value, and is brought into normal form, see `hrl_escape.text.coercion`.

        Returns:
            The answer if the call takes no primitives. Otherwise None, and `action` is the action to step with.

        Raises:
            ResetNeededError: the game is over, or none has begun.
        """
        if self.is_over:
            raise ResetNeededError("call reset() first: no game has begun, or it is over")
        self.characters += self._size
        call = self._call = _tidy_call(call, self.tools)
        self.action, self._left = None, 1
        self._wrong = self._read(call)
        self._looks = self._looks + 1 if call.name == "look" and not self._wrong else 0
        if self._looks:
            return self._answer(self._describe_now())
        self._steps, self._parts = list[DomainStep](), []
        if self._wrong and self.action is None:
            self.action = -1
        return None

    def name_action(self, action: int) -> ToolCall:
        """Return the call that takes an action of the environment.

        Raises:
            ActionError: there is no such action.
            ResetNeededError: no game has begun.
        """
        if not self._room_id:
            raise ResetNeededError("call reset() first: no game has begun")
        action = read_action(action, len(self.env.action_names))
        if action < self.env.primitive_count:
            return ToolCall("move", {"primitive": clean(self.env.action_names[action]), "times": 1})
        name = next((name for name, own in self._actions.items() if own == action), "")
        return ToolCall("run_option", {"option": name})

    def score(self) -> Score:
        """Score of the game so far.

        Raises:
            ResetNeededError: no game has begun.
        """
        if not self._room_id:
            raise ResetNeededError("call reset() first: no game has begun")
        escaped, primitives = self._end is EpisodeEnd.ESCAPED, len(self._rewards)
        efficiency = min(1.0, self._find_fewest() / primitives) if escaped else 0.0
        return Score(float(sum(self._rewards)), escaped, efficiency, len(self.log), primitives, self._invalid,
                     self.characters)

    @property
    def instance(self) -> RoomInstance:
        """Room of the current game, or of the game after the next reset."""
        return self.env.unwrapped.instance

    @property
    def state(self) -> RoomState:
        """Current state of the room."""
        return self.env.unwrapped.get_state()

    def _find_fewest(self) -> float:
        dynamics = self.instance.dynamics
        if dynamics.is_random and dynamics.kind == "kinematic":
            return compute_expected_escape(self.instance, self.start).primitives
        return find_best_known(self.instance, self.start).primitives or 1

    # --- calls ---------------------------------------------------------------------------

    def _read(self, call: ToolCall) -> str:
        """Set the action and the number of repeats of a call; return its fault and the valid calls, or empty text."""
        tools = {tool["name"]: tool["inputSchema"] for tool in self.tools}
        if call.name not in tools:
            return f"There is no such tool. There are {join_words(map(_show, tools))}."
        known, required, given = tools[call.name]["properties"], tools[call.name]["required"], call.arguments
        if not isinstance(given, dict) or not set(required) <= set(given) <= set(known):
            return f"{_show(call.name)} takes {join_words(map(_show, known)) or 'no arguments'}."
        if call.name == "look":
            return f"You have looked {MOST_LOOKS} times; act." if self._looks >= MOST_LOOKS else ""
        named, choices = ("option", self._actions) if call.name == "run_option" else ("primitive", self._primitives)
        choice, times = given[named], given.get("times", 1)
        if not isinstance(choice, str) or choice not in choices:
            new = find_new_name(choice, list(choices)) if isinstance(choice, str) else None
            meant = f" Did you mean {_show(new)}?" if new else ""
            return f"There is no such {named}.{meant} There are {join_words(map(_show, choices))}."
        if type(times) is not int or not 1 <= times <= MOST_TIMES:
            return f'"times" is a whole number from 1 to {MOST_TIMES}.'
        self.action = choices[choice]
        if not self._mask[self.action]:
            return f"{_show(choice)} cannot start now."
        self._left = times
        return ""

    def _hear(self, taken: int, step: tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]) -> None:
        """Record a step, and answer if it ends the call."""
        transition = make_transition(self._observation, taken, self._mask, step, self.env.gamma)
        self._parts.append(transition)
        self._steps += self.env.last_steps
        self._rewards += self.env.last_rewards
        self._observation, self._mask = transition.next_observation, transition.next_action_mask
        self._end = EpisodeEnd.of_step(bool(step[4]["is_success"]), step[2], step[3])
        self.is_over = self._end.is_over
        said = tell_changes(self.instance, self._steps)
        self._left -= 1
        if self._left and not said and not self.is_over:
            return
        self.action = None
        self.log.append(_join(self._parts))
        self.decisions.append(tuple(self._steps))
        self._invalid += bool(self._wrong)
        took = len(self._steps)
        lines = [f"Wrong call: {self._wrong}"] if self._wrong else []
        lines.append(f"Took {count_nouns(took, 'primitive')}, {len(self._rewards)} of {self.instance.horizon}.")
        if step[4]["option"]["ended"] == "planning-failed" and not self._wrong:
            lines.append("No way on was found.")
        if self.reveal != "names" and not self.is_over:
            said.append(f"You are at {place(self.state.x, self.state.y)}.")
        self._answer(" ".join(filter(None, [*lines, *said, self._describe_end()])))

    def _answer(self, text: str) -> Turn:
        turn = Turn(self._call, text, bool(self._wrong))
        self.transcript.append(turn)
        self._size += count_characters([turn], []) - len("[]")
        return turn

    # --- words ---------------------------------------------------------------------------

    def _make_tools(self) -> list[dict[str, Any]]:
        option = {"type": "string", "enum": list(self._actions)}
        tools = [_make_tool("run_option", "Carry out an option to its end.", option=option),
                 _make_tool("look", "Describe the room; free.")]
        if self._primitives:
            times = {"type": "integer", "minimum": 1, "maximum": MOST_TIMES}
            tools.append(_make_tool("move", "Repeat one primitive, until something changes.", {"times"},
                                    primitive={"type": "string", "enum": list(self._primitives)}, times=times))
        return tools

    def _describe_start(self) -> str:
        instance, reward = self.instance, self.instance.reward
        tries = sum(turn.call is None for turn in self.transcript)
        if tries:
            return f"Try {tries + 1} in the same room.\n{self._describe_now()}"
        parts = ["You drive a robot in a closed room. Solve its puzzle to open the exit, then leave.",
                 f"Each primitive earns {reward.step:g}, leaving {reward.on_exit:g}; a wrong call takes one. "
                 f"After {instance.horizon} of them the game is over.",
                 f"The puzzle: {type(instance.puzzle).about}", self._describe_now()]
        return "\n".join(parts + (self._describe_model() if self.reveal == "model" else []))

    def _describe_now(self) -> str:
        room = self.env.unwrapped
        said = tell_room(self.instance, self.state, self.reveal != "names", room.rules.get_heading)
        return f"{said}\n{self._describe_end()}".rstrip()

    def _describe_end(self) -> str:
        """Options that cannot start, or the only ones that can; at the end, how the game ended."""
        if self.is_over:
            return f"The game is over: {self._end.words}."
        able, unable = ([_show(name) for name, action in self._actions.items() if bool(self._mask[action]) is wanted]
                        for wanted in (True, False))
        some = f"Not now: {', '.join(unable)}" if len(unable) <= len(able) else f"Now only: {', '.join(able)}"
        return f"{some}." if unable else ""

    def _describe_model(self) -> list[str]:
        """The symbolic model, and the option of every operator with another name."""
        instance = self.instance
        goals = {op.name: name_goal(make_goal(op, instance), instance)
                 for op in instance.symbolic_model.operators}
        unlike = [f"{clean_name(op)}: {_show(clean(option))}" for op, option in goals.items()
                  if clean_name(op) != clean_name(option)]
        return ["Its symbolic model:", *export_pddl(instance, self.state),
                *([f"Options of actions: {'; '.join(unlike)}."] if unlike else [])]


def find_text_env(env: gymnasium.Env) -> TextEnv:
    """Return the `TextEnv` among the wrappers of a room. Raises `UnsupportedError` if there is none."""
    found = find_layer(env, TextEnv)
    if found is None:
        raise UnsupportedError(f"{env} has no text interface. Wrap its OptionsEnv in a TextEnv")
    return found


def _show(name: str) -> str:
    """A clean name in quotation marks."""
    return f'"{name}"'


def _make_tool(name: str, about: str, optional: Collection[str] = (), **properties: Any) -> dict[str, Any]:
    required = [key for key in properties if key not in optional]
    return {"name": name, "description": about,
            "inputSchema": {"type": "object", "properties": properties, "required": required,
                            "additionalProperties": False}}


def _tidy_call(call: Any, tools: Sequence[Mapping[str, Any]]) -> ToolCall:
    name, arguments = call if isinstance(call, (tuple, list)) and len(call) == 2 else (call, {})
    # Texts are cut first, so that a recorded call is its own normal form.
    name, arguments = normalise_call(*(each[:MOST_TEXT] if isinstance(each, str) else each
                                       for each in (name, arguments)), tools)
    return ToolCall(name[:MOST_TEXT] if isinstance(name, str) else json.dumps(_tidy(name)), _tidy(arguments))


def _tidy(value: Any, depth: int = 3) -> Any:
    """A short JSON value, which the transcript stores and reads back unchanged."""
    if value is None or isinstance(value, bool):
        return value
    if type(value) is int:
        return value if abs(value) < 2**53 else "a large number"
    if type(value) is float:
        return value if math.isfinite(value) else "no finite number"
    if isinstance(value, str):
        return str(value)[:MOST_TEXT]
    if isinstance(value, Mapping) and depth:
        named = ((str(key)[:MOST_TEXT] if isinstance(key, str) else type(key).__name__, key) for key in value)
        return {name: _tidy(value[key], depth - 1) for name, key in itertools.islice(named, 12)}
    if isinstance(value, (list, tuple)) and depth:
        return [_tidy(item, depth - 1) for item in value[:12]]
    return f"a {type(value).__name__}"[:MOST_TEXT]


def _join(parts: Sequence[SMDPTransition]) -> SMDPTransition:
    """Combine the steps of one call into one transition: rewards and discounts compose."""
    first, last, reward, discount = parts[0], parts[-1], 0.0, 1.0
    for part in parts:
        reward, discount = reward + discount * part.reward, discount * part.discount
    return first._replace(reward=reward, summed_reward=sum(part.summed_reward for part in parts),
                          duration=sum(part.duration for part in parts), discount=discount,
                          next_observation=last.next_observation, next_action_mask=last.next_action_mask,
                          terminated=last.terminated, truncated=last.truncated)


# --- games by calls --------------------------------------------------------------------------


class ToolResult(NamedTuple):
    """Answer to a call.

    Attributes:
        text: what happened, its cost and the next options.
        is_error: whether the call was invalid; the text then lists valid calls.
    """

    text: str
    is_error: bool = False


class RoomSession:
    """Games in a room, played by tool calls.

        session = RoomSession(OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1")))
        print(session.reset(seed=0))
        print(session.call("run_option", {"option": "press-button-1"}).text)

    Args:
        env: options over a room, a flat room, or a `TextEnv`, whose level then applies.
        reveal: level of revealed text, one of `REVEAL_LEVELS`.

    Attributes:
        env: the environment with the text interface.

    Raises:
        UnknownNameError: no such level.
        UnsupportedError: `env` has no room.
    """

    def __init__(self, env: gymnasium.Env, reveal: Level = "places") -> None:
        self.env = env if isinstance(env, TextEnv) else TextEnv(env, reveal)

    def __repr__(self) -> str:
        room: Any = self.env.unwrapped
        return f"<RoomSession in {room.instance.name}: {len(self.transcript)} turns>"

    def _repr_html_(self) -> str:
        rows = [("" if turn.call is None else f"{turn.call.name} {turn.call.arguments or ''}", turn.text)
                for turn in self.transcript[-SHOWN_TURNS:]]
        return make_caption(self._repr_svg_() + make_html_table(("call", "answer"), rows), repr(self).strip("<>"))

    def _repr_svg_(self) -> str:
        from hrl_escape.env.pictures.maps import make_map  # loads matplotlib

        room: Any = self.env.unwrapped
        return make_svg(make_map(room.instance, room.get_state() if self.transcript else None))

    def reset(self, seed: int | None = None) -> str:
        """Begin a game and return its first text, at the level `reveal`. The seed fixes start and noise."""
        self.env.reset(seed=seed)
        return self.env.transcript[-1].text

    def tools(self) -> list[dict[str, Any]]:
        """JSON Schemas of the tools of this game: `name`, `description` and `inputSchema`."""
        return self.env.tools

    def call(self, name: Any, arguments: Any = None) -> ToolResult:
        """Call a tool. The answer to any call is a text.

        A call is brought into normal form first, see `hrl_escape.text.coercion`, which costs nothing. An invalid call
        costs one primitive, like a masked option, and so does a call of an option that cannot start.
        After the end of a game, calls have no effect.
        """
        env = self.env
        if env.is_over:
            return ToolResult("The game is over: reset begins another." if env.transcript else
                              "No game has begun: reset begins one.", True)
        env.begin(ToolCall(name, arguments))
        while env.action is not None:
            env.step(env.action)
        return ToolResult(env.transcript[-1].text, env.transcript[-1].is_error)

    def score(self) -> Score:
        """Score of the game so far."""
        return self.env.score()

    @property
    def transcript(self) -> list[Turn]:
        """Turns since the last reset with a seed."""
        return self.env.transcript

    @property
    def log(self) -> list[SMDPTransition]:
        """One SMDP transition a call that took primitives."""
        return self.env.log
