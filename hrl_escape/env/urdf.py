"""URDF files as they are in the wild: packages and encodings resolved, shapes that every engine reads alike.

`load_urdf` reads a file and resolves its meshes. `prepare_urdf` checks a text and rewrites what engines disagree on:
Bullet, Pinocchio and the viewer then load the same shapes. Metres, radians.
"""

from __future__ import annotations

import copy
import itertools
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

from hrl_escape.errors import FileReadError, RobotError
from hrl_escape.files import DEEPEST, check_files, open_plain, read_bytes

MESH_ENDINGS, LARGEST_MESHES = (".stl", ".obj", ".dae"), 2**25  # bytes of all collision meshes: some 600,000 faces
LARGEST_URDF = 2**23
"""Bytes of the largest URDF file, 8 MiB."""
LARGEST_VISUAL = 2**26
"""Bytes of the largest mesh that is drawn, 64 MiB."""
MOST_LINKS = 1000
"""Links, and collision shapes, of the largest URDF; libraries that read it call themselves at every link of a chain."""
PackagePaths: TypeAlias = "Mapping[str, str | Path] | Sequence[str | Path]"
_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "capsule": ("radius", "length")}
_MOST_FOLDERS = 2000  # of a tree that is searched for packages


def load_urdf(path: str | Path, package_paths: PackagePaths = ()) -> str:
    """Read a user's arm for `RobotConfig(kind="urdf", urdf=...)`, with absolute paths of its meshes.

    A mesh `package://NAME/...` is looked for in `package_paths`, then in the folders above the URDF that are named
    NAME or have a `package.xml` that names it, then in `ROS_PACKAGE_PATH` and `AMENT_PREFIX_PATH`, and last in the
    folders next to those above the URDF. A visual mesh that is missing, or of a format that cannot be drawn, is left
    out: its link is drawn by its collision shapes.

    Args:
        path: the URDF file, in the encoding that it declares.
        package_paths: folders by package name, or folders in which packages are.

    Returns:
        URDF text.

    Raises:
        RobotError: the file is missing, is no URDF, is a xacro file that was not expanded, or a collision mesh is
            missing.
    """
    path = Path(path)
    try:
        content = read_bytes(path, "URDF", LARGEST_URDF)
    except FileReadError as error:
        raise RobotError(f"cannot read the URDF {path}: {error}") from None
    root = parse_urdf(content, str(path))
    finder = _MeshFinder(path, package_paths)
    for link, part, mesh in _list_meshes(root):
        name = mesh.get("filename", "")
        found = finder.find(name)
        if found is not None:
            mesh.set("filename", str(found))
        elif part == "collision":
            raise RobotError(f"the URDF {path} gives link {link!r} the collision mesh {name[:200]!r}, which was not "
                             f"found. {finder.advise(name)}")
    return ElementTree.tostring(root, encoding="unicode")


def is_xml(source: str | Path) -> bool:
    """Return whether a source is the text of an XML file; otherwise it is a path."""
    return isinstance(source, str) and source.lstrip("\ufeff \n\r\t").startswith("<")


def map_joints(urdf: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """Return the joint above each link, by the link's name."""
    return {child.get("link", ""): joint for joint in urdf.findall("joint")
            if (child := joint.find("child")) is not None}


def climb(above: Mapping[str, ElementTree.Element], link: str, base: str = "") -> Iterator[ElementTree.Element]:
    """Yield the joints from a link up to another link or the root, given the joint above each link."""
    for _ in above:  # joints may form a circle
        if link == base or link not in above:
            return
        yield above[link]
        parent = above[link].find("parent")
        link = "" if parent is None else parent.get("link", "")


def parse_xml(text: str | bytes) -> ElementTree.Element:
    """Parse XML of at most `DEEPEST` levels, which recursive functions can take.

    Raises:
        ParseError: the text is not XML.
        ValueError: it is nested deeper, or contains NUL.
        LookupError: its encoding is unknown.
    """
    root = ElementTree.fromstring(text.lstrip("\ufeff") if isinstance(text, str) else text)
    level = [root]
    for _ in range(DEEPEST):
        level = [part for outer in level for part in outer]
    if level:
        raise ValueError(f"it is nested more than {DEEPEST} levels deep")
    return root


def parse_urdf(text: str | bytes, where: str) -> ElementTree.Element:
    """Parse a URDF; raises `RobotError` where `where` is none."""
    try:
        root = parse_xml(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # an unknown encoding is a LookupError
        raise RobotError(f"{where} is not XML that can be read: {error}") from None
    xacro = find_xacro(root)
    if xacro is not None:
        raise RobotError(f"{where} is a xacro file that was not expanded ({xacro}). Run `xacro FILE > robot.urdf` and "
                         "load that file")
    if root.tag != "robot" or root.find("link") is None:
        raise RobotError(f"{where} is not a URDF: no <robot> with links in it")
    for what, path in (("links", "link"), ("collision shapes", "link/collision")):
        if (count := len(root.findall(path))) > MOST_LINKS:
            raise RobotError(f"{where} has {count:,} {what}; at most {MOST_LINKS:,} are read")
    for tag in ("link", "joint"):
        names = Counter(part.get("name", "") for part in root.findall(tag))
        for name, times in names.most_common(1):
            if times > 1:
                raise RobotError(f"{where} has {times:,} {tag}s named {name[:200]!r}. Give each its own name")
    above = map_joints(root)
    for link in above:
        *_, first = climb(above, link)
        parent = first.find("parent")
        if parent is not None and parent.get("link") in above:
            raise RobotError(f"{where}: no joints lead from the URDF's root link to {link[:200]!r}, because some form "
                             "a circle")
    return root


def find_xacro(root: ElementTree.Element) -> str | None:
    """Return the first thing in a file that xacro has to expand, or None."""
    for element in root.iter():
        space, _, tag = element.tag.rpartition("}")
        if "xacro" in space:
            return f"<xacro:{tag}>"
        for value in element.attrib.values():
            if "${" in value or "$(" in value:
                return value
    return None


def _list_meshes(root: ElementTree.Element) -> Iterator[tuple[str, str, ElementTree.Element]]:
    """Names of links, `visual` or `collision`, and the meshes there."""
    for link in root.findall("link"):
        for part in ("visual", "collision"):
            for mesh in link.iterfind(f"{part}/geometry/mesh"):
                yield link.get("name", ""), part, mesh


class _MeshFinder:
    """Files of a URDF's meshes."""

    def __init__(self, urdf: Path, package_paths: PackagePaths) -> None:
        self._folders = tuple(urdf.resolve().parents)
        self._paths = package_paths
        self._known: dict[str, Path | None] = {}

    def find(self, name: str) -> Path | None:
        scheme, _, tail = name.rpartition("://")
        if scheme in ("package", "model"):
            package, _, rest = tail.partition("/")
            root = self._find_package(package, rest)
            return None if root is None else root / rest
        tail = tail if scheme in ("", "file") else name
        places = [Path(tail)] if Path(tail).is_absolute() else [folder / tail for folder in self._folders]
        return next((place for place in places if os.path.isfile(place)), None)

    def advise(self, name: str) -> str:
        if not name.startswith(("package://", "model://")):
            return "Put it where the URDF says, relative to the URDF's folder or to one above it"
        package = name.partition("://")[2].partition("/")[0]
        return f"Give load_urdf(..., package_paths={{{package!r}: FOLDER}}), or set ROS_PACKAGE_PATH"

    def _find_package(self, name: str, rest: str) -> Path | None:
        if name not in self._known:
            self._known[name] = self._find_with(name, rest)
        known = self._known[name]
        if known is not None and not os.path.isfile(known / rest):
            return self._find_with(name, rest)
        return known

    def _find_with(self, name: str, rest: str) -> Path | None:
        """Return the first folder of a package that has a file."""
        return next((folder for folder in self._list_candidates(name) if os.path.isfile(folder / rest)), None)

    def _list_candidates(self, name: str) -> Iterator[Path]:
        if isinstance(self._paths, Mapping):
            if name in self._paths:
                yield Path(self._paths[name]).resolve()
        else:
            for folder in map(Path, self._paths):
                yield from _find_packages(folder.resolve(), name)
        for folder in self._folders:
            yield folder / name
            if folder.name == name or _read_package_name(folder) == name:
                yield folder
        for folder in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield from _find_packages(Path(folder), name)
        for folder in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
            yield Path(folder) / "share" / name
        for folder in self._folders[:4]:
            yield from _find_packages(folder, name, depth=2)


def _find_packages(folder: Path, name: str, depth: int = 3) -> Iterator[Path]:
    """List folders that are a package of a name: this one, and those below it down to a depth."""
    yield folder / name
    level = [folder]
    for _ in range(depth + 1):
        for place in level:
            if place.name == name or _read_package_name(place) == name:
                yield place
        level = list(itertools.islice(itertools.chain.from_iterable(map(_list_folders, level)), _MOST_FOLDERS))


def _list_folders(folder: Path) -> list[Path]:
    try:
        return sorted(Path(entry.path) for entry in os.scandir(folder)
                      if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return []


def _read_package_name(folder: Path) -> str | None:
    try:
        return ElementTree.fromstring(read_bytes(folder / "package.xml", "package.xml", 2**20)).findtext("name")
    except (FileReadError, ElementTree.ParseError, ValueError, LookupError):
        return None


# --- shapes --------------------------------------------------------------------------------------


def prepare_urdf(root: ElementTree.Element) -> None:
    """Rewrite a user's URDF in place into what Bullet, Pinocchio and the viewer read alike.

    A capsule becomes a cylinder and two spheres. Joints get the attributes of `<limit>` that parsers require. What
    cannot be drawn is left out of the visual shapes; a link that loses all of them is drawn by its collision shapes.

    Raises:
        RobotError: a collision shape is empty, unknown or has a size that is none; a collision mesh is no file.
        FileReadError: collision meshes are too large or of an unknown format.
    """
    for link in root.findall("link"):
        name, had_visual = link.get("name", ""), link.find("visual") is not None
        for part in ("collision", "visual"):
            for element in link.findall(part):
                try:
                    replacement = _prepare_shape(element, part, name)
                except (RobotError, FileReadError):
                    if part == "collision":
                        raise
                    replacement = []
                at = list(link).index(element)
                link.remove(element)
                for extra in reversed(replacement):
                    link.insert(at, extra)
        if had_visual and link.find("visual") is None:
            for element in link.findall("collision"):
                shown = copy.deepcopy(element)
                shown.tag = "visual"
                link.append(shown)
    check_files((mesh.get("filename", "") for _, part, mesh in _list_meshes(root) if part == "collision"), "mesh",
                MESH_ENDINGS, LARGEST_MESHES)
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is not None:
            for key in ("effort", "velocity"):
                limit.set(key, limit.get(key, "0"))


def _prepare_shape(element: ElementTree.Element, part: str, link: str) -> list[ElementTree.Element]:
    """Return the elements that stand for one `<collision>` or `<visual>`."""
    geometry = element.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    what = f"the {part} shape of link {link!r}"
    if geometry is None or len(shapes) != 1:
        raise RobotError(f"{what} has {len(shapes)} geometries; a <geometry> holds exactly one")
    shape = shapes[0]
    if shape.tag == "mesh":
        _check_mesh(shape, what, part)
        return [element]
    if shape.tag not in _SIZES:
        raise RobotError(f"{what} is <{shape.tag}>; valid are {', '.join(_SIZES)} and mesh. Replace it by a mesh")
    for key in _SIZES[shape.tag]:
        numbers = read_numbers(shape.get(key, ""), 3 if key == "size" else 1)
        if numbers is None or min(numbers) <= 0.0:
            raise RobotError(f"{what}: {key} of <{shape.tag}> must be {'3 numbers' if key == 'size' else 'a number'} "
                             f"above 0, got {shape.get(key)!r}")
    return _split_capsule(element) if shape.tag == "capsule" else [element]


def _check_mesh(shape: ElementTree.Element, what: str, part: str) -> None:
    name = shape.get("filename", "")
    scale = read_numbers(shape.get("scale", "1 1 1"), 3)
    if scale is None or 0.0 in scale:
        raise RobotError(f"{what}: the scale of a mesh must be 3 numbers that are not 0, got {shape.get('scale')!r}")
    if not Path(name).is_absolute():
        raise RobotError(f"{what} is the mesh {name!r}, which is no file here. load_urdf(path) or --set "
                         "robot.urdf=PATH finds the meshes of a URDF file")
    if part == "visual":
        check_files([name], "mesh", MESH_ENDINGS, LARGEST_VISUAL)
        return
    try:
        with open_plain(name, "mesh"):
            pass
    except FileReadError as error:
        raise RobotError(f"{what}: {error}") from None


def _split_capsule(element: ElementTree.Element) -> list[ElementTree.Element]:
    """Return a cylinder and two spheres; the length of a capsule is that of its cylinder."""
    geometry = element.find("geometry")
    assert geometry is not None
    radius, length = geometry[0].get("radius", ""), geometry[0].get("length", "")
    geometry[:] = [ElementTree.Element("cylinder", radius=radius, length=length)]
    ends = []
    for side in (-0.5, 0.5):
        end = copy.deepcopy(element)
        origin = end.find("origin")
        origin = ElementTree.SubElement(end, "origin") if origin is None else origin
        at = read_numbers(origin.get("xyz", "0 0 0"), 3) or (0.0, 0.0, 0.0)
        roll, pitch, yaw = read_numbers(origin.get("rpy", "0 0 0"), 3) or (0.0, 0.0, 0.0)
        along = (math.cos(yaw) * math.sin(pitch) * math.cos(roll) + math.sin(yaw) * math.sin(roll),
                 math.sin(yaw) * math.sin(pitch) * math.cos(roll) - math.cos(yaw) * math.sin(roll),
                 math.cos(pitch) * math.cos(roll))  # the z axis, turned by Rz Ry Rx
        origin.set("xyz", " ".join(repr(a + side * float(length) * b) for a, b in zip(at, along, strict=True)))
        shape = end.find("geometry")
        assert shape is not None
        shape[:] = [ElementTree.Element("sphere", radius=radius)]
        ends.append(end)
    return [element, *ends]


def read_numbers(text: str, count: int) -> tuple[float, ...] | None:
    """Read finite numbers apart by spaces; None if there are not so many."""
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        return None
    return values if len(values) == count and all(map(math.isfinite, values)) else None


def drop_shapes(root: ElementTree.Element, part: str) -> None:
    """Remove the `visual` or the `collision` shapes of all links, in place."""
    for link in root.findall("link"):
        for element in link.findall(part):
            link.remove(element)
