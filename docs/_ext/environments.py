"""Pages of environments: `{environments}` is the index of all presets, `{environment} taxi` the card of one.

Spaces, rewards, arguments and ids are read from the code, planned escapes are computed during the build, and scores
come from the committed results of the gallery study. `:reward:` and `:ends:` add what a puzzle does to both.
"""

from __future__ import annotations

import functools
import inspect
import json
import re
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from docutils import nodes
from docutils.parsers.rst import directives
from gallery import SCRIPT, make_replay, read_lines, solve
from markupsafe import Markup
from pictures import Picture
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from tables import make_table

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, Rules
from hrl_escape.env.observations.base import list_observations, make_observer
from hrl_escape.env.pictures.maps import save_map
from hrl_escape.env.pictures.moving_map import PLAYER, PLAYER_COLOURS
from hrl_escape.env.presets import PRESETS, TAGS, describe_config, get_preset, make_env_name
from hrl_escape.env.rewards import RewardConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError
from hrl_escape.options import OptionsEnv
from hrl_escape.planning.plan import Plan
from hrl_escape.templates import embed_json

PAGES = Path(__file__).parents[1] / "environments"
GROUPS = {"Button rooms": "buttons", "Puzzles on panels": "classic puzzle", "Random domains": "random domain",
          "Grid worlds": "grid world", "Rigid-body physics": "physics", "Velocities": "velocities"}
"""Headings of the index, and the tag of the presets below each."""
IN_FIRST_VERSION = ("paper-one-button", "paper-two-button", "larg-2019", "four-button-chain", "arm-two-button",
                    "clutter", "ten-button", "twenty-button", "bit-flip", "push-block")
"""Presets of 0.1, whose ids ended in -v0."""
SEARCH, EPISODES = "search-nearest", 3
SHOWN_NAMES = 8
"""Names of actions that a card lists before it abbreviates."""


class Score(NamedTuple):
    """Evaluation episodes of an agent in a preset."""

    agent: str
    escapes: list[int | None]  # primitives of each episode; None if it did not escape

    @property
    def success_rate(self) -> str:
        """Share of the episodes that escape."""
        return f"{sum(count is not None for count in self.escapes) / len(self.escapes):.0%}"

    @property
    def median(self) -> str:
        """Median primitives of an escape; empty where none escapes."""
        lengths = [count for count in self.escapes if count is not None]
        return f"{statistics.median(lengths):.0f}" if lengths else ""


@functools.cache
def make_solved_room(preset: str) -> tuple[RoomInstance, Plan | None]:
    """Instance 0 of a preset, and the planner's escape from it; None where the planner has none."""
    room = generate(get_preset(preset), 0)
    return room, solve(room)


def make_id(preset: str, options: bool = False) -> str:
    """Id of a preset's environment."""
    return f"hrl_escape/{make_env_name(preset)}{'Options' if options else ''}-v1"


@functools.cache
def list_scores(preset: str) -> list[Score]:
    """Scores from the gallery study; for presets that it leaves out, the search baseline in a few episodes of now."""
    found: dict[str, list[int | None]] = {}
    for run in read_lines("gallery"):
        if run["preset"] == preset and "agent" in run:
            found.setdefault(run["agent"], []).extend(run["escapes"])
    if not found:
        env = OptionsEnv(gymnasium.make(make_id(preset)), include_primitives=False)
        try:
            episodes = [record_episode(SEARCH, env, seed) for seed in range(EPISODES)]
            found[SEARCH] = [len(episode.states) - 1 if episode.success else None for episode in episodes]
        except EscapeError:  # some puzzles have no search baseline
            return []
        finally:
            env.close()
    return [Score(agent, escapes) for agent, escapes in found.items()]


def list_difficulty(preset: str) -> list[list[str]]:
    """Names and values of the difficulty of instance 0, from `docs/make_difficulty.py`."""
    return json.loads((PAGES / "difficulty.json").read_text(encoding="utf-8"))[preset]["rows"]


def has_study(preset: str) -> bool:
    """Whether the gallery study has the preset."""
    return any(run["preset"] == preset for run in read_lines("gallery"))


def list_names(names: Sequence[str]) -> str:
    """Names in code font, abbreviated where there are many."""
    shown = [f"`{name}`" for name in names]
    return ", ".join(shown if len(shown) <= SHOWN_NAMES else [*shown[: SHOWN_NAMES - 2], "...", shown[-1]])


def describe_box(observation: str, room: RoomInstance) -> str:
    """Shape and range of a vector observation."""
    observer = make_observer(observation, Rules(room))
    low, high = float(np.min(observer.low)), float(np.max(observer.high))
    return f"`Box({low:.4g}, {high:.4g}, ({len(observer.low)},), float32)`"


def describe_reward(reward: RewardConfig) -> str:
    """The reward of a primitive, and of the one that escapes."""
    total = reward.exit if reward.exit_replaces_step else reward.step + reward.exit
    if not reward.step and not total:
        return "The room itself pays nothing."
    return f"{reward.step:g} per primitive. The primitive that escapes gets {total:g} in total."


def list_arguments(preset: str) -> Iterator[tuple[str, str, str]]:
    """Name, default and meaning of each argument of a preset, from its docstring."""
    function = PRESETS[preset]
    documents = inspect.getdoc(function) or ""
    entries = re.split(r"\n(?=    \w+: )", documents.partition("Args:")[2].partition("Raises:")[0])
    meanings = dict(" ".join(entry.split()).split(": ", 1) for entry in entries if entry.strip())
    for name, parameter in inspect.signature(function).parameters.items():
        yield f"`{name}`", f"`{json.dumps(parameter.default)}`", meanings[name]


def list_versions(preset: str) -> Iterator[tuple[str, str, str]]:
    """Version of the id, release and change, newest first."""
    if preset in IN_FIRST_VERSION:
        yield "v1", "0.2", "Button numbers are independent of their order (except in the paper's rooms). Starts and " \
                           "noise are drawn as in the batched engine."
        yield "v0", "0.1", "First version."
    else:
        yield "v1", "0.2", "First version."


def make_heading(text: str) -> str:
    """A heading of the second level; directives cannot open sections."""
    return f"```{{rubric}} {text}\n:heading-level: 2\n```"


class Environment(Picture):
    """`{environment} taxi`: picture, tables and scores of a preset."""

    option_spec = {"reward": directives.unchanged, "ends": directives.unchanged}
    has_content = False

    def run(self) -> list[nodes.Node]:
        """Generate, plan, write."""
        preset = self.arguments[0]
        room, plan = make_solved_room(preset)
        if plan is None:
            path = self.choose_path(f"environment {preset}")
            save_map(path, room, Kinematics(room).make_state(room.starts[0], 0))
            shown: list[nodes.Node] = self.show(path, "Instance 0.", f"hrl-escape room --room {preset} --draw room.svg")
        else:
            shown = [nodes.raw("", f'<figure class="played">{plan.play(420)}<figcaption>The planner\'s escape from '
                                   f"instance 0. <code>hrl-escape solve --room {preset}</code></figcaption></figure>",
                               format="html")]
        return [*shown, *self.parse_text_to_nodes(self.write(preset, room, plan))]

    def write(self, preset: str, room: RoomInstance, plan: Plan | None) -> str:
        """The tables as Markdown."""
        config = get_preset(preset)
        options = OptionsEnv(gymnasium.make(make_id(preset)), include_primitives=False)
        options.reset(seed=0)
        names = [option.name for option in options.options]
        options.close()
        primitives = list(room.robot.actions.names)
        vectors = [kind.name for kind in list_observations() if kind.is_vector]
        rows = [
            ("Make it", f"`gymnasium.make(\"{make_id(preset)}\")`"),
            ("With options", f"`gymnasium.make(\"{make_id(preset, options=True)}\")`"),
            ("Rooms", describe_config(config)),
            ("Action space", f"`Discrete({len(primitives)})`: {list_names(primitives)}"),
            ("Options", f"{len(names)}: {list_names(names)}"),
            ("Observation space", "; ".join(f"`{name}` {describe_box(name, room)}" for name in vectors)
             + "; `pixels` `Box(0, 255, (84, 84, 3), uint8)`. The default is `state`."),
            ("Reward", " ".join(filter(None, (describe_reward(config.reward), self.options.get("reward"))))),
            ("Termination", self.options.get("ends") or "The robot's axis is in the exit and the puzzle is solved."),
            ("Truncation", f"After {room.horizon:,} primitives."),
            ("Planner", f"{plan.cost} primitives, return {plan.compute_return():g} from instance 0" if plan
             else "No plan of primitives: physics decides the result of a push. Options push in closed loop."),
            ("Difficulty", "; ".join(": ".join(row) for row in list_difficulty(preset))),
            ("Tags", ", ".join(TAGS[preset])),
            ("Play it", f"`hrl-escape play --room {preset}`"),
        ]
        parts = [make_table(("", ""), rows)]
        if arguments := list(list_arguments(preset)):
            name = arguments[0][0].strip("`")
            parts += [make_heading("Arguments"), f"Give them in parentheses, such as `{preset}({name}=...)`.",
                      make_table(("argument", "default", "meaning"), arguments)]
        if scores := list_scores(preset):
            parts += [make_heading("Who solves it"), make_table(
                ("agent", "success rate", "primitives of an escape (median)"),
                [(AgentSpec.parse(score.agent).title, score.success_rate, score.median) for score in scores])]
            parts.append("Five evaluation episodes per run over options. R-MAX has two runs of 20,000 primitives "
                         "([the study](../puzzles.md#scores-of-a-few-agents))." if has_study(preset) else
                         f"{EPISODES} episodes over options, run during the build of this page.")
        parts += [make_heading("Version history"), make_table(("id", "release", "change"), list_versions(preset))]
        return "\n\n".join(parts)


CARD = Markup("""<article class="room-card" data-tags="{tags}"><a href="{page}"><div class="player moving-map" \
data-number="{number}"></div></a>
<h3><a href="{page}">{name}</a></h3><p>{about}</p><p class="tags">{labels}</p></article>""")
LABEL = Markup('<span class="tag">{}</span>')
BUTTON = Markup('<button type="button" data-tag="{tag}" aria-pressed="false">{tag}</button>')
FILTER = Markup("""<script>
document.querySelectorAll(".tag-filter button").forEach((button, _, all) => button.addEventListener("click", () => {
  const on = button.getAttribute("aria-pressed") === "true";
  all.forEach(other => other.setAttribute("aria-pressed", String(other === button && !on)));
  document.querySelectorAll(".room-card").forEach(card => {
    card.hidden = !on && !card.dataset.tags.split("|").includes(button.dataset.tag);
  });
  document.querySelectorAll(".gallery-group").forEach(group => {
    group.hidden = [...group.querySelectorAll(".room-card")].every(card => card.hidden);
  });
}));
</script>""")


def read_summary(preset: str) -> tuple[str, str]:
    """Title and first sentence of a preset's page."""
    title, _, text = (PAGES / f"{preset}.md").read_text(encoding="utf-8").partition("\n")
    first = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text.strip().partition("\n\n")[0].replace("\n", " "))
    return title.removeprefix("# "), re.split(r"(?<=\w[.)]) (?=[A-Z])", first)[0].replace("`", "")


class Environments(SphinxDirective):
    """`{environments}`: a card for every preset, with a filter by tag."""

    def run(self) -> list[nodes.Node]:
        """Make all cards."""
        self.env.note_dependency(str(PAGES))
        tags = sorted({tag for found in TAGS.values() for tag in found})
        parts: list[str] = [f'<div class="tag-filter" role="group" aria-label="Filter by tag">'
                            f"{Markup().join(BUTTON.format(tag=tag) for tag in tags)}</div>"]
        data: list[dict[str, Any]] = []
        for title, tag in GROUPS.items():
            cards = []
            for preset in (name for name in PRESETS if tag in TAGS[name]):
                name, about = read_summary(preset)
                cards.append(CARD.format(
                    number=len(data), name=name, about=about, page=f"{preset}.html", tags="|".join(TAGS[preset]),
                    labels=Markup(" ").join(map(LABEL.format, TAGS[preset]))))
                data.append(make_replay(*make_solved_room(preset)))
            parts.append(f'<section class="gallery-group"><h2>{title}</h2><div class="gallery">{Markup().join(cards)}'
                         "</div></section>")
        if len(data) != len(PRESETS):
            raise self.error(f"{len(data)} cards for {len(PRESETS)} presets: each needs the tag of one group")
        script = SCRIPT.format(player=Markup((PLAYER / "moving_map.js").read_text(encoding="utf-8")),
                               data=embed_json(data), colours=embed_json(PLAYER_COLOURS))
        return [nodes.raw("", "".join((*parts, script, FILTER)), format="html")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("environment", Environment)
    app.add_directive("environments", Environments)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
