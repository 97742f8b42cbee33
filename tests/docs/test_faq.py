"""Sentences that the page of questions and errors explains are those that the library says."""

from __future__ import annotations

import re


def joined_sources(root) -> str:
    """Sources of the library, with literals that follow each other as one."""
    text = "\n".join(path.read_text() for path in (root / "sdm").rglob("*.py") if "bench" not in path.parts)
    return re.sub(r'"\s*f?"', "", text)


def test_sentences_are_the_librarys(root):
    page = (root / "docs" / "faq.md").read_text().split("## Errors")[1]
    sentences = [cell for cell in re.findall(r"^\| `(.*?)` \|", page, re.MULTILINE) if " " in cell]
    assert len(sentences) > 25
    sources = joined_sources(root)
    pieces = [piece.strip() for sentence in sentences for piece in sentence.split("...") if len(piece.strip()) > 1]
    assert not [piece for piece in pieces if piece not in sources]


def test_every_class_of_errors_is_explained(root):
    from sdm import errors

    page = (root / "docs" / "faq.md").read_text()
    assert all(f"`{name}`" in page for name in vars(errors) if name.endswith("Error"))
