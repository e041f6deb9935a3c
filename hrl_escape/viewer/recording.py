"""Episodes as one HTML file that plays offline: the viewer's scene, its client and the puzzle's graph in a page.

The scene is recorded by viser's own serialiser and needs no server and no network to play. The
box with the numbers follows the player's slider; should a later client hide that, the scene
plays all the same. Pictures (GIF, MP4) are made by `env.bullet_cameras`.
"""

from __future__ import annotations

import dataclasses
import json
from html import escape
from pathlib import Path
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.files import write_text
from hrl_escape.viewer.panels import make_graph
from hrl_escape.viewer.poses import blend, make_pose
from hrl_escape.viewer.scene import RoomScene
from hrl_escape.viewer.server import open_server

__all__ = ["Recording", "make_page", "save_page"]

STRIDE = 0.2
"""Time of one primitive, s."""
FRAMES = 5
"""Poses a primitive."""
HOLD = 2.0
"""Time that the end stands still before it plays again, s."""
LONGEST = 2_000
"""Primitives beyond which poses in between are left out, so that pages stay small."""

_OVERLAY = """<style>
#replay{position:fixed;top:14px;left:14px;z-index:5;width:270px;padding:12px 14px;border-radius:8px;
background:#fffffff2;box-shadow:0 2px 12px #0002;font:13px/1.45 Inter,system-ui,sans-serif;color:#22262e;
pointer-events:none}
#replay h1{font-size:14px;margin:0 0 6px}#replay b{font-size:18px;font-variant-numeric:tabular-nums;display:block}
#replay .facts{display:flex;gap:14px;margin:4px 0}#replay .facts span{color:#7b818c;font-size:11px}
#replay .now{min-height:1.5em;font-weight:600}
</style><div id="replay"><h1>@TITLE@</h1><div class="facts"><div><span>primitive</span><b id="r-step"></b></div>
<div><span>return</span><b id="r-return"></b></div><div><span>decision</span><b id="r-decision"></b></div></div>
<div class="now" id="r-now"></div><div id="r-graph"></div></div><script>
(() => { const data = @DATA@; let shown = -1;
const get = id => document.getElementById(id);
setInterval(() => { const slider = document.querySelector('[role=slider]'); if (!slider) return;
  const time = parseFloat(slider.getAttribute('aria-valuenow')), last = data.returns.length - 1;
  const step = Math.max(0, Math.min(last, Math.floor(time / data.stride + 0.02)));
  if (step === shown) return; shown = step;
  get('r-step').textContent = step + ' / ' + last; get('r-return').textContent = data.returns[step];
  const of = data.decisions.findIndex(d => step <= d[1]); const at = of < 0 ? data.decisions.length - 1 : of;
  const decision = data.decisions[at];
  get('r-decision').textContent = decision ? (at + 1) + ' / ' + data.decisions.length : '';
  get('r-now').textContent = step === last ? data.end : decision ? decision[0] : '';
  get('r-graph').innerHTML = data.graphs[data.graph[step]];
  get('replay').dataset.step = step; get('replay').dataset.end = step === last ? data.end : '';
}, 40); })();
</script>"""


@dataclasses.dataclass(frozen=True)
class Recording:
    """An episode to keep.

    Attributes:
        instance: the room.
        states: one more than rewards.
        rewards: one a primitive.
        decisions: name and number of primitives of each, in order.
        end: how it ended, in words.
        who: who drove.
    """

    instance: RoomInstance
    states: tuple[RoomState, ...]
    rewards: tuple[float, ...]
    decisions: tuple[tuple[str, int], ...]
    end: str
    who: str


def save_page(path: str | Path, recording: Recording) -> None:
    """Write `make_page`'s page, atomically.

    Raises:
        FileWriteError: the file could not be written.
    """
    write_text(path, make_page(recording))


def make_page(recording: Recording) -> str:
    """One HTML document that holds everything and plays without a network."""
    server = open_server(port=0)
    try:
        scene = RoomScene(server, recording.instance)
        scene.show(recording.states[0])
        scene.draw_trail([])
        serializer = server.get_scene_serializer()
        frames = FRAMES if len(recording.rewards) <= LONGEST else 1
        poses = [make_pose(scene.rules, state) for state in recording.states]
        for number, (before, after) in enumerate(zip(poses, poses[1:], strict=False), 1):
            for frame in range(1, frames):
                serializer.insert_sleep(STRIDE / frames)
                scene.pose(blend(before, after, frame / frames))
            serializer.insert_sleep(STRIDE / frames)
            scene.show(recording.states[number])
            scene.draw_trail(recording.states[: number + 1])
        serializer.insert_sleep(HOLD)
        page = serializer.as_html()
    finally:
        server.stop()
    return page.replace("</body>", _make_overlay(recording) + "</body>", 1)


def _make_overlay(recording: Recording) -> str:
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
    data: dict[str, Any] = {
        "stride": STRIDE, "returns": [f"{value:g}" for value in returns], "decisions": decisions,
        "graphs": list(graphs), "graph": chosen, "end": recording.end,
    }
    title = f"{instance.name}, room {instance.seed}: {recording.who}" if instance.seed is not None else (
        f"{instance.name}: {recording.who}")
    text = json.dumps(data).replace("</", "<\\/")
    return _OVERLAY.replace("@TITLE@", escape(title)).replace("@DATA@", text)
