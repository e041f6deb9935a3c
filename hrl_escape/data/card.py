"""Cards of data sets: what one is, how it was made, its scores beside their references, and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hrl_escape.data.catalogue import TAPE_KINDS, DataSpec
from hrl_escape.data.materialise import begin_episode, list_episodes
from hrl_escape.data.published import PublishedTape
from hrl_escape.data.tape import Tape
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.maps import Trajectory, draw_room
from hrl_escape.env.pictures.meshes import compute_extent
from hrl_escape.figures import STYLE, save_figure
from hrl_escape.step_info import ENDINGS

DRAWN = 4
"""Episodes in the picture."""
REFERENCE_WORDS = ("chance and best_known are mean returns in the first test rooms (reference_rooms): of random legal "
                   "options, and of the best known escapes")


def describe(tape: Tape) -> dict[str, Any]:
    """The card as JSON values."""
    about, durations = tape.about, tape.duration
    counts = np.bincount(tape.ended, minlength=len(ENDINGS))
    return {
        "name": about["name"],
        "behaviour": TAPE_KINDS.get(about["kind"], about["kind"]),
        "rooms": about["rooms"],
        "actions": ", ".join(about["actions"]),
        "primitives": len(tape.action),
        "decisions": len(tape.option),
        "episodes": len(tape.room),
        "duration": f"{durations.mean():.1f} primitives per decision, at most {durations.max()}",
        "endings": {name: int(count) for name, count in zip(ENDINGS, counts, strict=True) if count},
        "scores": {name: round(value, 3) for name, value in about["scores"].items()},
        "references": REFERENCE_WORDS,
        "engine": f"{about['engine']}, {about['dynamics']}, recorded with hrl_escape {about['package']}",
        "made_by": about["command"],
        "content": tape.content,
        "digest": tape.digest,
    }


def describe_unrecorded(spec: DataSpec, published: PublishedTape) -> dict[str, Any]:
    """The card of a published tape that is not here, as JSON values; None for what only the tape tells."""
    return {
        "name": spec.name,
        "behaviour": TAPE_KINDS[spec.kind],
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


def draw_card(tape: Tape) -> Figure:
    """Paths of the first episodes in the first room, and the durations of all decisions."""
    room = tape.rooms[int(tape.room[0])]
    numbers = np.flatnonzero(tape.room == tape.room[0])[:DRAWN]
    paths = [_replay(tape, int(number)) for number in numbers]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 4.2), facecolor=palette.BACKGROUND, layout="constrained")
        axes, bars = figure.subplots(1, 2, width_ratios=(1.15, 1))
        x_min, x_max, y_min, y_max = compute_extent(room)
        axes.set(xlim=(x_min - 2, x_max + 2), ylim=(y_min - 2, y_max + 2), aspect="equal")
        axes.set_axis_off()
        draw_room(axes, room, paths[0][0], [
            Trajectory(np.array([(state.x, state.y) for state in path]), f"episode {n + 1}")
            for n, path in enumerate(paths)])
        figure.suptitle(f"{tape.about['name']}: {len(paths)} episodes in the first room; all decisions", fontsize=10)
        edges = np.arange(0.5, float(np.quantile(tape.duration, 0.99)) + 1.5)
        bars.hist(np.minimum(tape.duration, edges[-1] - 0.5), bins=edges, color=palette.LINES[0])  # type: ignore[arg-type]
        bars.set(xlabel="primitives of a decision (the longest 1 % in the last bar)", ylabel="decisions")
        for side in ("top", "right"):
            bars.spines[side].set_visible(False)
    return figure


def save_card(path: str | Path, tape: Tape) -> None:
    """Write the picture; the same bytes every time."""
    save_figure(path, draw_card(tape))


def _replay(tape: Tape, number: int) -> list[RoomState]:
    """States of an episode."""
    rules = Kinematics(tape.rooms[int(tape.room[number])])
    states = [begin_episode(rules, tape, number)]
    for action in tape.action[list_episodes(tape)[number].primitives].tolist():
        states.append(rules.step(states[-1], action).state)
    return states
