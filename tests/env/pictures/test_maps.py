"""Maps: what is drawn where, the same bytes every time, and graphs one can read."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.graph import compute_layout
from hrl_escape.env.pictures.maps import Trajectory, draw_room, make_map, make_map_image, save_map
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.cues import compute_depths
from hrl_escape.env.puzzles.graphs import GraphConfig, compute_order, sample_graph
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import FileWriteError, UnsupportedError
from tests.command_line import run_here
from tests.covering import thin
from tests.env.rooms import all_configs

SCHEMATICS = all_configs()


def make_room(name, seed=3):
    instance = generate(SCHEMATICS[name], seed)
    return instance, Kinematics(instance).make_state(instance.starts[0], 0)


class Picture:
    """A room drawn alone, whose colours can be asked for at places in metres."""

    def __init__(self, instance, state, trajectories=()):
        figure = Figure(figsize=(10, 10), dpi=200)
        self.axes = figure.add_axes((0, 0, 1, 1))
        half = max(instance.reach_x, instance.reach_y) + 1.5
        self.axes.set(xlim=(-half, half), ylim=(-half, half))
        draw_room(self.axes, instance, state, trajectories)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        self.pixels = np.asarray(canvas.buffer_rgba())[..., :3]

    def get_colour(self, x, y):
        column, row = self.axes.transData.transform((x, y))
        return self.pixels[len(self.pixels) - 1 - int(row), int(column)].astype(int)

    def has(self, colour, x, y):
        """Whether a place has a colour of the palette, a little softened by a near edge."""
        return bool(np.abs(self.get_colour(x, y) - 255 * np.array(palette.to_rgb(colour))).max() < 25)


@pytest.mark.nightly_for("many-obstacles")
@pytest.mark.parametrize("name", ["clutter", "door", "paper-two-button", "many-obstacles"])
def test_every_thing_is_drawn_at_its_place(name):
    instance, state = make_room(name)
    start = instance.starts[0]
    picture = Picture(instance, state._replace(x=start.x, y=start.y))
    radius = instance.robot.body_radius
    heading = start.heading_steps * np.radians(instance.robot.turn_step_deg)
    behind = start.x - 0.75 * radius * np.cos(heading), start.y - 0.75 * radius * np.sin(heading)
    assert picture.has(palette.BODY, *behind)
    assert picture.has("#ffffff", start.x + 0.6 * radius * np.cos(heading), start.y + 0.6 * radius * np.sin(heading))
    for wall in (s for s in instance.solids if s.role == "wall"):
        along = wall.half_x * np.linspace(-0.9, 0.9, 7)  # lines to names may cross it
        places = wall.x + along * np.cos(wall.yaw), wall.y + along * np.sin(wall.yaw)
        assert sum(picture.has(palette.WALL, *place) for place in zip(*places, strict=True)) >= 4
    obstacles = [picture.has(palette.OBSTACLE, s.x, s.y) for s in instance.solids if s.role == "obstacle"]
    assert sum(obstacles) >= 0.8 * len(obstacles)  # a neighbour's edge, a wall or the robot may lie over one
    if instance.door is not None:
        assert picture.has(palette.DOOR, instance.door.x, instance.door.y)


@pytest.mark.nightly
def test_targets_have_the_colour_of_their_state():
    instance, state = make_room("four-button-chain")
    lit, off, waiting = palette.LIT.fill, palette.OFF.fill, palette.WAITING.fill
    order = compute_order(4, instance.puzzle.edges)
    for pressed, colours in ((0, [off, waiting, waiting, waiting]), (1, [lit, off, waiting, waiting]), (4, [lit] * 4)):
        picture = Picture(instance, state._replace(puzzle=sum(1 << button for button in order[:pressed])))
        for button, colour in zip(order, colours, strict=True):
            target = instance.targets[button]
            aside = 0.5 * target.half_x  # from the middle, where the line to its name begins
            place = target.x + aside * np.cos(target.yaw), target.y + aside * np.sin(target.yaw)
            assert picture.has(colour, *place)


def test_the_exit_turns_green_once_the_puzzle_is_solved():
    instance, state = make_room("paper-one-button")
    x, y = instance.exit.x_max - 1, instance.exit.y_max - 1
    shut, opened = (Picture(instance, state._replace(puzzle=puzzle)).get_colour(x, y) for puzzle in (0, 1))
    assert opened[1] - opened[0] > 2 * (shut[1] - shut[0]) > 0


def test_trajectories_are_drawn_in_their_colours_under_the_robot():
    instance, state = make_room("paper-two-button")
    paths = [Trajectory([(0, 0), (6, 0)], "one"), Trajectory(np.array([(0, -5), (4, -5)]), "two", "#123456")]
    picture = Picture(instance, state, paths)
    assert picture.has(palette.LINES[0], 3, 0) and picture.has("#123456", 2.5, -5)
    assert picture.has(palette.BODY, state.x + 0.7, state.y)


def test_the_arm_is_drawn_as_far_as_the_hand():
    instance, state = make_room("seven-joints")
    rules = Kinematics(instance)
    for joint_steps in (state.joint_steps, (3, -2, 1, 0, 2, 0, 1)):
        at = state._replace(x=0.0, y=0.0, joint_steps=joint_steps)
        x, y, _ = rules.get_hand(at)
        picture = Picture(instance, at)
        assert picture.has(palette.HAND, x, y) and not picture.has(palette.HAND, x + 0.3, y)


@pytest.mark.nightly_for("sixty-four-buttons", "paper-two-button", "recipes", "ten-button", "hanoi", "pin-pad")
@pytest.mark.parametrize("name", thin(list(SCHEMATICS), 6, first=1))
def test_every_room_can_be_drawn_with_the_names_of_its_targets(name, tmp_path):
    instance, state = make_room(name, seed=1)
    path = tmp_path / "room.svg"
    save_map(path, instance, state)
    text = path.read_text()  # letters are outlines; matplotlib names each text in a comment
    assert f"<!-- {instance.name} -->" in text
    for target in instance.targets:
        assert f"<!-- {target.name}" in text


@pytest.mark.nightly
@pytest.mark.nightly_for("sixty-four-buttons")
@pytest.mark.parametrize("name", [
    pytest.param("twenty-button", marks=pytest.mark.slow), "ten-button", "sixty-four-buttons",
    pytest.param("paper-two-button", marks=pytest.mark.slow)])
def test_names_round_the_room_never_overlap_nor_leave_the_page(name):
    for seed in range(2):
        instance, state = make_room(name, seed)
        figure = make_map(instance, state)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        names = {target.name for target in instance.targets}
        boxes = [text.get_window_extent(canvas.get_renderer()) for text in figure.axes[0].texts
                 if text.get_text().split(" ")[0] in names]
        assert len(boxes) == len(names)
        assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
        assert all(box.x0 >= 0 and box.y0 >= 0 and box.y1 <= figure.bbox.y1 for box in boxes)


DRAW = """
import sys
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.presets import get_preset
from hrl_escape.env.pictures.maps import Trajectory, save_map
for path in sys.argv[1:]:
    save_map(path, generate(get_preset("clutter"), 3), None, [Trajectory([(0, 0), (1, 2)], "path")])
"""


@pytest.mark.nightly
def test_the_same_map_gives_the_same_bytes_in_any_process(tmp_path):
    here, there = ([str(tmp_path / f"{place}.{ending}") for ending in ("svg", "png", "pdf")]
                   for place in ("here", "there"))
    run_here(DRAW, *here)
    subprocess.run([sys.executable, "-c", DRAW, *there], check=True, env=os.environ | {"PYTHONHASHSEED": "1"})
    assert [Path(path).read_bytes() for path in here] == [Path(path).read_bytes() for path in there]


@pytest.mark.nightly
def test_map_images_are_pixels():
    instance, state = make_room("paper-one-button")
    image = make_map_image(instance, state, panel=False, dots_per_inch=50)
    assert image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    assert image.flags.writeable and len(np.unique(image.reshape(-1, 3), axis=0)) > 10


def test_an_unknown_ending_or_an_unwritable_folder_is_one_clear_error(tmp_path):
    instance, _ = make_room("paper-one-button")
    with pytest.raises(UnsupportedError, match=r"room\.bmp.*\.png, \.svg, \.pdf"):
        save_map(tmp_path / "room.bmp", instance)
    (tmp_path / "file").touch()
    with pytest.raises(FileWriteError, match="room.svg"):
        save_map(tmp_path / "file" / "room.svg", instance)


# --- the graph -----------------------------------------------------------------------------


@st.composite
def graphs(draw):
    count = draw(st.integers(1, 64))
    config = GraphConfig(kind=draw(st.sampled_from(["chain", "tree", "layered", "random"])), max_parents=3)
    return count, sample_graph(config, count, np.random.default_rng(draw(st.integers(0, 1000))))


@given(graphs())
def test_depth_is_the_longest_way_from_a_root(graph):
    count, edges = graph
    depths = compute_depths(count, edges)
    for node in range(count):
        above = [depths[parent] for parent, child in edges if child == node]
        assert depths[node] == (max(above) + 1 if above else 0)


@given(graphs())
def test_graphs_are_laid_out_apart_and_downwards(graph):
    count, edges = graph
    places = compute_layout(count, edges)
    depths = compute_depths(count, edges)
    assert all(abs(a[0] - b[0]) >= 1 or abs(a[1] - b[1]) >= 1 for a, b in itertools.combinations(places, 2))
    rows = sum(-(-depths.count(depth) // 8) for depth in set(depths))
    for parent, child in edges if rows <= 12 else ():
        assert places[parent][1] < places[child][1]
    assert max(y for _, y in places) < 12
    assert max(x for x, _ in places) < 8 * -(-rows // 12)


def test_crossings_are_undone_where_they_can_be():
    # two parents, two children, wired crosswise: swapping one pair undoes the crossing
    places = compute_layout(4, [(0, 3), (1, 2)])
    assert (places[0][0] < places[1][0]) == (places[3][0] < places[2][0])


def test_presets_fit_on_one_page():
    for name in ("clutter", "twenty-button"):
        wide, high = make_map(generate(get_preset(name), 0)).get_size_inches()
        assert wide < 16 and high < 12
