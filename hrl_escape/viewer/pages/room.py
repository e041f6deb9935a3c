"""The page that all modes share: the room in smooth 3-D, its puzzle's graph, and cameras.

`RoomPage` shows states, and each client chooses a camera. `play.py` and `watch.py` decide which states are shown.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.pictures.model import RoomPose
from hrl_escape.errors import EscapeError
from hrl_escape.planning.best_known import best_known_return
from hrl_escape.viewer.extra import viser
from hrl_escape.viewer.pages.panels import WIDTH, KnownEdges, make_graph, make_pair
from hrl_escape.viewer.play.episode import PressEvidence
from hrl_escape.viewer.scene import OVERVIEW_FIELD, RoomScene, blend, compute_overview
from hrl_escape.viewer.server import Server

VIEWS = ("orbit", "follow", "robot's eye")
FRAME_SECONDS = 1 / 30
CONFETTI_FRAMES = 50
_Point = tuple[float, float, float]
_OWN_KEYS = ("<img alt='' style='display:none' src='data:,' onerror=\"if(!window.hrlKeys){window.hrlKeys=1;"
             "document.documentElement.addEventListener('keydown',e=>e.stopPropagation())}\">")
"""Prevents keys that drive the robot from moving viser's camera, which listens one element further out."""


class RoomPage:
    """Page that shows a room to any number of clients.

    If it `owns_keys`, keys control the page, and viser's camera ignores them. With `discovery`, the graph is shown as
    far as presses have revealed it. If an escape `reveals` the graph, it is then shown completely.

    Attributes:
        scene: scene of the current room.
        best: best known return of this room, or None before it is found.
    """

    def __init__(self, server: Server, instance: RoomInstance, state: RoomState, owns_keys: bool = False,
                 discovery: PressEvidence | None = None, reveals: bool = True) -> None:
        self.server, self._discovery, self._reveals = server, discovery, reveals
        self.best: float | None = None
        self._lock = threading.Lock()
        self._cameras: dict[int, str] = {}
        self.scene = RoomScene(server, instance, discovery is not None)
        server.set_title(name_room(instance))
        gui = server.gui
        if owns_keys:
            gui.add_html(_OWN_KEYS)
        self.view_folder = gui.add_folder("View", order=50.0)
        self._graph = gui.add_html("", order=20.0)
        self._belief: tuple[KnownEdges, str] | None = None  # graph that an agent believes in, and its title
        self._shown: tuple[str, object, KnownEdges | None, str, bool] | None = None
        self._pose = self.scene.model.make_pose(state)
        self.show(state)
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._forget)

    def enter(self, instance: RoomInstance, state: RoomState, discovery: PressEvidence | None = None) -> None:
        """Replace the room."""
        self.scene.remove()
        self._discovery, self.best = discovery, None
        self.scene = RoomScene(self.server, instance, discovery is not None)
        self.show(state)
        for client in self.server.get_clients().values():
            self._choose(client, self._cameras.get(client.client_id, VIEWS[0]))

    def hide_graph(self, discovery: PressEvidence | None, state: RoomState) -> None:
        """Hide the graph except the evidence of presses, or show it for None."""
        self._discovery, self.scene.is_hidden = discovery, discovery is not None
        self.show(state)

    def show(self, state: RoomState) -> None:
        """Show a state at once."""
        self._pose = self.scene.model.make_pose(state)
        self.scene.show(state)
        self._draw_graph(state)
        self._aim()
        eyes = [tuple(client.camera.position) for client in self.server.get_clients().values()]
        self.scene.uncover(eyes, self._pose)

    def move(self, state: RoomState, seconds: float, is_cancelled: Callable[[], bool] | None = None) -> None:
        """Move smoothly to a state within `seconds`, then light its panels; if cancelled, show the state at once."""
        begin, end = self._pose, self.scene.model.make_pose(state)
        started = time.monotonic()
        while (past := time.monotonic() - started) < seconds - FRAME_SECONDS / 2:
            if is_cancelled is not None and is_cancelled():
                break
            share = past / seconds
            self._pose = blend(begin, end, share * share * (3 - 2 * share) if seconds > 0.15 else share)
            self.scene.pose(self._pose)
            self._aim()
            time.sleep(min(FRAME_SECONDS, max(seconds - past, 0.0)))
        self.show(state)

    def _draw_graph(self, state: RoomState) -> None:
        puzzle = self.scene.instance.puzzle
        is_shown = self._reveals and self.scene.rules.has_escaped(state)
        is_hidden = self._discovery is not None and not is_shown
        believed, words = self._belief or (None, "")
        if is_hidden and self._discovery is not None:
            believed = KnownEdges(*self._discovery.list_edges())
        key = (self.scene.instance.id, state.puzzle, believed, words, is_hidden)
        if key != self._shown:
            self._shown = key
            if words and believed is not None:
                self._graph.content = make_pair(("the room's graph", make_graph(puzzle, state.puzzle, WIDTH // 2)), (
                    words, make_graph(puzzle, state.puzzle, WIDTH // 2, believed, drawing="learned")))
            else:
                self._graph.content = make_graph(puzzle, state.puzzle, WIDTH, believed, is_hidden)

    def show_belief(self, state: RoomState, believed: KnownEdges, words: str) -> None:
        """Show the graph that an agent believes in, with a title, next to the true one."""
        self._belief = believed, words
        self._draw_graph(state)

    def find_best(self) -> None:
        """Find the best known return of the room, which takes some seconds. `best` stays None if none is known."""
        instance = self.scene.instance
        with contextlib.suppress(EscapeError):
            best = best_known_return(instance)
            if instance is self.scene.instance:
                self.best = best

    def celebrate(self, is_cancelled: Callable[[], bool]) -> None:
        """Show confetti over the exit for a moment."""
        for frame in range(CONFETTI_FRAMES):
            if is_cancelled():
                break
            self.scene.draw_confetti(frame / CONFETTI_FRAMES)
            time.sleep(FRAME_SECONDS)
        self.scene.draw_confetti(1.0)

    # --- cameras -------------------------------------------------------------------------------

    async def _welcome(self, client: viser.ClientHandle) -> None:
        """Add camera buttons for a new client; runs on the event loop, where the client cannot disconnect meanwhile."""
        if client.client_id not in self.server.get_clients():
            return  # its buttons would never be removed
        with self.view_folder:
            choice = client.gui.add_button_group("camera", VIEWS)

        @choice.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._choose(client, choice.value)

        with self._lock:
            self._cameras[client.client_id] = VIEWS[0]
        if _get_aspect(client) < 1.0:
            self._choose(client, VIEWS[0])  # the initial view of the scene is for wide screens

    async def _forget(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._cameras.pop(client.client_id, None)

    def _choose(self, client: viser.ClientHandle, mode: str) -> None:
        with self._lock:
            self._cameras[client.client_id] = mode
        if mode == VIEWS[0]:
            with client.atomic():
                client.camera.up_direction = (0.0, 0.0, 1.0)
                client.camera.fov = math.radians(OVERVIEW_FIELD)
                place, target = compute_overview(self.scene.instance, _get_aspect(client))
                client.camera.position, client.camera.look_at = place, target
        else:
            self._aim()

    def _aim(self) -> None:
        """Move the cameras that follow the robot."""
        with self._lock:
            moving = {number: mode for number, mode in self._cameras.items() if mode != VIEWS[0]}
        if not moving:
            return
        clients = self.server.get_clients()
        for number, mode in moving.items():
            client = clients.get(number)
            if client is not None:
                place, target, fov = self._place_camera(self._pose, mode)
                with client.atomic():
                    client.camera.up_direction = (0.0, 0.0, 1.0)
                    client.camera.fov = math.radians(fov)
                    client.camera.position, client.camera.look_at = place, target

    def _place_camera(self, pose: RoomPose, mode: str) -> tuple[_Point, _Point, float]:
        """Position and target (m), and field of view (degrees), of a camera."""
        robot = self.scene.instance.robot
        cos, sin = math.cos(pose.heading), math.sin(pose.heading)
        if mode == "follow":
            back, high = 3.5 + 3.0 * robot.outer_radius, 2.4 + 1.6 * robot.body_height
            ahead = 2.0 + robot.outer_radius
            return ((pose.x - back * cos, pose.y - back * sin, pose.z + high),
                    (pose.x + ahead * cos, pose.y + ahead * sin, pose.z + 0.4), 60.0)
        behind, eye = -0.3 * robot.inner_radius, pose.z + robot.body_height + 0.35  # on a mast, over the arm
        return ((pose.x + behind * cos, pose.y + behind * sin, eye),
                (pose.x + (behind + 2) * cos, pose.y + (behind + 2) * sin, eye - 0.25), 75.0)


def name_room(instance: RoomInstance) -> str:
    """Return the name of a room, its configuration and seed, in the grammar of the command line."""
    return instance.name if instance.seed is None else f"{instance.name}, seed {instance.seed}"


def _get_aspect(client: viser.ClientHandle) -> float:
    """Width of a client's picture over its height."""
    return client.camera.image_width / client.camera.image_height
