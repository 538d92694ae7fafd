"""Width and height of an image from the header of its file, and its wholeness, without decoding it."""

import re
import struct
import zlib

_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_JPEG_END = b"\xff\xd9"
_PNM = re.compile(rb"P[1-6](?:\s++#[^\n]*+)*+\s++(\d{1,9})(?:\s++#[^\n]*+)*+\s++(\d{1,9})\s")
# Of the markers C0 to CF, these three begin no frame.
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE = {0x01, *range(0xD0, 0xD8)}


def header_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels of a PNG, JPEG, BMP or PNM file; None for any other content.

    Source: PNG specification, 5.3 and 11.2.1; ITU-T T.81, annex B; the file headers of BMP and netpbm.
    """
    try:
        if data.startswith(_PNG):
            return struct.unpack_from(">II", data, 16) if data[12:16] == b"IHDR" else None
        if data.startswith(_JPEG):
            return _jpeg_size(data)
        if data.startswith(_BMP):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
    except struct.error:
        return None
    found = _PNM.match(data)
    return (int(found[1]), int(found[2])) if found else None


def is_whole(data: bytes) -> bool:
    """Return True unless a PNG file is cut short or has a wrong checksum, or a JPEG file has no end."""
    if data.startswith(_JPEG):
        return data.rfind(_JPEG_END) > 0
    at = len(_PNG)
    while data.startswith(_PNG):
        if len(data) < at + 12:
            return False
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if len(data) < end + 4 or zlib.crc32(data[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        if kind == b"IEND":
            return True
        at = end + 4
    return True


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Size in the first frame header, found by going from marker to marker."""
    at = len(_JPEG)
    while data[at : at + 1] == b"\xff":
        (marker,) = struct.unpack_from(">B", data, at + 1)
        if marker == 0xFF:  # padding
            at += 1
        elif marker in _BARE:
            at += 2
        elif marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            (length,) = struct.unpack_from(">H", data, at + 2)
            at += 2 + length
    return None
