"""What is to be opened: objects, their categories, and the links that may open."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flowbothd_common.errors import ObjectModelError
from flowbothd_evaluation.paper.procedural_folder import make_object
from sim_bridge.objects.model import ObjectModel
from sim_bridge.objects.registry import load_object

PROCEDURAL = "procedural:test"
UNKNOWN = "Unknown"

_CATEGORIES = {"8994": "Door"}
"""Of downloads that come without meta.json and are in no list of the paper's."""

_SPLIT, _OPENABLE = "paper_split.json", "paper_openable_links.json"


@dataclass(frozen=True)
class Case:
    """One object.

    Attributes:
        name: PartNet-Mobility id, or category and number of a procedural object.
        category: As the paper spells it.
        source: Folder of the object, or PROCEDURAL.
        links: Child links of joints with a range, to be opened.
        openable: Those of them that the authors' ground-truth policy could open; all of them
            where nothing is known.
    """

    name: str
    category: str
    source: str
    links: tuple[str, ...]
    openable: tuple[str, ...]

    def load(self) -> ObjectModel:
        """The object.

        Raises:
            ObjectModelError: it cannot be simulated; the message says why.
        """
        if self.source == PROCEDURAL:
            return load_object(make_object(self.name))
        return load_object(self.source)


def find_cases(sources: Sequence[str], ids: Collection[str] = ()) -> list[Case]:
    """Objects in folders (or folders of folders), or procedural ones held out from training.

    Args:
        sources: Folders, `procedural:test`, or `procedural:test:N` with N of each category.
        ids: Only these names; empty = all.

    Raises:
        ObjectModelError: nothing there, a name is missing, or two objects have the same name.
    """
    cases: list[Case] = []
    for source in sources:
        cases += _procedural(source) if source.startswith("procedural") else _in_folder(source)
    names = [case.name for case in cases]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ObjectModelError("several objects have the same name", got=", ".join(twice))
    missing = sorted(set(ids) - set(names))
    if missing:
        raise ObjectModelError(
            "there is no such object", got=", ".join(missing), allowed=", ".join(sorted(names))
        )
    return [case for case in cases if not ids or case.name in ids]


def _in_folder(source: str) -> list[Case]:
    root = Path(source)
    folders = [root] if _urdf(root) else sorted(p for p in _children(root) if _urdf(p))
    if not folders:
        raise ObjectModelError(
            "there are no objects", got=source, allowed="a folder with mobility.urdf, or of such"
        )
    return [_case(folder) for folder in folders]


def _children(root: Path) -> list[Path]:
    return [p for p in root.iterdir() if p.is_dir()] if root.is_dir() else []


def _urdf(folder: Path) -> Path | None:
    found = folder / "mobility.urdf"
    return found if found.is_file() else None


def _case(folder: Path) -> Case:
    meta = _meta(folder)
    links = _movable_links(folder / "mobility.urdf")
    known = meta.get("openable_links", _nearby(folder, _OPENABLE).get(folder.name))
    openable = links if known is None else tuple(link for link in links if link in known)
    category = str(meta.get("model_cat") or _category(folder))
    return Case(folder.name, category, str(folder), links, openable)


def _meta(folder: Path) -> dict[str, Any]:
    """What the object says of itself; downloads differ in what they hold."""
    try:
        found = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _category(folder: Path) -> str:
    for splits in _nearby(folder, _SPLIT).values():
        for category, parts in splits.items():
            if any(folder.name in names for names in parts.values()):
                return str(category)
    return _CATEGORIES.get(folder.name, UNKNOWN)


def _nearby(folder: Path, name: str) -> dict[str, Any]:
    """A file of the paper's protocol, beside the objects or one folder further up."""
    for place in list(folder.resolve().parents)[:2]:
        if (place / name).is_file():
            found: dict[str, Any] = json.loads((place / name).read_text(encoding="utf-8"))
            return found
    return {}


def _movable_links(urdf: Path) -> tuple[str, ...]:
    """Links to open, read without the meshes: an object that lacks one has its records too."""
    try:
        joints = ET.parse(urdf).getroot().findall("joint")
    except ET.ParseError as error:
        raise ObjectModelError("URDF is not valid XML", got=f"{urdf}: {error}") from error
    return tuple(_attribute(j, "child", "link") for j in joints if _may_open(j))


def _may_open(joint: ET.Element) -> bool:
    """Whether a joint has a range, or ought to have one."""
    if joint.get("type") not in ("revolute", "prismatic"):
        return False
    limits = [_attribute(joint, "limit", side) for side in ("lower", "upper")]
    return "" in limits or float(limits[0]) < float(limits[1])


def _attribute(joint: ET.Element, tag: str, name: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get(name, "")


def _procedural(source: str) -> list[Case]:
    from flowbothd_model.data.procedural.catalogue import HELD_OUT_FROM, MAKERS

    kind, _, rest = source.partition(":")
    part, _, count = rest.partition(":")
    if part != "test" or not (count or "1").isdigit() or int(count or "1") < 1:
        raise ObjectModelError(
            "no such set of procedural objects", got=source, allowed=f"{PROCEDURAL}, {kind}:test:N"
        )
    cases = []
    for category in MAKERS:
        for number in range(int(count or "1")):
            name = f"{category}-{HELD_OUT_FROM + number}"
            links = _movable_links(make_object(name) / "mobility.urdf")
            cases.append(Case(name, category, PROCEDURAL, links, links))
    return cases
