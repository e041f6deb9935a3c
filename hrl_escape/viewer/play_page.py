"""Manual mode in the browser: keys and buttons drive an `Episode` that a `RoomPage` shows.

Clients only put keys into a queue; one thread takes them out and does what they ask. So a
client that vanishes leaves nothing behind but the moves it made.
"""

from __future__ import annotations

import queue
import threading
import time
from pathlib import Path
from typing import Any

from hrl_escape.errors import EscapeError, PlanningFailed
from hrl_escape.options.best_known import best_known_return
from hrl_escape.viewer.controls import HELP, KEYS, Command, Controls
from hrl_escape.viewer.episode import Episode, Move, SavedEpisode, save_episode
from hrl_escape.viewer.panels import make_facts, make_keys
from hrl_escape.viewer.room_page import RoomPage
from hrl_escape.viewer.server import Server
from hrl_escape.viewer.tap import Step

__all__ = ["PlayPage"]

STRIDE = 0.18
"""Time that one primitive takes on the screen, s; less while keys are waiting."""
MOST_WAITING = 30
_HOTKEYS = {"up": "arrowup", "down": "arrowdown", "left": "arrowleft", "right": "arrowright"}
_DRIVE = {"\N{ANTICLOCKWISE OPEN CIRCLE ARROW} turn": "left", "\N{BLACK UP-POINTING TRIANGLE} ahead": "w",
          "turn \N{CLOCKWISE OPEN CIRCLE ARROW}": "right"}
_STRAFE = {"\N{BLACK LEFT-POINTING TRIANGLE} left": "a", "\N{BLACK DOWN-POINTING TRIANGLE} back": "s",
           "right \N{BLACK RIGHT-POINTING TRIANGLE}": "d"}
_EPISODE = {"Undo": "z", "Again": "r", "Next room": "n"}


class PlayPage:
    """An episode to play, on a server.

    Args:
        server: where it is shown.
        episode: what is played.
        folder: where episodes are saved.
        stride: time that one primitive takes on the screen, s.
    """

    def __init__(self, server: Server, episode: Episode, folder: Path = Path("episodes"),
                 stride: float = STRIDE) -> None:
        self.server, self.episode = server, episode
        self._folder, self._stride = folder, stride
        self._waiting: queue.Queue[Command | str] = queue.Queue()
        self._best: dict[str, float] = {}
        self._note = "Press the buttons in the order of the graph, then drive into the exit"
        self.page = RoomPage(server, episode.instance, episode.state, owns_keys=True)
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
                self._add_buttons("", keys)
            self._joints = gui.add_button_group("joint", ("1",), visible=False)
            self._joints.on_click(lambda event: self._waiting.put(str(event.target.value)))
            self._arm = self._add_buttons("", {"joint up": "u", "joint down": "j"})
        with gui.add_folder("Episode", order=45.0):
            self._add_buttons("", _EPISODE)
            gui.add_button("Save episode").on_click(lambda _: self._waiting.put(Command("save")))
        with gui.add_folder("Keys", order=60.0):
            gui.add_html(make_keys(HELP))
        for key in KEYS:
            if key != "q":
                self._add_hotkey(key)

    def _add_buttons(self, label: str, keys: dict[str, str]) -> Any:
        group = self.server.gui.add_button_group(label, tuple(keys))
        group.on_click(lambda event: self._waiting.put(keys[event.target.value]))
        return group

    def _add_hotkey(self, key: str) -> None:
        hotkey: Any = _HOTKEYS.get(key, key.upper())
        command = self.server.gui.add_command(f"Key {key.upper()}", hotkey=hotkey)

        @command.on_trigger
        async def _(_: Any) -> None:  # on the event loop, so that keys keep their order
            if self._waiting.qsize() < MOST_WAITING:
                self._waiting.put(key)

    def _enter_room(self) -> None:
        """What depends on the room: joints, meta-actions, the best return known."""
        episode = self.episode
        joints = episode.instance.robot.joints
        self.controls = Controls(joints, len(episode.option_names))
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
            for begin in range(0, len(names), 4):
                row = names[begin : begin + 4]
                group = self.server.gui.add_button_group("", row)
                group.on_click(lambda event: self._waiting.put(
                    Command("act", first + self.episode.option_names.index(str(event.target.value)))))
                self._meta.append(group)
        episode.on_step = self._show_step
        self._show_facts()
        threading.Thread(target=self._find_best, args=(episode.instance,), daemon=True).start()

    def _find_best(self, instance: Any) -> None:
        try:
            self._best[instance.id] = best_known_return(instance)
        except (PlanningFailed, EscapeError):
            return
        self._show_facts()

    def _show_facts(self) -> None:
        episode = self.episode
        best = self._best.get(episode.instance.id)
        steps = len(episode.steps)
        facts = (("primitives", str(steps)), ("return", f"{episode.total:g}"),
                 ("best known", "\N{HORIZONTAL ELLIPSIS}" if best is None else f"{best:g}"),
                 ("moves", str(len(episode.moves))))
        state = "escaped" if episode.escaped else "over" if episode.is_over else "inside"
        room = f"{episode.instance.name}, room {episode.instance.seed}: "
        self._facts.content = make_facts(facts, room + self._note, steps=steps, state=state,
                                         waiting=self._waiting.qsize(), room=episode.instance.id)

    # --- playing ---------------------------------------------------------------------------------

    def run(self) -> None:
        """Take keys until the command `quit` comes."""
        while self.handle(self._waiting.get()):
            pass

    def replay(self, saved: SavedEpisode) -> None:
        """Show what a file says, once somebody is looking; what was shown can be undone move by move.

        Raises:
            EpisodeFileError: it does not play out as the file says.
        """
        while not self.server.get_clients():
            time.sleep(0.1)
        self._note = "replay"
        self.episode.replay(saved)
        self._note = f"Replayed {len(saved.primitives)} primitives: Z goes back through them"
        self._show_facts()

    def put(self, key: str | Command) -> None:
        """Act as if a client had pressed a key; safe from any thread."""
        self._waiting.put(key)

    def handle(self, asked: Command | str) -> bool:
        """Do what one key asks for; False once it is to quit."""
        command = self.controls.press(asked) if isinstance(asked, str) else asked
        if command is None:
            return True
        try:
            getattr(self, f"_do_{command.verb}")(command)
        except EscapeError as error:
            self._note = str(error)
        self._show_facts()
        return command.verb != "quit"

    def _do_act(self, command: Command) -> None:
        if self.episode.is_over:
            self._note = "This episode is over: R starts again, Z takes the last move back, N enters the next room"
            return
        name = self.episode.names[command.action]
        self._note = name
        move = self.episode.do(command.action)
        if move is None:
            self._note = f"{name} cannot start here"
            return
        self._note = self._describe(move)

    def _describe(self, move: Move) -> str:
        episode = self.episode
        pressed = [episode.instance.targets[i].name for step in move.steps for i in step.pressed]
        if episode.escaped:
            best = self._best.get(episode.instance.id)
            beaten = " \N{EM DASH} the best known!" if best is not None and episode.total >= best - 1e-9 else ""
            return f"Escaped with a return of {episode.total:g}{beaten}"
        if episode.is_over:
            return "Out of time"
        if move.ended == "planning-failed":
            return f"{move.name}: {move.reason}"
        words = f"{move.name} ({len(move.steps)} primitives)" if len(move.steps) > 1 else move.name
        return words + (f", pressed {', '.join(pressed)}" if pressed else "")

    def _do_undo(self, _: Command) -> None:
        move = self.episode.undo()
        self._note = "There is nothing to undo" if move is None else f"{move.name} taken back"
        self._show_state()

    def _do_reset(self, _: Command) -> None:
        self.episode.reset()
        self._note = "Started again"
        self._show_state()

    def _do_next(self, _: Command) -> None:
        self._note = "Making the next room"
        self._show_facts()
        self.episode.go_on()
        self._note = "a new room"
        self.page.enter(self.episode.instance, self.episode.state)
        self._enter_room()
        self._show_state()

    def _do_save(self, _: Command) -> None:
        saved = self.episode.to_saved()
        name = f"{saved.instance.name}-{saved.instance.seed}-{len(saved.primitives)}-primitives.json"
        save_episode(self._folder / name, saved)
        self._note = f"Saved as {self._folder / name}"

    def _do_note(self, command: Command) -> None:
        self._note = command.note

    def _do_quit(self, _: Command) -> None:
        self._note = "The game is over; close this page"

    def _show_step(self, step: Step) -> None:
        """Show a primitive while it happens; hurry while keys wait."""
        waiting = self._waiting.qsize()
        self.page.move(step.after, self._stride / (1 + waiting))
        self.page.scene.draw_trail(self.episode.states)
        self._show_facts()

    def _show_state(self) -> None:
        self.page.show(self.episode.state)
        self.page.scene.draw_trail(self.episode.states)
