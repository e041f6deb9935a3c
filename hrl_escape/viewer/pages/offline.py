"""Episodes and trajectories as one HTML page each, which plays in 3-D without a server or a network.

viser's serialiser records the scene. The page of an episode adds the puzzle's graph and a box of numbers that follows
the slider of the player; if a later viser client hides it, the scene still plays. The page of a trajectory shows motion
at its true speed, with panels and exit as in its initial state.

Pages are passed on to others and contain names and numbers from rooms, agents and saved episodes. These are escaped.
Scripts run only if the page's content security policy has their hash, and the policy allows no network access. viser's
client unpacks itself and adds a script of its own. That script has a nonce, a hash of the whole page, which the content
of the page cannot predict. The client also compiles text to functions (for its WebAssembly), which the policy has to
allow.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import escape

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, RoomState, Rules
from hrl_escape.env.pictures.model import RoomPose
from hrl_escape.errors import ConfigError, EscapeError
from hrl_escape.files import write_text
from hrl_escape.planning.best_known import best_known_return
from hrl_escape.planning.motion.trajectory import TimedTrajectory
from hrl_escape.templates import embed_json, render_template
from hrl_escape.viewer.pages.panels import make_graph
from hrl_escape.viewer.pages.room import name_room
from hrl_escape.viewer.play.commands import praise
from hrl_escape.viewer.recording import EpisodeRecording
from hrl_escape.viewer.scene import RoomScene, blend, compute_overview
from hrl_escape.viewer.server import Server, open_server

PAUSE = 2.0
"""Pause at the end before a page plays again, s."""
SCRIPT = re.compile(r"""<script\b(?:"[^"]*"|'[^']*'|[^"'>])*>(.*?)</script\s*>""", re.DOTALL | re.IGNORECASE)
UNPACKED = 'e=document.createElement("script");e.type="module";'
"""Code of viser's client that adds its script."""


@contextmanager
def _open_scene(instance: RoomInstance) -> Iterator[tuple[Server, RoomScene]]:
    """Open a room on its own server while it is recorded."""
    server = open_server(port=0)
    try:
        yield server, RoomScene(server, instance)
    finally:
        server.stop()


def _finish(page: str, title: str) -> str:
    """The page with its title, and with a content security policy as the first element of its head."""
    page = page.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    nonce = _hash(page)
    page = page.replace(UNPACKED, f'{UNPACKED}e.nonce="{nonce}";', 1)
    hashes = sorted({f"'sha256-{_hash(script)}'" for script in SCRIPT.findall(page)})
    policy = (f"default-src 'none'; script-src 'nonce-{nonce}' {' '.join(hashes)} 'wasm-unsafe-eval' 'unsafe-eval'; "
              "worker-src blob: data:; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
              "connect-src data: blob:; base-uri 'none'; form-action 'none'")
    return page.replace("<head>", f'<head><meta http-equiv="Content-Security-Policy" content="{policy}">', 1)


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


# --- episodes ----------------------------------------------------------------------------

REPLAY_STRIDE = 0.2
"""Duration of one primitive, s."""
FRAMES = 5
"""Frames per primitive."""
CONFETTI = 24
"""Frames of the confetti after an escape."""
PHONE = 0.55
"""Width over height of the view of the room on upright screens."""
LONGEST = 2_000
"""Number of primitives above which each has only one frame, which keeps pages small."""


def save_replay(path: str | Path, recording: EpisodeRecording) -> None:
    """Write the page of a recording atomically."""
    write_text(path, make_replay(recording))


def make_replay(recording: EpisodeRecording) -> str:
    """Return one HTML document that plays a recording without a network."""
    with _open_scene(recording.instance) as (server, scene):
        overview, upright = (compute_overview(recording.instance, aspect) for aspect in (1.6, PHONE))
        poses = [scene.model.make_pose(state) for state in recording.states]
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
            serializer.insert_sleep(PAUSE / flying / 2)
        scene.draw_confetti(1.0)
        serializer.insert_sleep(PAUSE / 2)
        page = serializer.as_html()
    title = f"{name_room(recording.instance)}: {recording.driver}"
    title = title.encode("utf-8", "replace").decode()  # text from JSON may contain half characters
    data = embed_json(_collect(recording))
    overlay = render_template("hrl_escape.viewer.pages", "replay.html", title=title, data=data)
    head = "<script>" + UPRIGHT.replace("CAMERA", _write_camera(*upright)) + "</script>"
    return _finish(page.replace("<head>", f"<head>{head}", 1).replace("</body>", overlay + "</body>", 1), title)


UPRIGHT = ("(() => { if (innerWidth >= innerHeight) return; const camera = CAMERA, get = URLSearchParams.prototype.get;"
           "URLSearchParams.prototype.get = function(name) { return camera[name] ?? get.call(this, name); }; })();")
"""Script that gives viser's client, which reads its address, the camera for upright screens."""


def _write_camera(position: tuple[float, ...], target: tuple[float, ...]) -> str:
    """Camera in the JSON form that viser's client reads from an address."""
    write = lambda place: ",".join(f"{value:.3f}" for value in place)  # noqa: E731
    return json.dumps({"initialCameraPosition": write(position), "initialCameraLookAt": write(target)})


def _describe_end(recording: EpisodeRecording) -> str:
    """Text about the end of the episode; for an escape also its distance from the best known one."""
    if recording.end is not EpisodeEnd.ESCAPED:
        return recording.end.words
    try:
        best = best_known_return(recording.instance)
    except EscapeError:
        best = None
    return praise(sum(recording.rewards), best)


def _collect(recording: EpisodeRecording) -> dict[str, Any]:
    """Numbers and graphs for the page's box."""
    graphs: dict[str, int] = {}
    chosen = [graphs.setdefault(make_graph(recording.instance.puzzle, state.puzzle, 242), len(graphs))
              for state in recording.states]
    names, counts = ([decision[part] for decision in recording.decisions] for part in (0, 1))
    return {
        "stride": REPLAY_STRIDE, "returns": [f"{value:g}" for value in accumulate(recording.rewards, initial=0.0)],
        "decisions": list(zip(names, accumulate(counts), strict=True)), "graphs": list(graphs), "graph": chosen,
        "end": recording.end.words, "words": _describe_end(recording),
    }


# --- trajectories ------------------------------------------------------------------------

FRAME_RATE = 30.0
"""Most frames of a saved page per second of the motion."""
MOST_SAMPLES = 12_000
"""Number of frames above which there are fewer per second, which keeps pages small."""


def save_motion(path: str | Path, trajectory: TimedTrajectory, instance: RoomInstance, state: RoomState | None = None
                ) -> None:
    """Write the page of a trajectory atomically; see `make_motion`."""
    write_text(path, make_motion(trajectory, instance, state))


def make_motion(trajectory: TimedTrajectory, instance: RoomInstance, state: RoomState | None = None) -> str:
    """Return one HTML document that plays a trajectory of the base, the arm, or both without a network.

    `state` sets everything that the trajectory does not move, and the lights; by default the room's first start.

    Raises:
        ConfigError: the trajectory moves joints that the room's robot lacks.
        MissingExtraError: the extra `viewer` is not installed.
    """
    with _open_scene(instance) as (server, scene):
        state = scene.rules.make_state(instance.starts[0]) if state is None else state
        times, positions, _ = trajectory.sample(min(FRAME_RATE, MOST_SAMPLES / trajectory.duration))
        still = scene.model.make_pose(state)
        poses = [_move(still, trajectory.names, row, scene.rules) for row in positions.tolist()]
        scene.show(state)
        scene.pose(poses[0])
        scene.draw_path([(pose.x, pose.y) for pose in poses])
        if instance.robot.joints:
            scene.draw_hand_path([_place_hand(pose, scene.rules) for pose in poses])
        serializer = server.get_scene_serializer()
        for seconds, pose in zip(np.diff(times).tolist(), poses[1:], strict=True):
            serializer.insert_sleep(seconds)
            scene.pose(pose)
        serializer.insert_sleep(PAUSE)
        page = serializer.as_html()
    return _finish(page, f"{instance.name}: {trajectory.duration:.1f} s")


def _move(still: RoomPose, names: tuple[str, ...], row: list[float], rules: Rules) -> RoomPose:
    """Pose with the coordinates of a trajectory instead of its own."""
    own = {"x": still.x, "y": still.y, "heading": still.heading,
           **dict(zip(rules.robot.joint_names, still.angles, strict=True))}
    strangers = [name for name in names if name not in own]
    if strangers:
        raise ConfigError("trajectory.names", strangers, f"coordinates of this room's robot: {', '.join(own)}")
    own |= zip(names, row, strict=True)
    angles = tuple(own[name] for name in rules.robot.joint_names)
    return still._replace(x=own["x"], y=own["y"], heading=own["heading"], angles=angles)


def _place_hand(pose: RoomPose, rules: Rules) -> tuple[float, float, float]:
    """Position of the hand in the room frame, m."""
    ahead, left, up = rules.robot.compute_hand(pose.angles).tolist()
    cos, sin = math.cos(pose.heading), math.sin(pose.heading)
    return pose.x + cos * ahead - sin * left, pose.y + sin * ahead + cos * left, pose.z + up
