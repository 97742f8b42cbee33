"""OBJ text in the one way of writing it that trimesh reads rightly."""

from __future__ import annotations

import re
from bisect import bisect_left

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
# Lines that trimesh passes over without a word, and what they should be.
INDENTED, TABBED = re.compile(rb"\n[ \t]+"), re.compile(rb"\n(vt|vn|v|f)\t")
ODD = (b"\n ", b"\n\t", b"\nv\t", b"\nvt\t", b"\nvn\t", b"\nf\t")
VERTEX = re.compile(rb"\nv ")
FACE = re.compile(rb"\nf [^\n]*")
BACKWARD_FACE = re.compile(rb"\nf [^\n-]*-")
BACKWARD = re.compile(rb"(?<=[ \t])-\d+")
TEXTURE_AND_NORMAL = re.compile(rb"/[^ \t]*")


def plain_obj(data: bytes) -> bytes:
    """The text of an OBJ file without what trimesh would take for something else; `data` itself if there is none.

    Indented lines and tabs, of which it would lose vertices and faces. And negative numbers of vertices, which the
    format counts back from the face's line and trimesh from the end of the file: where another part follows, faces
    would get that part's vertices.
    """
    text = b"\n" + data.removeprefix(BYTE_ORDER_MARK)
    if b"\r" in text or b"\\" in text:
        text = text.replace(b"\r\n", b"\n").replace(b"\\\n", b"")
    odd = data.startswith(BYTE_ORDER_MARK) or any(line in text for line in ODD)
    if odd:
        text = TABBED.sub(rb"\n\1 ", INDENTED.sub(b"\n", text))
    backward = BACKWARD_FACE.search(text) is not None
    if backward:
        text = _counted_forward(text)
    return text if odd or backward else data


def _counted_forward(text: bytes) -> bytes:
    """Every negative number of a vertex counted from the first one instead."""
    vertices = [vertex.start() for vertex in VERTEX.finditer(text)]

    def forward(face: re.Match[bytes]) -> bytes:
        above = bisect_left(vertices, face.start())

        def number(corner: re.Match[bytes]) -> bytes:
            found = above + 1 + int(corner[0])
            # A vertex that is not there stays one, for the parser to refuse.
            return b"%d" % (found if 0 < found <= above else len(vertices) + 1)

        return BACKWARD.sub(number, face[0])

    return FACE.sub(forward, text)


def without_textures(text: bytes) -> bytes:
    """The text of an OBJ file with the numbers of vertices alone in its faces."""
    return FACE.sub(lambda face: TEXTURE_AND_NORMAL.sub(b"", face[0]), text)
