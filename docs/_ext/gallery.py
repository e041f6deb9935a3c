"""Moving maps of planned escapes: `{rungs-gallery}` has a card for each rung, `{play} --room clutter` shows one room.

Rooms are generated and solved during the build. Efficiencies come from the committed results of the ladder study.
"""

from __future__ import annotations

import json
import re
import statistics
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from docutils import nodes
from markupsafe import Markup, escape
from pictures import make_room
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from strip import Strip

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.references.registry import SEARCH_BASELINES
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.moving_map import PLAYER, PLAYER_COLOURS, describe_room, make_frames
from hrl_escape.env.presets import describe_config
from hrl_escape.errors import EscapeError
from hrl_escape.planning.plan import Plan
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets import load_benchmark
from hrl_escape.templates import embed_json
from studies.store import read_rows

ROOT = Path(__file__).parents[2]
BENCHMARK = "ladder-1"
RANDOM, ORACLE = "random-options", "oracle"


class Card(NamedTuple):
    """A rung of the gallery.

    Attributes:
        name: heading.
        about: what it is, in a line.
        id: name of its set.
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


def list_rungs() -> Iterator[Card]:
    """A card for each rung: efficiency in unseen rooms of random options, the best search baseline and agent."""
    scores: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in read_lines("ladder"):
        if run["protocol"] == "generalise":
            scores[run["rung"]][run["agent"] if run["primitives"] else run["agent"].partition("+")[0]].append(
                run["efficiency"])
    for rung in load_benchmark(BENCHMARK):
        means = {agent: statistics.fmean(values) for agent, values in scores[rung.name].items()}
        baselines = {agent: value for agent, value in means.items() if agent in SEARCH_BASELINES}
        trained = {agent: value for agent, value in means.items()
                   if agent not in SEARCH_BASELINES and agent not in (RANDOM, ORACLE) and "sweep" not in agent}
        facts = [("requires", rung.isolates)]
        facts += [("random options", f"{means[RANDOM]:.2f}")] if RANDOM in means else []
        for what, found in (("best search baseline", baselines), ("best agent", trained)):
            if found:
                best = max(found, key=found.__getitem__)
                facts.append((what, f"{found[best]:.2f} ({AgentSpec.parse(best).title})"))
        yield Card(rung.name, describe_config(rung.config), f"{BENCHMARK}/{rung.name}", rung.test[0], tuple(facts),
                   f"hrl-escape ladder show {rung.name}")


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


class RungsGallery(SphinxDirective):
    """`{rungs-gallery}`."""

    def run(self) -> list[nodes.Node]:
        """Make all cards."""
        return [nodes.raw("", write_cards(list(list_rungs())), format="html")]


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
    app.add_directive("rungs-gallery", RungsGallery)
    app.add_directive("play", Play)
    app.add_directive("strip", Strip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
