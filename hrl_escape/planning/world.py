"""`World`: a place to plan in that is no puzzle, made of solids, of a mesh, or of a map of ROS's map_server."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.instance import Rectangle, RoomInstance, Start, check_room
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.puzzles.base import NoPuzzle
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.planning import ros
from hrl_escape.planning.goals import PoseGoal
from hrl_escape.planning.occupancy_grid import read_occupancy_grid

if TYPE_CHECKING:  # loads OMPL and Ruckig
    from hrl_escape.planning.motion.trajectory import TimedTrajectory

MOST_MESH_CELLS = 5_000_000
"""Cells that a mesh may take, of its floor or of its faces."""
MOST_COLUMNS = 100_000
"""Boxes that the solid cells of a map or a mesh may make."""
_POSE = "x and y in m, and a heading in rad"
RIM = 0.1
"""Thickness of the walls that stand round a world, m."""


@dataclasses.dataclass(frozen=True, eq=False)
class World:
    """A floor with solids and one robot; nothing is to be pressed.

    `instance` goes to `RoomPlanner`, `ArmPlanner`, `Scene` and environments. Its frame has the floor's centre as
    origin; `to_room` and `to_map` lead from your own frame and back. `goal` takes places of your frame, and `to_ros`,
    `to_path` and `to_pose` return messages of ROS in it.

    Attributes:
        instance: the room.
        centre: centre of the floor in your frame, (x, y), m.
    """

    instance: RoomInstance
    centre: tuple[float, float]

    @classmethod
    def of(cls, solids: Sequence[Solid], robot: RobotConfig, start: Sequence[float], *,
           floor: tuple[float, float, float, float], wall_height: float = 3.0) -> World:
        """Make a world of boxes and cylinders.

        Args:
            solids: in your frame.
            robot: the robot.
            start: x and y of its axis, m, and its heading, rad, in your frame.
            floor: x_min, x_max, y_min and y_max in your frame, m; walls stand round it.
            wall_height: of these, m.

        Raises:
            ConfigError: the floor is none, or the start is not free.
        """
        x_min, x_max, y_min, y_max = (float(number) for number in floor)
        if not (x_min < x_max and y_min < y_max):
            raise ConfigError("floor", floor, "x_min < x_max and y_min < y_max")
        half_x, half_y, x, y = (x_max - x_min) / 2, (y_max - y_min) / 2, (x_min + x_max) / 2, (y_min + y_max) / 2
        placed = [dataclasses.replace(solid, x=solid.x - x, y=solid.y - y) for solid in solids]
        walls = [Solid("box", side * (half_x + RIM), 0.0, RIM, half_y + 2 * RIM, height=wall_height, role="wall")
                 for side in (-1.0, 1.0)]
        walls += [Solid("box", 0.0, side * (half_y + RIM), half_x + 2 * RIM, RIM, height=wall_height, role="wall")
                  for side in (-1.0, 1.0)]
        instance = RoomInstance(name="world", half_width=half_x, half_depth=half_y, wall_height=wall_height,
                                solids=(*walls, *placed), robot=robot,
                                exit=Rectangle(half_x, half_x, half_y, half_y),  # a corner, where no axis comes
                                puzzle=NoPuzzle())
        world = cls(instance, (x, y))
        at_x, at_y, heading = _read_numbers("start", start, 3, _POSE)
        state = world.make_state(at_x, at_y, heading)
        begin = Start(state.x, state.y, state.heading_steps, state.heading_offset)
        world = cls(dataclasses.replace(instance, starts=(begin,)), (x, y))
        try:
            check_room(world.instance)
        except ConfigError as error:
            if not error.field.startswith("instance.starts"):
                raise
            raise ConfigError("start", start, f"a pose with x from {x_min:g} to {x_max:g} m and y from {y_min:g} to "
                                              f"{y_max:g} m at which the base touches nothing solid") from None
        return world

    @classmethod
    def read(cls, path: str | Path, robot: RobotConfig, start: Sequence[float], *, height: float = 3.0,
             unknown_is_free: bool = False) -> World:
        """Read an occupancy grid as ROS's map_server writes it: a YAML file that names an image.

        The file is read by the rules of nav2's `map_io` in the modes `trinary`, `scale` and `raw`. Occupied cells
        become boxes, adjacent cells one box. Your frame is the map's.

        Args:
            path: the YAML file.
            robot: the robot.
            start: x and y of its axis, m, and its heading, rad, in the map's frame.
            height: height of everything occupied, m.
            unknown_is_free: whether the robot may enter cells that are unknown or between the thresholds.

        Raises:
            FileReadError: a file is missing, damaged, too large or not a map, or the map is turned.
            ConfigError: the height is not positive, the map has too many boxes, or the start is not free.
        """
        if not height > 0.0:
            raise ConfigError("height", height, "above 0 m")
        grid = read_occupancy_grid(path)
        solid, cell, (x, y) = grid.find_solid(unknown_is_free), grid.resolution, grid.origin
        rows, columns = solid.shape
        return cls.of(make_columns(np.where(solid, height, 0.0), cell, (x, y)), robot, start,
                      floor=(x, x + cell * columns, y, y + cell * rows), wall_height=height)

    @classmethod
    def of_mesh(cls, path: str | Path, robot: RobotConfig, start: Sequence[float], *, cell: float = 0.05,
                below: float = 2.0) -> World:
        """Make a world of a mesh (STL, OBJ or DAE), such as a scan of a room: metres, z up, its floor at z = 0.

        Each cell of the floor becomes as high as the mesh is anywhere over it, rounded up to a multiple of `cell`, so
        that a table is solid down to the floor; outlines grow by two cells at most. Your frame is the mesh's; a unit or
        an up axis that the file names is not applied.

        Args:
            path: the mesh.
            robot: the robot.
            start: x and y of its axis, m, and its heading, rad, in the mesh's frame.
            cell: side of a cell, m; what is lower than half of it is floor.
            below: height, m, from which on things are left out: lintels, lamps, the ceiling. What is taller is cut
                there, so choose it above all that the robot reaches.

        Raises:
            FileReadError: a file that is missing or is no mesh.
            ConfigError: a cell or a height that is none, nothing on the floor, a mesh too large for its cells, too many
                boxes, or a start that is not free.
        """
        from hrl_escape.env.mesh_files import load_triangles  # loads coal

        if not 0.0 < cell < math.inf:
            raise ConfigError("cell", cell, "a length above 0 m")
        if not cell / 2 < below < math.inf:
            raise ConfigError("below", below, f"a height above half a cell, {cell / 2:g} m")
        corners = load_triangles(path)
        every = corners.reshape(-1, 3)[:, :2] if len(corners) else np.zeros((1, 2))
        (x, y), (x_max, y_max) = every.min(axis=0).tolist(), every.max(axis=0).tolist()

        def keep_standing(corners: NDArray[np.float64]) -> NDArray[np.float64]:
            return corners[(corners[..., 2].max(axis=1) >= cell / 2) & (corners[..., 2].min(axis=1) < below)]

        corners = keep_standing(corners)
        if not len(corners):
            raise ConfigError("mesh", str(path), f"something from {cell / 2:g} to {below:g} m above its floor, z = 0")
        longest = measure_edges(corners).max(axis=1) / cell
        if max((x_max - x) / cell * (y_max - y) / cell, float((longest**2).sum())) > MOST_MESH_CELLS:
            raise ConfigError("mesh", f"{x_max - x:g} x {y_max - y:g} m in cells of {cell:g} m",
                              "metres, not millimetres, or larger cells")
        corners = keep_standing(split_triangles(corners, cell))
        columns, rows = (max(1, math.ceil(length / cell)) for length in (x_max - x, y_max - y))
        low = np.floor((corners[..., :2].min(axis=1) - (x, y)) / cell + 1e-6).astype(int)
        high = np.ceil((corners[..., :2].max(axis=1) - (x, y)) / cell - 1e-6).astype(int) - 1
        low = np.clip(low, 0, (columns - 1, rows - 1))
        high = np.clip(high, low, (columns - 1, rows - 1))
        top = np.ceil(np.minimum(corners[..., 2].max(axis=1), below) / cell - 1e-6) * cell
        heights = np.zeros((rows, columns))
        for across, along in np.ndindex(*(high - low).max(axis=0) + 1):
            column, row = np.minimum(low + (across, along), high).T
            np.maximum.at(heights, (row, column), top)
        return cls.of(make_columns(heights, cell, (x, y)), robot, start,
                      floor=(x, x + cell * columns, y, y + cell * rows), wall_height=max(below, heights.max()))

    def make_state(self, x: float, y: float, heading: float = 0.0, angles: Sequence[float] | None = None) -> RoomState:
        """State of the robot at a pose of your frame, m and rad, with joint angles, rad; None for those of its home.

        Angles of continuous joints may have any number of turns.

        Raises:
            ConfigError: a number is not finite, or the number of angles is not that of the joints.
        """
        x, y, heading = _read_numbers("pose", (x, y, heading), 3, _POSE)
        rules, (at_x, at_y) = Kinematics(self.instance), self.to_room([x, y]).tolist()
        state = rules.make_state(Start(at_x, at_y, *rules.split_heading(heading)))
        if angles is None:
            return state
        given = _read_numbers("angles", angles, len(rules.robot.joint_names), "joint angles in rad")
        turned = [math.remainder(angle, math.tau) if turns else angle
                  for angle, turns in zip(given, rules.robot.continuous, strict=True)]
        joint_steps, joint_offsets = rules.split_angles(turned)
        return state._replace(joint_steps=joint_steps, joint_offsets=joint_offsets)

    def goal(self, x: float, y: float, heading: float | None = None, *, tolerance: float = 0.5) -> PoseGoal:
        """Return a goal for `RoomPlanner.plan` at a place of your frame, m, with a heading, rad, or any.

        `tolerance` is the largest distance from the place, m.
        """
        x, y = self.to_room([x, y]).tolist()
        return PoseGoal(x, y, heading, tolerance=tolerance)

    def to_ros(self, trajectory: TimedTrajectory, rate: float = 50.0, *, frame: str = "map") -> dict[str, Any]:
        """Return the fields of a `moveit_msgs/RobotTrajectory` in your frame; see `TimedTrajectory.to_ros`."""
        return trajectory.to_ros(rate, frame=frame, offset=self.centre)

    def to_path(self, trajectory: TimedTrajectory, rate: float = 10.0, *, frame: str = "map") -> dict[str, Any]:
        """Return the fields of a `nav_msgs/Path`: poses of the base in your frame, stamped with times from the start.

        Raises:
            UnsupportedError: the trajectory has no base, as that of an arm.
        """
        if trajectory.names[:1] != ("x",):
            raise UnsupportedError("a Path needs places of the base, and this trajectory moves the arm alone: to_ros "
                                   "gives its joints")
        times, positions, _ = trajectory.sample(rate)
        rows = zip(times.tolist(), self.to_map(positions[:, :3]).tolist(), strict=True)
        return {"header": ros.make_header(frame),
                "poses": [ros.make_pose_stamped(x, y, heading, frame, time) for time, (x, y, heading) in rows]}

    def to_pose(self, state: RoomState, *, frame: str = "map") -> dict[str, Any]:
        """Return the fields of a `geometry_msgs/PoseStamped`: the base at a state, in your frame."""
        x, y = self.to_map([state.x, state.y]).tolist()
        return ros.make_pose_stamped(x, y, Kinematics(self.instance).get_heading(state), frame)

    def to_room(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 2 or more) of your frame in the room's; what follows x and y stays."""
        return self._shift(points, -1.0)

    def to_map(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 2 or more) of the room in your frame; what follows x and y stays."""
        return self._shift(points, 1.0)

    def _shift(self, points: ArrayLike, sign: float) -> NDArray[np.float64]:
        moved = np.array(points, dtype=np.float64)
        moved[..., :2] += sign * np.array(self.centre)
        return moved


def _read_numbers(name: str, values: Sequence[float], count: int, valid: str) -> list[float]:
    """Return so many finite numbers; `name` and `valid` are for the message."""
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ConfigError(name, values, f"{count} finite numbers: {valid}")
    return numbers


def measure_edges(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of triangles' edges, each from a corner to the next; (triangles, 3) of (triangles, 3 corners, 3)."""
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def split_triangles(corners: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """Triangles that cover the same, with no edge longer than given; shapes (triangles, 3 corners, 3)."""
    done = []
    while len(corners):
        edges = measure_edges(corners)
        is_small = edges.max(axis=1) <= longest
        done.append(corners[is_small])
        rest, first = corners[~is_small], edges[~is_small].argmax(axis=1)
        a, b, c = (np.take_along_axis(rest, ((first + turn) % 3)[:, None, None], axis=1)[:, 0] for turn in range(3))
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate([np.zeros((0, 3, 3)), *done])


def make_columns(heights: NDArray[np.float64], cell: float, corner: tuple[float, float]) -> list[Solid]:
    """Boxes on the cells of a floor with a corner, m, as high as `heights`, (rows along y, columns along x), m.

    Cells side by side of one height are one box. Raises `ConfigError` for more than `MOST_COLUMNS`.
    """
    x, y = corner
    merged = ((height, box) for height in np.unique(heights[heights > 0.0]) for box in merge_cells(heights == height))
    boxes = list(itertools.islice(merged, MOST_COLUMNS + 1))
    if len(boxes) > MOST_COLUMNS:
        raise ConfigError("boxes", f"more than {MOST_COLUMNS:,}", f"at most {MOST_COLUMNS:,} of solid cells side by "
                          "side. Take larger cells, or remove single cells from the map")
    return [Solid("box", x + cell * (a + b) / 2, y + cell * (c + d) / 2, cell * (b - a) / 2, cell * (d - c) / 2,
                  height=float(height)) for height, (a, b, c, d) in boxes]


def merge_cells(solid: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Yield the rectangles of cells (rows, columns): first column, column after the last, first row, row after."""
    open_runs = dict[tuple[int, int], int]()
    for row, cells in enumerate([*solid, np.zeros(solid.shape[1], dtype=bool)]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(np.int8), [0]])))
        runs = {(int(a), int(b)) for a, b in edges.reshape(-1, 2)}
        yield from ((a, b, first, row) for (a, b), first in open_runs.items() if (a, b) not in runs)
        open_runs = {run: open_runs.get(run, row) for run in sorted(runs)}
