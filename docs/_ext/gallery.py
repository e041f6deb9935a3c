"""The gallery: a card for every preset and every rung, with the planner's escape as a moving map.

Rooms are generated, solved and searched while the site is built; how learners do comes from the lines of the studies.
`{gallery} presets` shows all presets, `{gallery} rungs` all rungs of the ladder, `{play} --room clutter` one escape.
"""

from __future__ import annotations

import json
import re
import statistics
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
from docutils import nodes
from markupsafe import Markup, escape
from pictures import make_room
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from strip import Strip

from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics, Rules
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.pictures.moving_map import PLAYER, PLAYER_COLOURS, describe_room, make_frames
from hrl_escape.env.presets import PRESETS, describe_config, get_preset, make_env_name
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EscapeError
from hrl_escape.options import OptionsEnv
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets import load_benchmark
from hrl_escape.templates import embed_json
from studies.store import read_rows

ROOT = Path(__file__).parents[2]
BENCHMARK = "ladder-1"
CHANCE, ORACLE = "random-options", "oracle"
SEARCHER, SEARCHES = "search-nearest", 3
PLAYED = {CHANCE: "chance", "smdp-r-max": "learner"}
"""Agents of the study of puzzles, by what they are."""


class Card(NamedTuple):
    """A room or a rung of the gallery.

    Attributes:
        name: heading.
        about: what it is, in a line.
        id: by which it is made.
        room: whose escape is played.
        facts: (what, how much), in order.
        command: to try it.
    """

    name: str
    about: str
    id: str
    room: RoomInstance
    facts: tuple[tuple[str, str], ...]
    command: str


def solve(room: RoomInstance) -> Plan | None:
    """The planner's escape, supposing likely outcomes; None where the planner has none."""
    try:
        return get_planner(room).solve(Kinematics(room).make_state(room.starts[0], 0))
    except EscapeError:
        return None


def make_replay(room: RoomInstance, plan: Plan | None) -> dict[str, object]:
    """What the player is given; a room without a plan stands still."""
    rules = Kinematics(room)
    states = plan.states if plan else (rules.make_state(room.starts[0], 0),)
    decisions = [[part.name, part.stop - part.start, "reached"] for part in plan.parts] if plan else []
    return {"room": {**describe_room(room), "options": sorted({name for name, *_ in decisions})},
            "replay": {"decisions": decisions, "frames": make_frames(rules, states)}}


def read_lines(study: str) -> list[dict[str, Any]]:
    """The lines of a study's results."""
    return [json.loads(line) for line in read_rows(ROOT / "studies" / study / "raw.jsonl")]


def describe_spaces(room: RoomInstance) -> str:
    """Numbers of actions, and of a vector observation."""
    numbers = len(make_observer("features", Rules(room)).names)
    return f"{len(room.robot.actions)} primitives, {len(room.targets) + 1} options; {numbers} features"


def search(room: RoomInstance) -> str:
    """How a searcher that learns nothing does in episodes of its own; empty where it does not apply."""
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room), include_primitives=False)
    try:
        episodes = [record_episode(SEARCHER, env, seed) for seed in range(SEARCHES)]
    except EscapeError:
        return ""
    finally:
        env.close()
    return describe_ends([len(episode.states) - 1 if episode.success else None for episode in episodes])


def describe_ends(escapes: Sequence[int | None]) -> str:
    """Share of episodes that escape, and the median of their primitives."""
    lengths = [count for count in escapes if count is not None]
    return f"{len(lengths) / len(escapes):.0%}" + (f", {statistics.median(lengths):.0f}" if lengths else "")


def list_presets() -> Iterator[Card]:
    """A card for each preset: escapes and their primitives, of a searcher and of what the study of puzzles has run."""
    played: dict[str, dict[str, list[int | None]]] = defaultdict(lambda: defaultdict(list))
    for run in read_lines("gallery"):
        if run.get("agent") in PLAYED:
            played[run["preset"]][run["agent"]] += run["escapes"]
    for name in PRESETS:
        config = get_preset(name)
        room = generate(config, 0)
        facts = [("spaces", describe_spaces(room)), ("horizon", f"{room.horizon:,} primitives")]
        facts += [(PLAYED[agent], describe_ends(ends)) for agent, ends in played[name].items()]
        found = "" if config.dynamics.kind == "physics" else search(room)
        facts += [("searcher", found)] if found else []
        yield Card(name, describe_config(config), f"hrl_escape/{make_env_name(name)}-v1", room, tuple(facts),
                   f"hrl-escape play --room {name}")


def list_rungs() -> Iterator[Card]:
    """A card for each rung, with the efficiency of chance, the best searcher and the best learner in unseen rooms."""
    scores: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in read_lines("ladder"):
        if run["protocol"] == "generalise":
            scores[run["rung"]][run["agent"] if run["primitives"] else run["agent"].partition("+")[0]].append(
                run["efficiency"])
    for rung in load_benchmark(BENCHMARK):
        means = {agent: statistics.fmean(values) for agent, values in scores[rung.name].items()}
        searchers = {agent: value for agent, value in means.items() if agent in SEARCH_BASELINES}
        learners = {agent: value for agent, value in means.items()
                    if agent not in SEARCH_BASELINES and agent not in (CHANCE, ORACLE) and "round" not in agent}
        facts = [("asks for", rung.isolates)]
        facts += [("chance over options", f"{means[CHANCE]:.2f}")] if CHANCE in means else []
        for what, found in (("best searcher", searchers), ("best learner", learners)):
            if found:
                best = max(found, key=found.__getitem__)
                facts.append((what, f"{found[best]:.2f} ({best.partition('+')[0]})"))
        yield Card(rung.name, describe_config(rung.config), f"{BENCHMARK}/{rung.name}", rung.test[0], tuple(facts),
                   f"hrl-escape ladder show {rung.name}")


CARDS = {"presets": list_presets, "rungs": list_rungs}
CARD = Markup("""<article class="room-card"><div class="player moving-map" data-number="{number}"></div>
<h3>{name}</h3><p>{about}</p><p><code>{id}</code></p><dl>{facts}</dl><p><code class="command">{command}</code></p>
</article>""")
FACT = Markup("<div><dt>{what}</dt><dd>{value}</dd></div>")
SCRIPT = Markup("""<script>{player}</script><script>
for (const [number, {{ room, replay }}] of {data}.entries()) {{
  const box = document.querySelectorAll(".moving-map[data-number]")[number];
  const player = new Player(box, room, replay, {colours}, true);
  player.loops = true;
  if (!STILL && player.count) player.play();
}}
</script>""")


def write_cards(cards: Sequence[Card]) -> str:
    """The gallery as HTML, with one script for all its players."""
    articles, data = [], []
    for number, card in enumerate(cards):
        plan = solve(card.room)
        steps = (("planner's escape", f"{plan.cost} primitives, return {plan.compute_return():g}"),) if plan else ()
        facts = Markup().join(FACT.format(what=what, value=value) for what, value in (*steps, *card.facts))
        articles.append(CARD.format(number=number, name=card.name, about=card.about, id=card.id, facts=facts,
                                    command=card.command))
        data.append(make_replay(card.room, plan))
    script = SCRIPT.format(player=Markup((PLAYER / "moving_map.js").read_text(encoding="utf-8")),
                           data=embed_json(data), colours=embed_json(PLAYER_COLOURS))
    return f'<div class="gallery">{Markup().join(articles)}</div>{script}'


class Gallery(SphinxDirective):
    """`{gallery} presets`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Make all cards."""
        return [nodes.raw("", write_cards(list(CARDS[self.arguments[0]]())), format="html")]


class Play(SphinxDirective):
    """`{play} --room clutter#3`: the planner's escape of one room; the content is its caption."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Solve and play."""
        plan = solve(make_room(self.arguments[0]))
        if plan is None:
            raise self.error(f"no plan to play: {self.arguments[0]}")
        words = re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(" ".join(self.content))))
        return [nodes.raw("", f'<figure class="played">{plan.play(420)}<figcaption>{words} <code>hrl-escape solve '
                          f"{escape(self.arguments[0])}</code></figcaption></figure>", format="html")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("gallery", Gallery)
    app.add_directive("play", Play)
    app.add_directive("strip", Strip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
