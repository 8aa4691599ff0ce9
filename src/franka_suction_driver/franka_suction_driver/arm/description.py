"""The one robot description: arm from example-robot-data plus our suction tool, as URDF text.

Pinocchio, PyBullet, the robot-body filter and the view all read what `compose_urdf` returns.
Links and joints are meant to be looked up by name; no index is promised.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from flowbothd_common.errors import FlowBotError

ARM_DISTRIBUTION = "example-robot-data"
_ARM_URDF = Path("robots/panda_description/urdf/panda.urdf")
_MESH_SCHEME = "package://example-robot-data/"
_FLANGE = "panda_link8"
# Bullet mishandles links without mass at the end of a chain; a tenth of a gram is felt by nobody.
_TIP_MASS = 1e-4


class DescriptionError(FlowBotError):
    """The arm's description is not installed, or cannot be turned into ours."""


@dataclass(frozen=True)
class ToolDimensions:
    """The suction tool: a pump body on the flange, a slim stem, a cup; all along the flange's +z.

    The stem is what lets the cup reach a leaf that lies 3.4 cm deep between the jambs of its
    frame while the body, wider than the jamb's distance from the cup, stays outside, with the
    tool tilted by up to 25 degrees.

    Attributes:
        tip: Distance from the flange to the cup's lip [m].
        body_diameter: [m].
        body_length: [m].
        stem_diameter: [m].
        cup_diameter: [m].
        cup_height: [m].
        body_mass: [kg].
        stem_mass: [kg].
        cup_mass: [kg].
    """

    tip: float = 0.16
    body_diameter: float = 0.09
    body_length: float = 0.075
    stem_diameter: float = 0.016
    cup_diameter: float = 0.03
    cup_height: float = 0.02
    body_mass: float = 0.65
    stem_mass: float = 0.05
    cup_mass: float = 0.02

    def __post_init__(self) -> None:
        """Reject sizes that cannot be built."""
        for name, value in vars(self).items():
            if not value > 0.0:
                raise DescriptionError(f"tool dimension {name}", got=value, allowed="> 0")
        if self.stem_length <= 0.0:
            raise DescriptionError(
                "the tool has no room for its stem",
                got=f"body {self.body_length} m + cup {self.cup_height} m",
                allowed=f"less than the tip distance {self.tip} m",
            )

    @property
    def stem_length(self) -> float:
        """Between body and cup [m]."""
        return self.tip - self.body_length - self.cup_height


def compose_urdf(
    tool: ToolDimensions | None = None,
    *,
    arm_urdf: Path | None = None,
    tip_frame: str = "suction_tip",
    arm: str = "panda",
) -> str:
    """URDF text of the seven-joint arm with the suction tool instead of its hand.

    Mesh paths are absolute. Added links: `suction_body`, `suction_stem`, `suction_cup`, and the
    frame `tip_frame` at the centre of the cup's lip, z pointing out of the cup.

    Args:
        tool: Dimensions; the defaults are those of the simulated tool.
        arm_urdf: The arm's URDF; found in the installed example-robot-data if omitted.
        tip_frame: Name of the frame at the cup's lip.
        arm: How the names of the arm's links and joints begin; an FR3 has the Panda's geometry
            and other limits, which come by parameter.

    Raises:
        DescriptionError: the arm's files are missing or damaged.
    """
    tool = tool or ToolDimensions()
    source = arm_urdf or find_arm_urdf()
    try:
        robot = ET.parse(source).getroot()
    except (ET.ParseError, OSError) as error:
        raise DescriptionError(
            f"cannot read the arm's description {source}: {error}",
            hint=f"reinstall {ARM_DISTRIBUTION}",
        ) from error
    _remove_below(robot, _FLANGE)
    _make_mesh_paths_absolute(robot, source.parents[3])
    _add_tool(robot, tool, tip_frame)
    if arm != "panda":
        _rename(robot, arm)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True)


def read_description(path: str) -> str | None:
    """Text of a robot description file; None, meaning the composed one, for an empty path.

    Raises:
        DescriptionError: there is no such file.
    """
    if not path:
        return None
    if not Path(path).is_file():
        raise DescriptionError(
            "the robot description file does not exist", got=path, hint="empty = compose one"
        )
    return Path(path).read_text(encoding="utf-8")


def find_arm_urdf() -> Path:
    """Path of the Panda's URDF in the installed example-robot-data (PyPI wheel or ROS package).

    Raises:
        DescriptionError: it is not installed.
    """
    for folder in _share_folders():
        candidate = folder / _ARM_URDF
        if candidate.is_file():
            return candidate
    raise DescriptionError(
        "the Panda's description is not installed",
        allowed=f"the Python package {ARM_DISTRIBUTION}, or the ROS package of that name",
        hint=f"run `make setup`, or `pip install {ARM_DISTRIBUTION}`",
    )


def _share_folders() -> Iterator[Path]:
    try:
        files = metadata.files(ARM_DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.as_posix().endswith(_ARM_URDF.as_posix()):
            yield Path(str(file.locate())).resolve().parents[3]
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / ARM_DISTRIBUTION


def _remove_below(robot: ET.Element, flange: str) -> None:
    """Drop every link and joint that hangs on `flange` (hand and fingers)."""
    if robot.find(f"link[@name='{flange}']") is None:
        raise DescriptionError(
            "the arm's description has no flange",
            got=[link.get("name") for link in robot.findall("link")],
            allowed=flange,
        )
    doomed = [flange]
    while doomed:
        parent = doomed.pop()
        for joint in robot.findall("joint"):
            if _link_of(joint, "parent") != parent:
                continue
            child = _link_of(joint, "child")
            link = robot.find(f"link[@name='{child}']")
            robot.remove(joint)
            if link is not None:
                robot.remove(link)
            doomed.append(child)


def _rename(robot: ET.Element, arm: str) -> None:
    for element in robot.iter():
        for key in ("name", "link"):
            value = element.get(key, "")
            if value.startswith("panda_"):
                element.set(key, arm + value.removeprefix("panda"))


def _link_of(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _make_mesh_paths_absolute(robot: ET.Element, share: Path) -> None:
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        path = share / name.removeprefix(_MESH_SCHEME)
        if not path.is_file():
            raise DescriptionError(
                f"a mesh of the arm is missing: {path}", hint=f"reinstall {ARM_DISTRIBUTION}"
            )
        mesh.set("filename", str(path))


def _add_tool(robot: ET.Element, tool: ToolDimensions, tip_frame: str) -> None:
    parts = (
        ("suction_body", tool.body_mass, tool.body_diameter, tool.body_length, "0.22 0.24 0.28 1"),
        ("suction_stem", tool.stem_mass, tool.stem_diameter, tool.stem_length, "0.75 0.76 0.78 1"),
        ("suction_cup", tool.cup_mass, tool.cup_diameter, tool.cup_height, "0.13 0.45 0.75 1"),
    )
    parent, end = _FLANGE, 0.0
    for name, mass, diameter, length, colour in parts:
        _add_cylinder(_add_link(robot, name, mass, length / 2, length), diameter, length, colour)
        _add_fixed_joint(robot, parent, name, end)
        parent, end = name, length
    _add_link(robot, tip_frame, _TIP_MASS, 0.0, 0.01)
    _add_fixed_joint(robot, parent, tip_frame, end)


def _add_link(robot: ET.Element, name: str, mass: float, centre: float, size: float) -> ET.Element:
    link = ET.SubElement(robot, "link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=f"0 0 {centre:.6g}", rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.6g}")
    # Of a cylinder about as wide as long: close enough for an arm that is position controlled.
    moment = f"{mass * size**2 * 7.0 / 48.0:.6g}"
    values = {"ixx": moment, "iyy": moment, "izz": moment, "ixy": "0", "ixz": "0", "iyz": "0"}
    ET.SubElement(inertial, "inertia", values)
    return link


def _add_cylinder(link: ET.Element, diameter: float, length: float, colour: str) -> None:
    for kind in ("visual", "collision"):
        element = ET.SubElement(link, kind)
        ET.SubElement(element, "origin", xyz=f"0 0 {length / 2:.6g}", rpy="0 0 0")
        geometry = ET.SubElement(element, "geometry")
        ET.SubElement(geometry, "cylinder", radius=f"{diameter / 2:.6g}", length=f"{length:.6g}")
        if kind == "visual":
            material = ET.SubElement(element, "material", name=f"{link.get('name')}_colour")
            ET.SubElement(material, "color", rgba=colour)


def _add_fixed_joint(robot: ET.Element, parent: str, child: str, offset: float) -> None:
    joint = ET.SubElement(robot, "joint", name=f"{child}_joint", type="fixed")
    ET.SubElement(joint, "origin", xyz=f"0 0 {offset:.6g}", rpy="0 0 0")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
