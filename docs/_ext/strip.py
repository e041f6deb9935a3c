"""The strip: moving rooms on one clock as one SVG picture, which code hosts play where they run no script.

`{strip}` makes it while the site is built, from episodes that are played then. A test compares it with the file
`docs/images/strip.svg`, which `python docs/_ext/strip.py` writes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
from docutils import nodes
from markupsafe import escape
from sphinx.util.docutils import SphinxDirective

from hrl_escape.agents import train
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env import RoomInstance, generate, get_preset
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures.moving_map import PLAYER_COLOURS as LOOK
from hrl_escape.env.pictures.moving_map import describe_room, make_frames
from hrl_escape.options import OptionsEnv
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets import load_benchmark

KEPT = Path(__file__).parents[1] / "images" / "strip.svg"
SEED, TRAINING, SEARCHER, LEARNER = 3, 10_000, "search-nearest", "smdp-q-learning"
FLOORS = ("pair", "chain-3", "chain-4")
BATCH, BATCH_COLUMNS = 48, 16
RATE, REST = 9.0, 2.0  # primitives a second, seconds of rest before all begin anew
WIDTH, CELL, GAP, MAP, HEAD = 960, 312, 12, 236, 52  # pixels
ROW = HEAD + MAP + 18 + GAP
INK, SOFT, CARD, EDGE = "#22262e", "#555c69", "#fbf9f4", "#e5dfd2"
FONT = "font-family=\"system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',Arial,sans-serif\""


class Stage(NamedTuple):
    """A room and what moved in it: `describe_room` and `make_frames`."""

    room: dict[str, Any]
    frames: dict[str, Any]

    @property
    def count(self) -> int:
        """Primitives."""
        return len(self.frames["x"]) - 1


class Scene(NamedTuple):
    """One card: rooms that are left one after another.

    Attributes:
        title: who acts.
        note: what is to be known of it.
        stages: at least one.
    """

    title: str
    note: str
    stages: tuple[Stage, ...]

    @property
    def count(self) -> int:
        """Primitives."""
        return sum(stage.count for stage in self.stages)


# --- episodes ------------------------------------------------------------------------------------


def solve(room: RoomInstance) -> Stage:
    """The planner's escape."""
    rules = Kinematics(room)
    plan = get_planner(room).solve(rules.make_state(room.starts[0], 0))
    return Stage(describe_room(room), make_frames(rules, plan.states))


def make_minds() -> list[Scene]:
    """A learner, a searcher and the planner in the same room, from the same start."""
    room = generate(get_preset("clutter"), SEED)
    recorder = StateRecorder(gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room, observation="features"))
    env = OptionsEnv(recorder, include_primitives=False)
    learner = train(LEARNER, env, primitives=TRAINING, seed=0, eval_episodes=0, progress=False).agent
    assert learner is not None
    played = [Stage(describe_room(room), record_episode(agent, env).to_json()["frames"])
              for agent in (learner, make_reference(SEARCHER, env, recorder))]
    notes = ("A learner", f"{LEARNER} after {TRAINING:,} primitives here"), ("A searcher", f"{SEARCHER}, in its first "
             "episode"), ("The planner", "knows which button needs which")
    return [Scene(*words, (stage,)) for words, stage in zip(notes, [*played, solve(room)], strict=True)]


def make_others() -> list[Scene]:
    """An arm, a puzzle and a tower, by the planner."""
    ladder = load_benchmark("ladder-1")
    arm, lights = (solve(generate(get_preset(name), 1)) for name in ("arm-two-button", "lights-out"))
    return [Scene("An arm", "only its hand presses", (arm,)),
            Scene("A puzzle", "Lights Out: a press flips the neighbours too", (lights,)),
            Scene("A tower", "an escape leads to the next rung's room",
                  tuple(solve(ladder[name].test[0]) for name in FLOORS))]


def make_batch() -> list[Stage]:
    """Rooms of one batch, each with a plan of its own, stepped together by the batched engine."""
    rooms = [generate(get_preset("four-button-chain"), seed) for seed in range(BATCH)]
    plans = [get_planner(room).solve(Kinematics(room).make_state(room.starts[0], 0)) for room in rooms]
    batch: Any = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=BATCH, instance=rooms).unwrapped
    _, infos = batch.reset(seed=0)
    assert list(infos["instance"]) == list(range(BATCH))
    states = [[batch.room.get_room_state(number)] for number in range(BATCH)]
    for step in range(max(plan.cost for plan in plans)):
        batch.step([plan.primitives[min(step, plan.cost - 1)] for plan in plans])
        for number, plan in enumerate(plans):
            if step < plan.cost:  # a room that was left begins anew at the next step
                states[number].append(batch.room.get_room_state(number))
    return [Stage(describe_room(room), make_frames(Kinematics(room), seen))
            for room, seen in zip(rooms, states, strict=True)]


# --- SVG -----------------------------------------------------------------------------------------


def animate(attribute: str, pairs: Sequence[tuple[float, str]], loop: float, is_smooth: bool = True) -> str:
    """An `animate` element from (second, value) pairs; the last value stays until the loop's end."""
    pairs = [*([] if pairs[0][0] == 0 else [(0.0, pairs[0][1])]), *pairs]
    pairs = [*pairs, (loop, pairs[-1][1])] if is_smooth else pairs
    times = ";".join(f"{second / loop:.4f}".rstrip("0").rstrip(".") for second, _ in pairs)
    kind = "" if is_smooth else ' calcMode="discrete"'
    return (f'<animate attributeName="{attribute}" dur="{loop:g}s" repeatCount="indefinite"{kind} keyTimes="{times}" '
            f'values="{";".join(value for _, value in pairs)}"/>')


def animate_transform(kind: str, pairs: Sequence[tuple[float, str]], loop: float) -> str:
    """The same for `translate` and `rotate`."""
    return animate("transform", pairs, loop).replace("<animate", "<animateTransform").replace(
        " dur=", f' type="{kind}" dur=', 1)


class Painter:
    """Draws a stage within a box of pixels, from a second on."""

    def __init__(self, stage: Stage, box: tuple[float, float, float, float], begin: float, loop: float) -> None:
        self.room, self.frames, self.begin, self.loop = *stage, begin, loop
        left, top, width, height = box
        extent = self.room["extent"]
        wide, deep = extent["x_max"] - extent["x_min"] + 0.5, extent["y_max"] - extent["y_min"] + 0.5
        self.zoom = min(width / wide, height / deep)
        self.left = left + (width - self.zoom * wide) / 2 - self.zoom * (extent["x_min"] - 0.25)
        self.top = top + (height - self.zoom * deep) / 2 + self.zoom * (extent["y_max"] + 0.25)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a place in the room."""
        return round(self.left + self.zoom * x, 1), round(self.top - self.zoom * y, 1)

    def second(self, frame: int) -> float:
        """When a frame is shown."""
        return self.begin + frame / RATE

    def rectangle(self, area: Sequence[float], style: str, inside: str = "") -> str:
        """A rectangle [x, y, width, height] along the axes, m."""
        x, y = self.at(area[0], area[1] + area[3])
        return (f'<rect x="{x}" y="{y}" width="{self.zoom * area[2]:.1f}" height="{self.zoom * area[3]:.1f}" '
                f'{style}>{inside}</rect>')

    def solid(self, solid: dict[str, Any], style: str, inside: str = "", thinnest: float = 0.0) -> str:
        """A box or a cylinder that may be turned, in pixels at least twice `thinnest` across."""
        x, y = self.at(solid["x"], solid["y"])
        wide, deep = (max(self.zoom * solid[side], thinnest) for side in ("half_x", "half_y"))
        if solid.get("shape") == "cylinder":
            return f'<circle cx="{x}" cy="{y}" r="{wide:.1f}" {style}>{inside}</circle>'
        turn = f" rotate({-math.degrees(solid['yaw']):.1f})" if solid["yaw"] else ""
        return (f'<rect x="{-wide:.1f}" y="{-deep:.1f}" width="{2 * wide:.1f}" height="{2 * deep:.1f}" '
                f'transform="translate({x} {y}){turn}" {style}>{inside}</rect>')

    def switch(self, attribute: str, changes: Sequence[tuple[int, str]]) -> str:
        """An attribute that jumps at frames; nothing where it never does."""
        if len(changes) < 2:
            return ""
        return animate(attribute, [(self.second(frame) if frame else 0.0, value) for frame, value in changes],
                       self.loop, is_smooth=False)

    def paint(self) -> str:
        """All of it."""
        room, frames = self.room, self.frames
        parts = [self.rectangle(floor, f'fill="{LOOK["floor"]}"') for floor in room["floors"]]
        doors = [(frame, LOOK["exitOpen" if is_open else "exitLocked"]) for frame, is_open in frames["open"]]
        parts.append(self.rectangle(room["exit"], f'fill-opacity=".5" fill="{doors[-1][1]}"',
                                    self.switch("fill", doors)))
        for solid in room["solids"]:
            parts.append(self.solid(solid, f'fill="{LOOK["wall" if solid["role"] == "wall" else "obstacle"]}"'))
        if room["door"]:
            shut = [(frame, "0" if is_open else "1") for frame, is_open in frames["open"]]
            parts.append(self.solid(room["door"], f'fill="{LOOK["door"]}" opacity="{shut[-1][1]}"',
                                    self.switch("opacity", shut)))
        parts.append(self.trail())
        for number, target in enumerate(room["targets"]):
            looks = [(frame, LOOK["lit" if number in lit else "off"][0]) for frame, lit in frames["lit"]]
            parts.append(self.solid(target, f'fill="{looks[-1][1]}" stroke="{LOOK["off"][1]}" stroke-width=".8"',
                                    self.switch("fill", looks), thinnest=min(3.0, 0.3 * self.zoom)))
        return "".join([*parts, self.robot()])

    def trail(self) -> str:
        """The way, drawn as it is gone."""
        places = [self.at(x, y) for x, y in zip(self.frames["x"], self.frames["y"], strict=True)]
        gone = [0.0]
        for here, there in zip(places, places[1:], strict=False):
            gone.append(gone[-1] + math.dist(here, there))
        points = " ".join(f"{x:g},{y:g}" for x, y in places)
        left = [(self.second(frame), f"{gone[-1] - length:.0f}") for frame, length in enumerate(gone)]
        return (f'<polyline points="{points}" fill="none" stroke="{LOOK["trail"]}" stroke-opacity=".55" '
                f'stroke-width="1.6" stroke-linejoin="round" stroke-dasharray="{gone[-1]:.0f}">'
                f'{animate("stroke-dashoffset", left, self.loop)}</polyline>')

    def robot(self) -> str:
        """Base, arrow and arm."""
        x, y, heading = (self.frames[name] for name in ("x", "y", "heading"))
        turned = [heading[0]]
        for angle in heading[1:]:
            turned.append(turned[-1] + math.remainder(angle - turned[-1], 2 * math.pi))
        places = [(self.second(n), "{:g} {:g}".format(*self.at(*place)))
                  for n, place in enumerate(zip(x, y, strict=True))]
        turns = [(self.second(n), f"{-math.degrees(angle):.0f}") for n, angle in enumerate(turned)]
        radius = max(self.zoom * self.room["radius"], 4.0)
        body = (f'<g transform="translate({places[-1][1]})">{animate_transform("translate", places, self.loop)}'
                f'<g transform="rotate({turns[-1][1]})">{animate_transform("rotate", turns, self.loop)}'
                f'<circle r="{radius:.1f}" fill="{LOOK["body"]}" stroke="{LOOK["bodyEdge"]}"/>'
                f'<path d="M{0.82 * radius:.1f} 0L{-0.6 * radius:.1f} {0.45 * radius:.1f}L{-0.3 * radius:.1f} 0'
                f'L{-0.6 * radius:.1f} {-0.45 * radius:.1f}Z" fill="#fff"/></g></g>')
        if not self.frames["arm"]:
            return body
        arms = [(self.second(n), " ".join("{:g},{:g}".format(*self.at(*joint)) for joint in arm))
                for n, arm in enumerate(self.frames["arm"])]
        hands = [(second, arm.split(" ")[-1].replace(",", " ")) for second, arm in arms]
        return body + (
            f'<polyline points="{arms[-1][1]}" fill="none" stroke="{LOOK["arm"]}" stroke-width="2.6" '
            f'stroke-linecap="round">{animate("points", arms, self.loop)}</polyline>'
            f'<circle r="{max(self.zoom * self.room["hand"], 2.5):.1f}" fill="{LOOK["hand"]}" '
            f'transform="translate({hands[-1][1]})">{animate_transform("translate", hands, self.loop)}</circle>')


def write(x: float, y: float, text: str, style: str, inside: str = "") -> str:
    """A line of text."""
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(text)}{inside}</text>'


def choose_loop(longest: int) -> float:
    """Seconds after which all begin anew, if the longest episode has so many primitives."""
    return round(longest / RATE + REST, 1)


def draw_card(scene: Scene, column: int, row: int, longest: int) -> str:
    """A card: words, rooms one after another, and a bar that grows with the primitives."""
    left, top, loop = column * (CELL + GAP), row * ROW, choose_loop(longest)
    parts = [f'<rect x="{left}" y="{top}" width="{CELL}" height="{HEAD + MAP + 18}" rx="8" fill="{CARD}" '
             f'stroke="{EDGE}"/>',
             write(left + 14, top + 23, scene.title, f'font-size="15" font-weight="650" fill="{INK}"'),
             write(left + 14, top + 41, scene.note, f'font-size="11.5" fill="{SOFT}"')]
    begin, end = 0, scene.count / RATE
    for number, stage in enumerate(scene.stages):
        painter = Painter(stage, (left + 8, top + HEAD, CELL - 16, MAP), begin / RATE, loop)
        is_last = number == len(scene.stages) - 1
        shown = [(0.0, "0"), (begin / RATE, "1")] if begin else [(0.0, "1")]
        shown += [] if is_last else [((begin + stage.count) / RATE, "0")]
        change = "" if len(scene.stages) == 1 else animate("opacity", shown, loop, is_smooth=False)
        parts.append(f'<g opacity="{int(is_last)}">{change}{painter.paint()}</g>')
        begin += stage.count
    full = (CELL - 28) * scene.count / longest
    bar = animate("width", [(0.0, "0"), (end, f"{full:.1f}")], loop)
    parts.append(f'<rect x="{left + 14}" y="{top + HEAD + MAP + 5}" width="{full:.1f}" height="4" rx="2" '
                 f'fill="{LOOK["exitOpen"]}">{bar}</rect>')
    done = animate("opacity", [(0.0, "0"), (end, "1")], loop, is_smooth=False)
    parts.append(write(left + CELL - 14, top + 23, f"out in {scene.count}", 'font-size="13" font-weight="650" '
                       f'text-anchor="end" fill="{LOOK["exitInk"]}"', done))
    return f"<g>{''.join(parts)}</g>"


def draw_strip(rows: Sequence[Sequence[Scene]], batch: Sequence[Stage]) -> str:
    """The picture."""
    longest = max(scene.count for row in rows for scene in row)
    loop, side = choose_loop(longest), (WIDTH - 28) / BATCH_COLUMNS
    parts = [draw_card(scene, column, number, longest)
             for number, row in enumerate(rows) for column, scene in enumerate(row)]
    top, lines = len(rows) * ROW, -(-len(batch) // BATCH_COLUMNS)
    bottom = top + HEAD + lines * side + 8
    parts.append(f'<rect y="{top}" width="{WIDTH}" height="{bottom - top:.1f}" rx="8" fill="{CARD}" stroke="{EDGE}"/>')
    parts.append(write(14, top + 23, "The batch", f'font-size="15" font-weight="650" fill="{INK}"'))
    parts.append(write(14, top + 41, f"{len(batch)} rooms, one step of the batched engine for all; it takes thousands",
                       f'font-size="11.5" fill="{SOFT}"'))
    for number, stage in enumerate(batch):
        line, column = divmod(number, BATCH_COLUMNS)
        box = (14 + column * side + 2, top + HEAD + line * side + 2, side - 4, side - 4)
        parts.append(f"<g>{Painter(stage, box, 0.0, loop).paint()}</g>")
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-1 -1 {WIDTH + 2} {bottom + 2:.0f}" '
            f'width="{WIDTH + 2}" {FONT}>\n' + "\n".join(parts) + "\n</svg>\n")


def make_strip() -> str:
    """Play all episodes and draw them."""
    return draw_strip([make_minds(), make_others()], make_batch())


class Strip(SphinxDirective):
    """`{strip}`: the picture, made anew and kept with the site's images; the content is its caption."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Write the file and show it."""
        folder = Path(self.env.app.outdir) / "_images"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / KEPT.name).write_text(make_strip(), encoding="utf-8")
        words = escape(" ".join(self.content))
        return [nodes.raw("", f'<figure class="strip"><img src="_images/{KEPT.name}" alt="{words}">'
                          f"<figcaption>{words}</figcaption></figure>", format="html")]


if __name__ == "__main__":
    KEPT.write_text(make_strip(), encoding="utf-8")
