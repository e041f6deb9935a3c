"""Pictures drawn while the site is built: rooms by the real generator, learning curves from stored runs.

`{room}` takes the arguments of `hrl-escape room` (or, with `:solve:`, of `hrl-escape solve`, with `:moving:`
as a trajectory) and shows the map that the command draws, or with `:camera: chase` what a camera sees; with
`:sampled: 1` the sampled motion to that target and the motion of a plan of primitives. `{curve}`
draws what `python docs/make_curves.py` has kept, `{data-card}` the picture of a data set, `{mesh}` the way between two
points of a mesh.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import shlex
from pathlib import Path

import tyro
from docutils import nodes
from docutils.parsers.rst import directives
from matplotlib.figure import Figure
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from hrl_escape.commands.room_choice import RoomChoice
from hrl_escape.data.card import save_card
from hrl_escape.data.catalogue import find_recording
from hrl_escape.data.recording import load_recording
from hrl_escape.env.config import RobotConfig
from hrl_escape.env.engine import film
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.maps import Trajectory, save_map
from hrl_escape.env.pictures.video import save_picture
from hrl_escape.figures import save_figure
from hrl_escape.planning.goals import PoseGoal, PressGoal
from hrl_escape.planning.motion.limits import MotionLimits
from hrl_escape.planning.motion.sampled import MotionSampler
from hrl_escape.planning.motion.trajectory import make_trajectory
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.world import World

CURVES = Path(__file__).parents[1] / "curves"


@functools.cache
def make_room(arguments: str) -> RoomInstance:
    """The room that a command's arguments choose; many are drawn twice, empty and solved."""
    return tyro.cli(RoomChoice, args=shlex.split(arguments)).make_instance()


class Picture(SphinxDirective):
    """A directive that draws a file and shows it with a caption (its content) and the command behind it."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def show(self, path: Path, words: str, command: str) -> list[nodes.Node]:
        """A figure of the file at `path`."""
        here = Path(self.env.doc2path(self.env.docname)).parent
        image = nodes.image(uri=Path(os.path.relpath(path, here)).as_posix(), alt=words or command)
        caption = nodes.caption("", f"{words} " if words else "", nodes.literal("", command))
        return [nodes.figure("", image, caption)]

    def choose_path(self, key: str) -> Path:
        """Where to draw, outside the sources; the same for the same key."""
        folder = Path(self.env.doctreedir).parent / "drawn"
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.svg"


class Room(Picture):
    """`{room} --room clutter#3`."""

    option_spec = {"solve": directives.flag, "moving": directives.flag, "camera": directives.unchanged,
                   "sampled": directives.nonnegative_int}

    def run(self) -> list[nodes.Node]:
        """Generate, plan if asked, draw."""
        instance = make_room(self.arguments[0])
        verb, state, paths = "room", None, []
        if "solve" in self.options:
            verb = "solve"
            state = Kinematics(instance).make_state(instance.starts[0], 0)
            plan = get_planner(instance).solve(state)
            paths = [Trajectory(plan.path[part.start : part.stop + 1], part.name) for part in plan.parts]
            state = plan.states[-1]
            if "moving" in self.options:
                path = self.choose_path(f"moving {self.arguments[0]}")
                make_trajectory(plan).draw(instance, path)
                return self.show(path, " ".join(self.content), f"hrl-escape solve {self.arguments[0]} --draw way.html")
        if "sampled" in self.options:
            return self._draw_sampled(instance, PressGoal(self.options["sampled"]))
        path = self.choose_path(f"{verb} {self.arguments[0]} {sorted(self.options)}")
        if camera := self.options.get("camera"):
            path = path.with_suffix(".png")
            state = Kinematics(instance).make_state(instance.starts[0], 0)
            save_picture(path, *film(instance, [state], camera, 960, 720))
            return self.show(path, " ".join(self.content),
                             f"hrl-escape room {self.arguments[0]} --camera {camera} --draw room.png")
        save_map(path, instance, state, paths)
        command = f"hrl-escape {verb} {self.arguments[0]} --draw {verb}.svg"
        return self.show(path, " ".join(self.content), command)


    def _draw_sampled(self, instance: RoomInstance, goal: PressGoal) -> list[nodes.Node]:
        """The sampled path to a target, and the path of a plan of primitives."""
        planner, name = get_planner(instance), instance.targets[goal.target].name
        state = planner.rules.make_state(instance.starts[0])
        found = {"sampled": MotionSampler(instance, MotionLimits()).plan(state, goal),
                 "along primitives": make_trajectory(planner.plan(state, goal))}
        path = self.choose_path(f"sampled {self.arguments[0]} {goal.target}")
        save_map(path, instance, state, [Trajectory(one.sample(20.0)[1][:, :2], f"{words}, {one.duration:.1f} s")
                                         for words, one in found.items()])
        return self.show(path, " ".join(self.content), f"MotionSampler(room, limits).plan(state, {name})")


class Curve(Picture):
    """`{curve} dqn`: the agent flat and over options, mean and range over runs."""

    def run(self) -> list[nodes.Node]:
        """Draw the stored curves."""
        name = self.arguments[0]
        source = CURVES / f"{name}.json"
        self.env.note_dependency(str(source))
        if not source.is_file():
            raise self.error(f"no curve of {name!r}: run python docs/make_curves.py {name}")
        stored = json.loads(source.read_text(encoding="utf-8"))
        figure = Figure(figsize=(6.6, 3.0), dpi=150, layout="constrained")
        axes = figure.add_subplot()
        for curve, colour in zip(stored["curves"][::-1], palette.LINES, strict=False):  # options first
            axes.plot(curve["primitives"], curve["mean"], color=colour, label=curve["agent"], linewidth=1.8)
            axes.fill_between(curve["primitives"], curve["low"], curve["high"], color=colour, alpha=0.15, linewidth=0)
        axes.axhline(stored["best"], color=palette.MUTED, linewidth=0.8, linestyle=":")
        axes.annotate(f"best known {stored['best']:g}", (0, stored["best"]), (3, 2), textcoords="offset points",
                      fontsize=7, color=palette.MUTED)
        axes.set(xlabel="primitives", ylabel="greedy return", xlim=(0, stored["primitives"]), ylim=(-1040, 190))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8, loc="center right")
        path = self.choose_path(f"curve {name}")
        save_figure(path, figure)
        words = (f"{stored['room']}, mean and range of {stored['runs']} runs, "
                 f"{stored['primitives']:,} primitives each.")
        return self.show(path, words, stored["command"])


class DataCard(Picture):
    """`{data-card} lattice-play-v1`: the picture on the card of a data set that comes with the package."""

    def run(self) -> list[nodes.Node]:
        """Replay the first episodes, draw."""
        name = self.arguments[0]
        path = self.choose_path(f"data {name}")
        save_card(path, load_recording(find_recording(name)))
        return self.show(path, " ".join(self.content), f"hrl-escape data show {name} --draw card.svg")


class Mesh(Picture):
    """`{mesh} hall.obj 1.0 5.0 7.0 1.0`: a map of a mesh file in the page's folder, and a path between two points."""

    def run(self) -> list[nodes.Node]:
        """Read, plan, draw."""
        name, *numbers = self.arguments[0].split()
        source = Path(self.env.doc2path(self.env.docname)).parent / name
        self.env.note_dependency(str(source))
        x, y, to_x, to_y = map(float, numbers)
        robot = RobotConfig(body_radius=0.3, move_step=0.25)
        world = World.of_mesh(source, robot, start=(x, y, 0.0), cell=0.1)
        state = world.make_state(x, y)
        plan = get_planner(world.instance).plan(state, PoseGoal(*world.to_room([to_x, to_y]), tolerance=0.2))
        path = self.choose_path(f"mesh {self.arguments[0]}")
        save_map(path, world.instance, state, [Trajectory(plan.path, f"{plan.cost:g} primitives")])
        return self.show(path, " ".join(self.content), f'World.of_mesh("{name}", robot, start=({x:g}, {y:g}, 0))')


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("data-card", DataCard)
    app.add_directive("room", Room)
    app.add_directive("curve", Curve)
    app.add_directive("mesh", Mesh)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
