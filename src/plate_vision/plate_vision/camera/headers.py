"""Size and orientation of a picture file. The size and the orientation are read from the header of
the file, before the pixels are unpacked.

The size is checked first, because a file of 389 kB can unpack to 20000 x 20000 pixels. OpenCV
rotates pictures according to their orientation, but ROS does not rotate them. This project uses the
pixels as the sensor stores them, because `camera_info` and `corners_px` refer to the unrotated
picture.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

ORIENTATION = 274
"""EXIF and TIFF tag for the rotation and mirroring that a viewer applies. The value 1 means no
rotation and no mirroring."""

WIDTH, HEIGHT = 256, 257
"""TIFF tags of the width and the height."""

TRANSFORMS = {
    2: "mirror it", 3: "rotate it by 180 degrees", 4: "flip it", 5: "transpose it",
    6: "rotate it by 90 degrees clockwise", 7: "transpose and rotate it",
    8: "rotate it by 90 degrees anticlockwise",
}  # fmt: skip
"""Action of a viewer for each orientation."""

AS_STORED = "here, as in ROS, pixels are used as stored"
"""End of the warning about a picture that image viewers rotate."""

PNG = b"\x89PNG\r\n\x1a\n"

PNM = re.compile(rb"P[1-6](?:\s+(?:#[^\n]*\n\s*)*)(\d+)(?:\s+(?:#[^\n]*\n\s*)*)(\d+)\s")
"""Header of a PNM file, which may contain comments. The groups are the width and the height."""

PNG_END, JPEG_END = b"IEND\xae\x42\x60\x82", b"\xff\xd9"
"""End marks of complete files. Other bytes can follow, because some drivers append the rest of a
buffer."""

OTHER_KINDS = (
    (0, b"GIF8", "GIF"),
    (4, b"ftypavi", "AVIF"),
    (4, b"ftyp", "HEIF or MP4"),
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"v/1\x01", "OpenEXR"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (0, b"\0\0\0\1", "a video stream (such as H.264)"),
    (0, b"\0\0\1", "a video stream (such as H.264)"),
    (0, b"\x1f\x8b", "gzip"),
    (0, b"\x28\xb5\x2f\xfd", "Zstandard"),
    (0, b"\x04\x22\x4d\x18", "LZ4"),
)
"""First bytes of other files: their position, their value, and the name of the format."""

MAX_ENTRIES = 1000
"""Maximum number of tags that are read from a directory. Files usually have some dozens of tags."""


MAX_PIECES = 20_000
"""Maximum number of chunks that are read from a file. A PNG file of 64 MB has 8,000 chunks. A
malformed file may have millions."""


BROKEN = (struct.error, IndexError, OverflowError)
"""Errors that occur if a file is truncated, or refers to positions beyond its end."""


class Header(NamedTuple):
    """Header of a picture's file.

    Attributes
    ----------
    kind : str
        PNG, JPEG, BMP, PNM, TIFF or WebP.
    width, height : int
        Size of the picture as stored [px].
    orientation : int
        EXIF orientation, 1 to 8.
    offset : int
        Position of the orientation in a TIFF file, or of the frame header in a JPEG file [bytes]. 0
        if a TIFF file contains no orientation.
    """

    kind: str
    width: int
    height: int
    orientation: int = 1
    offset: int = 0


def read_header(content: bytes) -> Header | None:
    """Return the header of a picture's file. The result is None if the kind of file is unknown or
    the file is malformed."""
    try:
        if content.startswith(PNG):
            return _read_png(content)
        if content.startswith(b"\xff\xd8"):
            return _read_jpeg(content)
        if content.startswith(b"RIFF") and content[8:12] == b"WEBP":
            return _read_webp(content)
        if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _read_tiff(content)
        if content.startswith(b"BM"):
            return _read_bmp(content)
        if found := PNM.match(content[:4096]):
            return Header("PNM", int(found[1]), int(found[2]))
    except BROKEN:
        pass
    return None


def name_of_format(content: bytes) -> str:
    """Return the name of a file's format, by the first bytes of the file. The name is empty if the
    format is unknown."""
    header = read_header(content)
    if header is not None:
        return header.kind
    found = (
        name for offset, mark, name in OTHER_KINDS if content[offset : offset + len(mark)] == mark
    )
    return next(found, "")


def is_whole(content: bytes, header: Header) -> bool:
    """Return whether a JPEG, PNG or WebP file is complete. OpenCV fills the missing part of a
    truncated JPEG file with grey. For other formats, OpenCV refuses truncated files."""
    if header.kind == "PNG":
        return PNG_END in content
    if header.kind == "JPEG":  # pixels do not contain the mark, but a preview before them does
        return content.find(JPEG_END, header.offset) >= 0
    if header.kind == "WebP":
        return len(content) >= 8 + int.from_bytes(content[4:8], "little")
    return True


def reset_orientation(content: bytes, header: Header) -> bytes:
    """Return the content of the file with the orientation 1 if it is a TIFF file. OpenCV rotates
    TIFF files even with the flag IMREAD_IGNORE_ORIENTATION. Other files are returned unchanged."""
    if header.kind != "TIFF" or not header.offset:
        return content
    value = b"\1\0" if content[:2] == b"II" else b"\0\1"
    return content[: header.offset] + value + content[header.offset + 2 :]


def orientation_warning(header: Header) -> str:
    """Return a warning about a picture that viewers rotate or mirror. The result is empty for other
    pictures."""
    if header.orientation == 1:
        return ""
    do = TRANSFORMS[header.orientation]
    return f"orientation {header.orientation} is ignored: viewers {do}; {AS_STORED}"


def _read_png(content: bytes) -> Header:
    width, height = struct.unpack_from(">II", content, 16)
    orientation, offset = 1, 8
    for _ in range(MAX_PIECES):
        if offset + 8 > len(content):
            break
        size, kind = struct.unpack_from(">I4s", content, offset)
        if kind == b"eXIf":
            orientation = _read_exif_orientation(content[offset + 8 : offset + 8 + size])
        offset += 12 + size
    return Header("PNG", width, height, orientation)


def _read_jpeg(content: bytes) -> Header | None:
    orientation, offset = 1, 2
    for _ in range(MAX_PIECES):
        if content[offset] != 0xFF:
            break
        mark = content[offset + 1]
        if mark == 0xFF:  # skip a padding byte
            offset += 1
            continue
        # This segment of the JPEG file is the frame header, which contains the image size.
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", content, offset + 5)
            return Header("JPEG", width, height, orientation, offset)
        (size,) = struct.unpack_from(">H", content, offset + 2)
        if mark == 0xE1 and content[offset + 4 : offset + 10] == b"Exif\0\0":
            orientation = _read_exif_orientation(content[offset + 10 : offset + 2 + size])
        offset += 2 + size
    return None


def _read_webp(content: bytes) -> Header | None:
    size: tuple[int, int] | None = None
    orientation, offset = 1, 12
    for _ in range(MAX_PIECES):
        if offset + 8 > len(content):
            break
        kind, length = struct.unpack_from("<4sI", content, offset)
        body = offset + 8
        if kind == b"VP8X":
            sides = content[body + 4 : body + 7], content[body + 7 : body + 10]
            wide, high = (int.from_bytes(side, "little") for side in sides)
            size = wide + 1, high + 1
        elif kind == b"VP8 " and size is None:
            wide, high = struct.unpack_from("<HH", content, body + 6)
            size = wide & 0x3FFF, high & 0x3FFF
        elif kind == b"VP8L" and size is None:
            (bits,) = struct.unpack_from("<I", content, body + 1)
            size = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        elif kind == b"EXIF":
            data = content[body : body + length]
            orientation = _read_exif_orientation(data.removeprefix(b"Exif\0\0"))
        offset = body + length + length % 2
    return None if size is None else Header("WebP", *size, orientation)


def _read_bmp(content: bytes) -> Header:
    (size,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if size == 12 else "<ii", content, 18)
    return Header("BMP", width, abs(height))


def _read_tiff(content: bytes) -> Header | None:
    tags = {tag: (value, offset) for tag, value, offset in _read_tags(content)}
    if WIDTH not in tags or HEIGHT not in tags:
        return None
    orientation, offset = tags.get(ORIENTATION, (1, 0))
    width, height = tags[WIDTH][0], tags[HEIGHT][0]
    return Header("TIFF", width, height, _valid_orientation(orientation), offset)


def _read_exif_orientation(data: bytes) -> int:
    """Return the orientation in EXIF data, which have the form of a TIFF file. The result is 1 if
    the data contain no orientation."""
    try:
        found = (value for tag, value, _ in _read_tags(data) if tag == ORIENTATION)
        return _valid_orientation(next(found, 1))
    except BROKEN:
        return 1


def _valid_orientation(orientation: int) -> int:
    return orientation if orientation in TRANSFORMS else 1


def _read_tags(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the tag, its first value and the position of the value [bytes] for each integer tag in
    the first directory of a TIFF file.

    Raises
    ------
    struct.error
        If the file is truncated.
    """
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return
    (version,) = struct.unpack_from(order + "H", data, 2)
    big = version == 43
    (offset,) = struct.unpack_from(order + ("Q" if big else "I"), data, 8 if big else 4)
    (count,) = struct.unpack_from(order + ("Q" if big else "H"), data, offset)
    offset += 8 if big else 2
    for _ in range(min(count, MAX_ENTRIES)):
        tag, kind = struct.unpack_from(order + "HH", data, offset)
        value = offset + (12 if big else 8)
        form = {3: "H", 4: "I", 16: "Q"}.get(kind)
        if form is not None:
            yield tag, struct.unpack_from(order + form, data, value)[0], value
        offset += 20 if big else 12
