"""PartNet-Mobility folders: a small one written here, and the real ones where they are at hand."""

import numpy as np
import pytest

from flowbothd_common.errors import ObjectModelError
from flowbothd_model.data.partnet import load_partnet, read_obj
from flowbothd_model.data.sampling import SampleConfig, Situation, draw_sample
from flowbothd_model.data.splits import NEVER_TRAINED_ON, held_out_ids, split_folders

URDF = """<robot name="small">
  <link name="base"/>
  <link name="lid"><visual><origin xyz="0.5 0 0"/>
    <geometry><mesh filename="square.obj"/></geometry></visual></link>
  <link name="body"><visual><geometry><mesh filename="square.obj"/></geometry></visual></link>
  <joint name="turn" type="revolute"><origin xyz="0 0 1"/><axis xyz="0 2 0"/>
    <parent link="body"/><child link="lid"/><limit lower="0" upper="1.2"/></joint>
  <joint name="fix" type="fixed"><origin rpy="0 0 1.5707963267948966"/>
    <parent link="base"/><child link="body"/></joint>
</robot>"""
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mobility.urdf").write_text(URDF)
    (tmp_path / "square.obj").write_text(SQUARE)
    (tmp_path / "meta.json").write_text('{"model_cat": "Box"}')
    return tmp_path


def test_frames_are_chained_whatever_the_order_in_the_file(folder):
    item = load_partnet(folder)
    assert item.category == "Box"
    assert len(item.movable) == 1
    joint = item.joints[item.movable[0]]
    np.testing.assert_allclose(joint.axis, (-1, 0, 0), atol=1e-9)  # y, turned by a quarter about z
    np.testing.assert_allclose(joint.point, (0, 0, 1), atol=1e-9)
    lid = item.vertices[item.vertex_link == item.movable[0]]
    np.testing.assert_allclose(lid[0], (0, 0.5, 1), atol=1e-6)
    assert joint.upper == 1.2


def test_polygons_become_triangles_and_negative_indices_count_from_the_end(tmp_path):
    (tmp_path / "a.obj").write_text(SQUARE + "f -1 -2 -3\n")
    vertices, faces = read_obj(tmp_path / "a.obj")
    assert vertices.shape == (4, 3)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1]]


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (lambda f: (f / "mobility.urdf").unlink(), "not a PartNet-Mobility object"),
        (lambda f: (f / "mobility.urdf").write_text("<robot"), "not a PartNet-Mobility object"),
        (lambda f: (f / "square.obj").unlink(), "square.obj cannot be read"),
        (
            lambda f: (f / "mobility.urdf").write_text(URDF.replace("revolute", "fixed")),
            "no movable",
        ),
        (
            lambda f: (f / "mobility.urdf").write_text(
                URDF.replace('"base"/><child', '"lid"/><child')
            ),
            "loop",
        ),
    ],
)
def test_a_broken_folder_says_what_is_wrong(folder, break_it, words):
    break_it(folder)
    with pytest.raises(ObjectModelError, match=words):
        load_partnet(folder)


def test_the_objects_of_the_demonstrations_are_in_no_split(tmp_path):
    for name in ("8994", "41083", "7167", "7128"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mobility.urdf").write_text("<robot/>")
    train, held_out = split_folders(tmp_path)
    assert [p.name for p in train] == ["7128"]
    assert [p.name for p in held_out] == ["7167"]
    assert not set(NEVER_TRAINED_ON) & set(held_out_ids())


def test_a_folder_without_objects_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"mobility\.urdf"):
        split_folders(tmp_path)


def test_the_held_out_list_covers_the_categories_of_the_reduced_set(partnet_root):
    train, held_out = split_folders(partnet_root / "train")
    assert len(train) > 100
    assert len(held_out) == len(held_out_ids())


@pytest.mark.parametrize("name", ["8994", "41083"])
def test_objects_as_published_are_taken_as_they_are(partnet_root, name):
    item = load_partnet(partnet_root / "raw" / name)
    assert item.movable
    sample = draw_sample(item, Situation.CLOSED, SampleConfig(points=512), np.random.default_rng(0))
    assert sample is not None
    moving = np.linalg.norm(sample.current.flow, axis=1) > 1e-3
    assert 0.02 < moving.mean() < 0.98
