"""A recorded episode as one HTML page that plays offline: 3D scene, player and the puzzle's graph.

viser's own serialiser records the scene; playing it needs no server and no network. The box of
numbers follows the player's slider. If a later viser client hides the slider, the scene still
plays. Animations (GIF, MP4) are made elsewhere, by the engine's cameras.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from markupsafe import escape

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.errors import EscapeError
from hrl_escape.files import write_text
from hrl_escape.planning.best_known import best_known_return
from hrl_escape.templates import embed_json, render_template
from hrl_escape.viewer.pages.panels import make_graph
from hrl_escape.viewer.pages.policy import add_policy
from hrl_escape.viewer.pages.room import name_room
from hrl_escape.viewer.play.commands import praise
from hrl_escape.viewer.recording import Recording
from hrl_escape.viewer.scene.room_scene import RoomScene, blend, compute_overview, make_pose
from hrl_escape.viewer.server import open_server

REPLAY_STRIDE = 0.2
"""Duration of one primitive, s."""
FRAMES = 5
"""Frames of one primitive."""
HOLD = 2.0
"""Pause at the end before the page plays again, s."""
CONFETTI = 24
"""Frames of the confetti after an escape."""
PHONE = 0.55
"""Width over height of what upright screens show of the room."""
LONGEST = 2_000
"""Number of primitives above which each gets one frame only, so that pages stay small."""


def save_replay(path: str | Path, recording: Recording) -> None:
    """Write the page of a recording, atomically.

    Raises:
        FileWriteError: the file could not be written.
    """
    write_text(path, make_replay(recording))


def make_replay(recording: Recording) -> str:
    """One HTML document that plays a recording without a network."""
    server = open_server(port=0)
    try:
        scene = RoomScene(server, recording.instance)
        overview, upright = (compute_overview(recording.instance, aspect) for aspect in (1.6, PHONE))
        poses = [make_pose(scene.rules, state) for state in recording.states]
        scene.show(recording.states[0])
        scene.uncover([overview[0]], poses[0])
        scene.draw_trail([])
        scene.draw_confetti(1.0)
        serializer = server.get_scene_serializer()
        frames = FRAMES if len(recording.rewards) <= LONGEST else 1
        for number, (before, after) in enumerate(zip(poses, poses[1:], strict=False), 1):
            for frame in range(1, frames):
                serializer.insert_sleep(REPLAY_STRIDE / frames)
                scene.pose(blend(before, after, frame / frames))
            serializer.insert_sleep(REPLAY_STRIDE / frames)
            scene.show(recording.states[number])
            scene.uncover([overview[0]], after)
            scene.draw_trail(recording.states[: number + 1])
        flying = CONFETTI if recording.end is EpisodeEnd.ESCAPED else 0
        for frame in range(flying):
            scene.draw_confetti(frame / flying)
            serializer.insert_sleep(HOLD / flying / 2)
        scene.draw_confetti(1.0)
        serializer.insert_sleep(HOLD / 2)
        page = serializer.as_html()
    finally:
        server.stop()
    title = _make_title(recording)
    page = page.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    data = embed_json(_collect(recording))
    overlay = render_template("hrl_escape.viewer.pages", "replay.html", title=title, data=data)
    head = "<script>" + UPRIGHT.replace("CAMERA", _write_camera(*upright)) + "</script>"
    return add_policy(page.replace("<head>", f"<head>{head}", 1).replace("</body>", overlay + "</body>", 1))


UPRIGHT = ("(() => { if (innerWidth >= innerHeight) return; const camera = CAMERA, get = URLSearchParams.prototype.get;"
           "URLSearchParams.prototype.get = function(name) { return camera[name] ?? get.call(this, name); }; })();")
"""Script that hands viser's client, which reads its address, the camera of upright screens."""


def _write_camera(position: tuple[float, ...], target: tuple[float, ...]) -> str:
    """Camera as viser's client reads it from an address, in JSON."""
    write = lambda place: ",".join(f"{value:.3f}" for value in place)  # noqa: E731
    return json.dumps({"initialCameraPosition": write(position), "initialCameraLookAt": write(target)})


def _describe_end(recording: Recording) -> str:
    """Words on how the episode ended; of an escape also how far it is from the best known one."""
    if recording.end is not EpisodeEnd.ESCAPED:
        return recording.end.words
    try:
        best = best_known_return(recording.instance)
    except EscapeError:
        best = None
    return praise(sum(recording.rewards), best)


def _make_title(recording: Recording) -> str:
    title = f"{name_room(recording.instance)}: {recording.driver}"
    return title.encode("utf-8", "replace").decode()  # JSON has half characters too


def _collect(recording: Recording) -> dict[str, Any]:
    """The numbers and graphs that the page's box shows."""
    instance = recording.instance
    graphs: dict[str, int] = {}
    chosen = [graphs.setdefault(make_graph(instance.puzzle, state.puzzle, 242), len(graphs))
              for state in recording.states]
    returns = [0.0]
    for reward in recording.rewards:
        returns.append(returns[-1] + reward)
    decisions: list[tuple[str, int]] = []
    for name, count in recording.decisions:
        decisions.append((name, count + (decisions[-1][1] if decisions else 0)))
    return {
        "stride": REPLAY_STRIDE, "returns": [f"{value:g}" for value in returns], "decisions": decisions,
        "graphs": list(graphs), "graph": chosen, "end": recording.end.words, "words": _describe_end(recording),
    }
