"""Cards of data sets: origin, size, scores with references, and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.data.catalogue import RECORDING_KINDS, DataSpec
from hrl_escape.data.materialise import begin_episode, list_episodes
from hrl_escape.data.published import PublishedRecording
from hrl_escape.data.recording import Recording
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.maps import Trajectory, draw_room
from hrl_escape.env.pictures.meshes import compute_extent
from hrl_escape.figures import STYLE, save_figure
from hrl_escape.step_info import ENDINGS

DRAWN = 4
"""Number of episodes in the picture."""
REFERENCE_WORDS = ("chance and best_known are mean returns in the first test rooms (reference_rooms): of random legal "
                   "options, and of the best known escapes")


def describe(recording: Recording) -> dict[str, Any]:
    """Return the card as JSON values."""
    about, durations = recording.about, recording.duration
    counts = np.bincount(recording.ended, minlength=len(ENDINGS))
    return {
        "name": about["name"],
        "behaviour": RECORDING_KINDS.get(about["kind"], about["kind"]),
        "rooms": about["rooms"],
        "actions": ", ".join(about["actions"]),
        "primitives": len(recording.action),
        "decisions": len(recording.option),
        "episodes": len(recording.room),
        "duration": f"{durations.mean():.1f} primitives per decision, at most {durations.max()}",
        "endings": {name: int(count) for name, count in zip(ENDINGS, counts, strict=True) if count},
        "scores": {name: round(value, 3) for name, value in about["scores"].items()},
        "references": REFERENCE_WORDS,
        "engine": f"{about['engine']}, {about['dynamics']}, recorded with hrl_escape {about['package']}",
        "made_by": about["command"],
        "content": recording.content,
        "digest": recording.digest,
    }


def describe_unrecorded(spec: DataSpec, published: PublishedRecording) -> dict[str, Any]:
    """Return the card of a published recording without its file, as JSON values; unknown values are None."""
    return {
        "name": spec.name,
        "behaviour": RECORDING_KINDS[spec.kind],
        "rooms": spec.list_rooms(spec.primitives),
        "actions": None,
        **{name: getattr(published, name) for name in ("primitives", "decisions", "episodes")},
        "duration": None,
        "endings": None,
        "scores": dict(published.scores),
        "references": REFERENCE_WORDS,
        "engine": None,
        "made_by": f"hrl-escape data make {spec.name}",
        "content": published.content,
        "digest": None,
    }


def draw_card(recording: Recording) -> Figure:
    """Draw paths of the first episodes in the first room, and the durations of all decisions."""
    room = recording.rooms[int(recording.room[0])]
    numbers = np.flatnonzero(recording.room == recording.room[0])[:DRAWN]
    paths = [_replay(recording, int(number)) for number in numbers]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 4.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes, bars = figure.subplots(1, 2, width_ratios=(1.15, 1))
        x_min, x_max, y_min, y_max = compute_extent(room)
        axes.set(xlim=(x_min - 2, x_max + 2), ylim=(y_min - 2, y_max + 2), aspect="equal")
        axes.set_axis_off()
        draw_room(axes, room, paths[0][0], [
            Trajectory(np.array([(state.x, state.y) for state in path]), f"episode {n + 1}")
            for n, path in enumerate(paths)])
        figure.suptitle(f"{recording.about['name']}: {len(paths)} episodes in the first room; all decisions",
                        fontsize=10)
        edges = np.arange(0.5, float(np.quantile(recording.duration, 0.99)) + 1.5)
        bars.hist(np.minimum(recording.duration, edges[-1] - 0.5), bins=edges, color=palette.LINES[0])  # type: ignore[arg-type]
        bars.set(xlabel="primitives of a decision (the longest 1 % in the last bar)", ylabel="decisions")
        for side in ("top", "right"):
            bars.spines[side].set_visible(False)
    return figure


def save_card(path: str | Path, recording: Recording) -> None:
    """Write the picture, reproducibly."""
    save_figure(path, draw_card(recording))


def _replay(recording: Recording, number: int) -> list[RoomState]:
    """Return the states of an episode."""
    rules = Kinematics(recording.rooms[int(recording.room[number])])
    states = [begin_episode(rules, recording, number)]
    for action in recording.action[list_episodes(recording)[number].primitives].tolist():
        states.append(rules.step(states[-1], action).state)
    return states
