"""Documentation that a reader can follow: links, pages named in messages, paths of the code."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^\s*```.*?^\s*```", re.MULTILINE | re.DOTALL)
NAMED_PAGE = re.compile(r"\bdocs/[\w./-]*\w\.(?:md|png)\b")
NAMED_SOURCE = re.compile(r"`([a-z0-9_]+/[\w./-]+?\.(?:py|yaml|msg|srv|action|md|json))`")
TEXT = {".md", ".py", ".yaml", ".toml", ".yml", ".sh"}


def tracked() -> list[Path]:
    """Return the text files of the repository that git knows or would add."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=30,
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    paths = (ROOT / name for name in listed.stdout.split("\0") if name)
    return [p for p in paths if p.suffix in TEXT and p.is_file() and not p.is_symlink()]


def pages() -> list[Path]:
    """Return the Markdown files of the repository."""
    return [path for path in tracked() if path.suffix == ".md"]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ +(.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


def test_relative_links_resolve():
    broken = []
    for page in pages():
        for link in LINK.findall(FENCE.sub("", page.read_text())):
            if re.match(r"[a-z]+:", link):
                continue
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            if not target.exists() or (anchor and anchor not in anchors(target)):
                broken.append(f"{page.relative_to(ROOT)}: {link}")
    assert not broken, "\n".join(broken)


def test_pages_named_in_the_code_exist():
    """Error messages send people to docs/...: a page that moved would leave them with nothing."""
    missing = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in tracked()
        for name in NAMED_PAGE.findall(path.read_text())
        if path != Path(__file__) and not (ROOT / name).exists()
    ]
    assert not missing, "\n".join(missing)


def test_the_index_lists_every_page_once():
    index = ROOT / "docs" / "index.md"
    listed = [(index.parent / link).resolve() for link in LINK.findall(index.read_text())]
    found = {page for page in pages() if page.is_relative_to(ROOT / "docs")} - {index}
    assert sorted(listed) == sorted(found)


def test_sources_named_in_the_architecture_exist():
    """Every `package/module.py` of ARCHITECTURE.md is a file below src/PACKAGE."""
    missing = []
    names = NAMED_SOURCE.findall((ROOT / "ARCHITECTURE.md").read_text())
    assert names
    for name in names:
        package = name.partition("/")[0]
        places = (ROOT / "src" / package / name, ROOT / "src" / name, ROOT / name)
        if not any(place.exists() for place in places):
            missing.append(name)
    assert not missing, "\n".join(missing)
