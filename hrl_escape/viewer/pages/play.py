"""Manual mode in the browser: keys and buttons drive an `Episode` that a `RoomPage` shows.

Clients only put keys into a queue, and one thread executes them. A client that disconnects leaves only its moves
behind.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.errors import EscapeError
from hrl_escape.viewer.pages.panels import make_facts, make_keys
from hrl_escape.viewer.pages.room import RoomPage, name_room
from hrl_escape.viewer.play.commands import HELP, KEYS, Command, Controls, carry_out
from hrl_escape.viewer.play.episode import Episode, SavedEpisode
from hrl_escape.viewer.server import Server

PLAY_STRIDE = 0.18
"""Duration of one primitive on the screen, s; shorter while keys are waiting."""
MOST_WAITING = 30
_HOTKEYS = {"up": "arrowup", "down": "arrowdown", "left": "arrowleft", "right": "arrowright"}
_DRIVE = {"\N{ANTICLOCKWISE OPEN CIRCLE ARROW} turn": "left", "\N{BLACK UP-POINTING TRIANGLE} ahead": "w",
          "turn \N{CLOCKWISE OPEN CIRCLE ARROW}": "right"}
_STRAFE = {"\N{BLACK LEFT-POINTING TRIANGLE} left": "a", "\N{BLACK DOWN-POINTING TRIANGLE} back": "s",
           "right \N{BLACK RIGHT-POINTING TRIANGLE}": "d"}
_EPISODE = {"Undo": "z", "Again": "r", "Next room": "n"}


class PlayPage:
    """Page that plays an episode, one primitive in `stride` seconds; `folder` is for saved episodes."""

    def __init__(self, server: Server, episode: Episode, folder: Path = Path("episodes"),
                 stride: float = PLAY_STRIDE) -> None:
        self.server, self.episode = server, episode
        self._folder, self._stride = folder, stride
        self._waiting: queue.Queue[Command | str] = queue.Queue()
        task = "Press the buttons in the order of the graph" if episode.discovery is None else (
            "Find out which buttons wait for which")
        self._note = f"{task}, then drive into the exit"
        self.page = RoomPage(server, episode.instance, episode.state, owns_keys=True, discovery=episode.discovery)
        self._meta: list[Any] = []
        self._build()
        self._enter_room()

    # --- the panel -----------------------------------------------------------------------------

    def _build(self) -> None:
        gui = self.server.gui
        self._facts = gui.add_html("", order=10.0)
        self._meta_folder = gui.add_folder("Meta-actions", order=30.0)
        with gui.add_folder("Drive", order=40.0):
            for keys in (_DRIVE, _STRAFE):
                self._add_buttons(keys)
            self._joints = gui.add_button_group("joint", ("1",), visible=False)
            self._follow_clicks(self._joints, str)
            self._arm = self._add_buttons({"joint up": "u", "joint down": "j"})
        with gui.add_folder("Episode", order=45.0):
            self._add_buttons(_EPISODE)
            self._follow_clicks(gui.add_button("Save episode"), lambda _: "f")
        with gui.add_folder("Keys", order=60.0):
            gui.add_html(make_keys(HELP))
        for key in KEYS:
            if key != "q":
                self._add_hotkey(key)

    def _add_buttons(self, keys: dict[str, str]) -> Any:
        group = self.server.gui.add_button_group("", tuple(keys))
        self._follow_clicks(group, keys.__getitem__)
        return group

    def _add_hotkey(self, key: str) -> None:
        hotkey: Any = _HOTKEYS.get(key, key.upper())
        command = self.server.gui.add_command(f"Key {key.upper()}", hotkey=hotkey)

        @command.on_trigger
        async def _(_: Any) -> None:
            self._ask(key)

    def _follow_clicks(self, button: Any, read: Callable[[Any], Command | str]) -> None:
        """Queue a button's key or command, read from its value."""

        @button.on_click
        async def _(event: Any) -> None:
            self._ask(read(event.target.value))

    def _ask(self, asked: Command | str) -> None:
        """Queue a client's key or command unless many are waiting; the event loop preserves their order."""
        if self._waiting.qsize() < MOST_WAITING:
            self._waiting.put(asked)

    def _enter_room(self) -> None:
        """Build what depends on the room: joints, meta-actions, the best known return."""
        episode = self.episode
        joints = episode.instance.robot.joints
        self.controls = Controls(episode.instance.robot.actions, len(episode.option_names))
        self._joints.visible = joints > 1
        if joints > 1:
            self._joints.options = tuple(str(n + 1) for n in range(joints))
        self._arm.visible = joints > 0
        for old in self._meta:
            old.remove()
        self._meta = []
        first = episode.primitive_count
        names = episode.option_names
        with self._meta_folder:
            for begin in range(0, len(names), 2):
                row = names[begin : begin + 2]
                group = self.server.gui.add_button_group("", row)
                self._follow_clicks(group, lambda name: Command("act", first + names.index(str(name))))
                self._meta.append(group)
        episode.on_step = self._show_step
        self._show_facts()
        threading.Thread(target=self._find_best, daemon=True).start()

    def _find_best(self) -> None:
        self.page.find_best()
        self._show_facts()

    def _show_facts(self) -> None:
        episode = self.episode
        # The best known return reveals how far apart the buttons of the hidden order are.
        best = self.page.best if episode.discovery is None or episode.is_over else None
        steps = len(episode.steps)
        facts = (("primitives", str(steps)), ("return", f"{episode.total:g}"),
                 ("best known", "\N{HORIZONTAL ELLIPSIS}" if best is None else f"{best:g}"),
                 ("moves", str(len(episode.moves))))
        self._facts.content = make_facts(facts, f"{name_room(episode.instance)}: {self._note}", steps=steps,
                                         state=episode.end.value, waiting=self._waiting.qsize(),
                                         room=episode.instance.id)

    # --- playing ---------------------------------------------------------------------------------

    def run(self) -> None:
        """Execute keys until the command `quit`."""
        while self.handle(self._waiting.get()):
            pass

    def replay(self, saved: SavedEpisode) -> None:
        """Replay a saved episode as soon as a client is connected. Each of its moves can be undone."""
        while not self.server.get_clients():
            time.sleep(0.1)
        self._note = "Replaying"
        self.episode.replay(saved)
        self._note = f"Replayed {len(saved.primitives)} primitives: Z undoes the last move"
        self._show_facts()

    def put(self, key: str | Command) -> None:
        """Queue a key as if a client had pressed it; safe from any thread."""
        self._waiting.put(key)

    def handle(self, asked: Command | str) -> bool:
        """Execute one key; return False after the command `quit`."""
        command = self.controls.press(asked) if isinstance(asked, str) else asked
        if command is None:
            return True
        if command.verb == "act":
            self._note = self.episode.names[command.action]
        elif command.verb == "next":
            self._note = "Making the next room"
        self._show_facts()
        room, was_over = self.episode.instance.id, self.episode.is_over
        try:
            self._note = carry_out(command, self.episode, self._folder, self.page.best)
        except EscapeError as error:
            self._note = str(error)
        if self.episode.instance.id != room:
            self.page.enter(self.episode.instance, self.episode.state, self.episode.discovery)
            self._enter_room()
        if command.verb in ("undo", "reset", "next"):
            self.page.show(self.episode.state)
            self.page.scene.draw_trail(self.episode.states)
        self._show_facts()
        if command.verb == "act" and was_over != self.episode.is_over and self.episode.end is EpisodeEnd.ESCAPED:
            self.page.celebrate(lambda: self._waiting.qsize() > 0)
        return command.verb != "quit"

    def _show_step(self, step: PrimitiveStep) -> None:
        """Show a primitive while it runs, faster while keys are waiting."""
        waiting = self._waiting.qsize()
        self.page.move(step.after, self._stride / (1 + waiting))
        self.page.scene.draw_trail(self.episode.states)
        self._show_facts()
