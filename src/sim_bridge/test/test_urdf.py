"""Reading URDFs: what is taken, what is refused, and in which words."""

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError
from sim_bridge.objects import load_object
from sim_bridge.urdf import read_urdf

BOX = '<geometry><box size="0.1 0.2 0.3"/></geometry>'
LINK = "<link name='{name}'><visual>" + BOX + "</visual><collision>" + BOX + "</collision></link>"


def two_links(joint):
    """A robot of two boxes with the given joint between them."""
    return f"<robot name='r'>{LINK.format(name='a')}{LINK.format(name='b')}{joint}</robot>"


def joint(kind="revolute", limit="<limit lower='0' upper='1'/>", axis="0 0 1"):
    return (
        f"<joint name='j' type='{kind}'><origin xyz='1 0 0' rpy='0 0 1.5707963267948966'/>"
        f"<parent link='a'/><child link='b'/><axis xyz='{axis}'/>{limit}</joint>"
    )


def write(tmp_path, text):
    path = tmp_path / "thing.urdf"
    path.write_text(text)
    return path


def test_origins_axes_and_shapes_come_through(tmp_path):
    model = load_object(write(tmp_path, two_links(joint(axis="1 0 0"))))
    turned = model.joints["j"]
    # The joint frame is turned by a quarter about z: its x axis is the object's y axis.
    assert np.allclose(turned.axis, (0, 1, 0))
    assert np.allclose(turned.point, (1, 0, 0))
    assert np.allclose(np.ptp(model.links["b"].mesh.vertices, axis=0), (0.2, 0.1, 0.3))


@pytest.mark.parametrize(("lower", "upper"), [("-1.57", "0"), ("-0.0", "1.57"), ("0.3", "0.9")])
def test_closed_is_the_lower_limit_whatever_its_sign(tmp_path, lower, upper):
    limit = f"<limit lower='{lower}' upper='{upper}'/>"
    model = load_object(write(tmp_path, two_links(joint(limit=limit))))
    assert model.closed() == {"j": float(lower)}
    assert model.target.open_ratio(float(lower)) == 0.0
    assert model.target.open_ratio(float(upper)) == 1.0


@pytest.mark.parametrize("limit", ["", "<limit lower='0'/>", "<limit lower='-inf' upper='inf'/>"])
def test_a_hinge_without_finite_limits_is_refused_by_name(tmp_path, limit):
    with pytest.raises(ObjectModelError, match=r"joint j has no finite limits.*continuous"):
        load_object(write(tmp_path, two_links(joint(limit=limit))))


def test_what_cannot_be_opened_is_locked_and_nothing_left_is_an_error(tmp_path):
    for bad in (joint("continuous", ""), joint(limit="<limit lower='0' upper='0'/>")):
        with pytest.raises(ObjectModelError, match=r"nothing to open.*'j'"):
            load_object(write(tmp_path, two_links(bad)))


def test_a_missing_mesh_is_named_with_its_line_and_link(tmp_path):
    text = (
        "<robot name='r'>\n<link name='base'/>\n<link name='door'>\n<visual><geometry>\n"
        '<mesh filename="textured_objs/original-7.obj"/>\n'
        "</geometry></visual></link>\n"
        "<joint name='j' type='fixed'><parent link='base'/><child link='door'/></joint></robot>"
    )
    with pytest.raises(ObjectModelError) as caught:
        load_object(write(tmp_path, text))
    for word in ("link door", "textured_objs/original-7.obj", "line 5", "thing.urdf"):
        assert word in str(caught.value)


def test_an_unreadable_mesh_is_named(tmp_path):
    (tmp_path / "empty.obj").write_text("# nothing\n")
    text = two_links(joint()).replace(BOX, "<geometry><mesh filename='empty.obj'/></geometry>")
    with pytest.raises(ObjectModelError, match=r"empty\.obj"):
        load_object(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "not valid XML"),
        ("<sdf/>", "not a URDF; got <sdf>"),
        ("<robot name='r'/>", "no links"),
        (two_links(""), "do not form one tree"),
        (two_links(joint()).replace("child link='b'", "child link='c'"), "does not exist; got c"),
        (two_links(joint("floating")), "unsupported kind; got floating"),
    ],
)
def test_malformed_files_say_what_is_wrong(tmp_path, text, words):
    with pytest.raises(ObjectModelError) as caught:
        load_object(write(tmp_path, text))
    assert words in str(caught.value)


def test_the_robots_visual_meshes_agree_with_its_collision_meshes(robot_urdf):
    """Checks the COLLADA reader against the same parts in another format."""
    robot = read_urdf(robot_urdf)
    compared = 0
    for link in robot.links.values():
        kinds = {s.path.suffix for s in (*link.visuals, *link.collisions) if s.path}
        if kinds != {".dae", ".stl"}:
            continue
        boxes = [
            np.concatenate([m.vertices for shape in shapes for m in shape.meshes()])
            for shapes in (link.visuals, link.collisions)
        ]
        seen, felt = (np.array([b.min(axis=0), b.max(axis=0)]) for b in boxes)
        assert np.abs(seen - felt).max() < 0.012, link.name
        compared += 1
    assert compared >= 7
