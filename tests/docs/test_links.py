"""Links of all pages: files that are there, headings that are there, addresses that are whole."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def pages(root: Path) -> list[Path]:
    """Every page of the site, and those of GitHub alone."""
    below = [page for top in ("docs", "sdm", "bench") for page in (root / top).rglob("*.md")]
    return [*root.glob("*.md"), *below]


def text_of(page: Path) -> str:
    return FENCE.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """Names of a page's headings as GitHub and MyST make them."""
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE):
        words = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading).strip().lower()
        found.add(re.sub(r"[^\w\- ]", "", words).replace(" ", "-"))
    return found


def broken(page: Path) -> list[str]:
    """Links of a page that lead nowhere."""
    lost = []
    for target in LINK.findall(text_of(page)):
        if target.startswith(("http:", "https:", "mailto:")):
            address = urlsplit(target)
            if target.startswith("http:") or "." not in address.netloc:
                lost.append(target)
            continue
        name, _, anchor = target.partition("#")
        place = page.parent / name if name else page
        if not place.exists() or (anchor and place.suffix == ".md" and anchor not in anchors(place)):
            lost.append(target)
    return lost


def test_links_lead_somewhere(root):
    found = {str(page.relative_to(root)): lost for page in pages(root) if (lost := broken(page))}
    assert not found


@pytest.mark.parametrize("link", ["gone.md", "here.md#gone", "http://plain.org/x", "https://nowhere/x", "#gone"])
def test_a_broken_link_is_found(link, tmp_path):
    page = tmp_path / "here.md"
    page.write_text(f"# Here\n\n[a](here.md#here), [b](#here), [c](https://example.org), [d]({link})\n")
    assert broken(page) == [link]


def test_pictures_of_pages_are_used(root):
    """A picture that no page shows is deleted, or a page forgot it."""
    shown = {
        (page.parent / target).resolve()
        for page in pages(root)
        for target in LINK.findall(text_of(page))
        if target.endswith(".png")
    }
    drawn = {path.resolve() for path in (root / "docs").rglob("*.png")}
    assert not sorted(path.name for path in drawn - shown)
