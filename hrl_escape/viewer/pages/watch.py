"""Watch mode in the browser: an agent drives, and the page shows its values, plans and transitions.

The driver runs in one thread, which also updates the page. Everything shown therefore belongs to the same moment.
Clients operate the gate and request previews.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from hrl_escape.agents.decisions import name_action
from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.env.pictures import palette
from hrl_escape.env.puzzles.graphs import find_edges_that_matter
from hrl_escape.env.puzzles.mixins import Graphed, get_mixin
from hrl_escape.errors import EscapeError
from hrl_escape.options.meta_actions import PlannedOption
from hrl_escape.planning.goals import ExitGoal, PressGoal
from hrl_escape.planning.paths.navigator import Navigator
from hrl_escape.text.text_env import Turn
from hrl_escape.viewer.extra import uplot
from hrl_escape.viewer.pages.panels import KnownEdges, make_bars, make_facts, make_lines, make_table
from hrl_escape.viewer.pages.room import RoomPage, name_room
from hrl_escape.viewer.play.commands import praise
from hrl_escape.viewer.play.episode import PressEvidence
from hrl_escape.viewer.server import Server
from hrl_escape.viewer.watch.watch import Preview, Watch

FASTEST = 60.0
REFRESH = 0.1
"""Shortest time between two updates of the panel while the driver runs, s."""
GAMMA_K = "\N{GREEK SMALL LETTER GAMMA}\N{MODIFIER LETTER SMALL K}"
SMDP_NOTE = f"k: number of primitives; R: their discounted reward; {GAMMA_K}: discount of the next state's value"
NESTED = 3 * "\N{NO-BREAK SPACE}"
CALLER, ROOM, ERROR = "#0b57d0", "#5f6368", "#b3261e"
"""Colours of speakers in a transcript."""
_ENDED = {"reached": "", "episode-over": "episode over"}


class WatchPage:
    """Page that shows a watched driver.

    Attributes:
        problem: reason why the driver stopped; empty while it runs.
        finished: set once the driver has stopped.
    """

    def __init__(self, server: Server, watch: Watch) -> None:
        self.server, self.watch = server, watch
        self.problem = ""
        self.finished = threading.Event()
        self._refreshed = 0.0
        self._escape = ""  # message about an escape during its celebration
        self._previewing = threading.Lock()
        self._planned: tuple[Preview | None] | None = None  # plan in the current drawing
        room = watch.driver.room
        self._navigator = Navigator(room.instance)
        self._evidence = None if watch.driver.text_env is None else PressEvidence(room.instance)
        self.page = RoomPage(server, room.instance, self._get_state(), owns_keys=True, discovery=self._evidence,
                             reveals=False)
        watch.on_change, watch.on_wait = self._show_change, self._show_wait
        self._build()

    def run(self, episodes: int | None = None) -> None:
        """Drive until the gate is stopped; show errors on the page."""
        try:
            self.watch.run(episodes)
            self.problem = "all episodes are over"
        except EscapeError as error:
            self.problem = str(error)
        finally:
            if not self.watch.gate.is_stopped:
                self._show_everything()
            self.finished.set()

    # --- the panel -------------------------------------------------------------------------------

    def _build(self) -> None:
        gui, gate = self.server.gui, self.watch.gate
        self._facts = gui.add_html("", order=10.0)
        self._now = gui.add_html("", order=30.0)
        with gui.add_folder("Drive", order=35.0):
            self._buttons = gui.add_button_group("", ("Pause", "Run", "1 primitive", "1 decision"))
            self._speed = gui.add_slider("per second", 1, FASTEST, 1, gate.pace or FASTEST)
            self._fast = gui.add_checkbox("unlimited", gate.pace is None)
        tabs = gui.add_tab_group(order=40.0)
        self._talk = None
        if self.watch.driver.text_env is not None:
            with tabs.add_tab("Transcript"):
                reveal = gui.add_checkbox("show the true graph", False)
                self._talk = gui.add_html("")
            reveal.on_update(lambda event: self._reveal(event.target.value))
        with tabs.add_tab("Agent"):
            self._calls = gui.add_html("", visible=False)
            self._values = gui.add_html("")
            empty = (np.zeros(1), np.zeros(1))
            self._plot = gui.add_uplot(
                empty, (uplot.Series(label="primitives"), uplot.Series(label="V", stroke=palette.TRAIL, width=2)),
                height=150, title="value of the state at decisions", scales={"x": uplot.Scale(time=False)},
                legend=uplot.Legend(show=False), padding=(10, 18, 0, 0), visible=False,
            )
        with tabs.add_tab("SMDP"):
            self._table = gui.add_html("")
        with tabs.add_tab("Log"):
            self._log = gui.add_html("")
        with tabs.add_tab("Preview"):
            names = tuple(self.watch.previewer.options)
            self._choice = gui.add_dropdown("option", names)
            self._ask = gui.add_button("Preview this option")
            self._clear = gui.add_button("Clear")
            self._answer = gui.add_html(make_lines(["The pink path and posture show where the option would lead"]))
        self._buttons.on_click(lambda event: self._turn(event.target.value))
        self._speed.on_update(lambda _: self._set_pace())
        self._fast.on_update(lambda _: self._set_pace())
        self._ask.on_click(lambda _: self._show_preview())
        self._clear.on_click(lambda _: self.page.scene.draw_future("preview", []))
        keys: tuple[tuple[Any, str, str], ...] = (("space", "Pause or run", "toggle"),
                                                  ("P", "One primitive", "1 primitive"),
                                                  ("D", "One decision", "1 decision"))
        for key, label, what in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda _, what=what: self._turn(what))

    def _turn(self, what: str) -> None:
        gate = self.watch.gate
        if what == "toggle":
            what = "Run" if gate.is_paused else "Pause"
        if what in ("Pause", "Run"):
            gate.pause(what == "Pause")
        else:
            gate.step(primitives=int(what == "1 primitive"), decisions=int(what == "1 decision"))
        self._show_facts()

    def _reveal(self, is_shown: bool) -> None:
        """Show the true graph of a room whose caller does not see it, or hide it again."""
        self.page.hide_graph(None if is_shown else self._evidence, self._get_state())

    def _get_state(self) -> RoomState:
        room = self.watch.driver.room
        return self.watch.states[-1] if self.watch.states else room.room.state if room.room else room.get_state()

    def _set_pace(self) -> None:
        self.watch.gate.pace = None if self._fast.value else float(self._speed.value)

    def _show_preview(self) -> None:
        """Preview the chosen option from the current state; runs in the client's thread, one preview at a time."""
        if not self.watch.states or not self._previewing.acquire(blocking=False):
            return
        try:
            preview = self.watch.previewer.preview(self._choice.value, self.watch.states[-1])
        finally:
            self._previewing.release()
        self.page.scene.draw_future("preview", preview.states)
        lines = [f"{preview.name}: {len(preview.states) - 1} primitives"]
        if preview.problem:
            lines.append(preview.problem)
        if preview.pressed:
            lines.append(f"presses {', '.join(preview.pressed)}")
        if preview.escapes:
            lines.append("and escapes")
        if not preview.problem:
            at = preview.states[-1]
            lines.append(f"ends at ({at.x:.2f}, {at.y:.2f}) m")
        self._answer.content = make_lines(lines, "preview")

    # --- following the driver ----------------------------------------------------------------------

    def _show_change(self, step: PrimitiveStep | None) -> None:
        """Show a choice (no step) or a primitive."""
        pace = self.watch.gate.pace
        if step is not None and self._evidence is not None:
            self._evidence.note(step)
        if step is not None and pace is not None:
            self.page.move(step.after, 1.0 / pace, lambda: self.watch.gate.pace != pace)
        is_due = self.watch.gate.is_paused or time.monotonic() - self._refreshed >= REFRESH
        if pace is not None or is_due:
            self._show_scene()
        if is_due:
            self._refresh()
        if step is not None and step.end is EpisodeEnd.ESCAPED and pace is not None:
            self._celebrate()

    def _celebrate(self) -> None:
        """Show the escape and the best known one, which is searched for at the first escape."""
        self.page.find_best()
        self._escape = praise(self.watch.total, self.page.best)
        self._refresh()
        self.page.celebrate(lambda: self.watch.gate.is_stopped or self.watch.gate.pace is None)
        self._escape = ""

    def _show_wait(self) -> None:
        """Update everything before a primitive that has to wait."""
        if self.watch.gate.is_paused:
            self._show_everything()

    def _show_everything(self) -> None:
        self._planned = None
        self._show_scene()
        self._refresh()

    def _show_scene(self) -> None:
        """Show the current state, the path so far, and the plan if it is new."""
        watch = self.watch
        if watch.states:
            self.page.show(watch.states[-1])
            self.page.scene.draw_trail(watch.states)
        self.page.scene.draw_goals([(each.name, *each.call.place) for each in watch.calls if each.call.place])
        if self._planned is None or watch.plan is not self._planned[0]:
            self._planned = (watch.plan,)
            self._show_plan()

    def _show_plan(self) -> None:
        """Draw the predicted course of the running option, its final posture, and OMPL's path for the base."""
        plan, scene = self.watch.plan, self.page.scene
        scene.draw_future("plan", plan.states[self.watch.in_decision :] if plan is not None else [])
        path: list[tuple[float, float]] = []
        if plan is not None and not plan.problem:
            option = self.watch.previewer.options[plan.name]
            goal = option.goal if isinstance(option, PlannedOption) else None
            state, instance = plan.states[0], scene.instance
            by_hand = isinstance(goal, PressGoal) and instance.dynamics.press_with == "hand"
            if isinstance(goal, (PressGoal, ExitGoal)) and not by_hand:
                shut = not instance.puzzle.is_solved(state.puzzle)
                found = self._navigator.plan((state.x, state.y), goal, door_shut=shut,
                                             heading=scene.rules.get_heading(state))
                path = [(float(x), float(y)) for x, y in found.path]
        scene.draw_path(path)

    def _refresh(self) -> None:
        self._refreshed = time.monotonic()
        self._show_facts()
        self._show_now()
        watch = self.watch
        if watch.choice is not None:
            choice = watch.choice
            if not isinstance(choice.action, np.ndarray):  # velocities have no bars
                self._values.content = make_bars(watch.driver.names, choice.values, choice.mask, choice.action,
                                                 choice.meaning, choice.notes)
            self._show_learned()
        rows = [(name, str(step.duration), f"{step.reward:.2f}", f"{step.discount:.4f}", f"{step.summed_reward:g}",
                 _ENDED.get(ended, ended)) for name, step, ended in reversed(watch.decisions)]
        header = ("decision", "k", "R", GAMMA_K, "sum of r", "")
        self._table.content = make_table(header, rows, "smdp", "no decision is complete yet") + make_lines([SMDP_NOTE])
        calls = [(f"{NESTED * depth}{each.name}", str(each.call.primitives), f"{each.reward:g}", each.ending)
                 for depth, each in enumerate(watch.calls)]
        self._calls.content = make_table(("running call", "primitives", "reward", ""), calls, "calls")
        self._calls.visible = bool(calls)
        if self._talk is not None and watch.driver.text_env is not None:
            self._talk.content = make_talk(watch.driver.text_env.transcript)
        self._log.content = make_lines(list(reversed(watch.events))[:24], "log")
        if len(watch.values) > 1:
            xs, ys = zip(*watch.values, strict=True)
            self._plot.visible = True
            self._plot.data = (np.array(xs, dtype=np.float64), np.array(ys, dtype=np.float64))

    def _show_learned(self) -> None:
        """Draw the graph that the agent believes in next to the true one, and count its correct edges."""
        graph = self.watch.read_graph()
        if graph is None or not self.watch.states:
            return
        true = get_mixin(self.watch.driver.room.instance.puzzle, Graphed)
        believed, needed = (find_edges_that_matter(edges, true.goal_targets) for edges in (graph, true.edges))
        found, wrong = len(believed & needed), len(believed - needed)
        words = f"learned: {found} of {len(needed)} edges that matter" + (f", {wrong} wrong" if wrong else "")
        self.page.show_belief(self.watch.states[-1], KnownEdges(graph), words)

    def _show_facts(self) -> None:
        watch = self.watch
        facts = (("episode", str(watch.episode)), ("primitives", str(max(len(watch.states) - 1, 0))),
                 ("return", f"{watch.total:g}"), ("total", f"{watch.primitives:,}"))
        state = self.problem or ("paused" if watch.gate.is_paused else "running")
        self._facts.content = make_facts(facts, f"{watch.driver.name} in {name_room(watch.driver.room.instance)}: "
                                         f"{self._escape or state}", steps=max(len(watch.states) - 1, 0),
                                         state="paused" if watch.gate.is_paused else "running",
                                         primitives=watch.primitives, decisions=len(watch.decisions))

    def _show_now(self) -> None:
        watch = self.watch
        if watch.choice is None:
            return
        name = name_action(watch.driver.names, watch.choice.action)
        length = len(watch.plan.states) - 1 if watch.plan is not None else 1
        share = min(1.0, watch.in_decision / max(length, 1))
        problem = f" ({watch.plan.problem})" if watch.plan is not None and watch.plan.problem else ""
        self._now.content = make_lines([
            Markup("<b>{}</b>: {} of {} primitives{}").format(name, watch.in_decision, length, problem),
            Markup('<div style="height:6px;border-radius:3px;background:#e6e8ec"><div style="height:6px;'
                   'border-radius:3px;background:#d55e00;width:{:.0f}%"></div></div>').format(100 * share),
        ], "now")


def make_talk(turns: Sequence[Turn]) -> str:
    """Return a game as HTML, the oldest turn first, with the name of each speaker. The box stays at its end."""
    said = []
    for turn in turns:
        if turn.call is not None:
            values = turn.call.arguments.values() if isinstance(turn.call.arguments, dict) else [turn.call.arguments]
            said.append(_make_speech("Caller", Markup("<b>{}</b> {}").format(
                turn.call.name, ", ".join(map(str, values))), CALLER))
        said.append(_make_speech("Room", turn.text, ERROR if turn.is_error else ROOM))
    return ('<div style="display:flex;flex-direction:column-reverse;max-height:440px;overflow-y:auto">'
            f'{make_lines(said, "talk")}</div>')


def _make_speech(speaker: str, text: str, colour: str) -> Markup:
    return Markup('<div class="speech" data-speaker="{0}" style="border-left:3px solid {2};padding-left:6px;'
                  'margin:3px 0;white-space:pre-line"><b style="color:{2}">{0}</b> {1}</div>').format(
                      speaker, text, colour)


def run_in_thread(page: WatchPage) -> threading.Thread:
    """Run the driver in its own thread."""
    thread = threading.Thread(target=page.run, daemon=True)
    thread.start()
    return thread
