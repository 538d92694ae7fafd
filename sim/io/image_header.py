"""Width and height of an image from the header of its file, and its wholeness, without decoding it."""

import re
import struct
import zlib
from collections.abc import Callable

_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
_TIFF_SIDES, _TIFF_KINDS = (256, 257), {3: "H", 4: "I"}
_JPEG_END = b"\xff\xd9"
_PNM = re.compile(rb"P[1-6](?:\s++#[^\n]*+)*+\s++(\d{1,9})(?:\s++#[^\n]*+)*+\s++(\d{1,9})\s")
_PNM_MOST = re.compile(rb"P[2356](?:\s++#[^\n]*+)*+(?:\s++\d{1,9}(?:\s++#[^\n]*+)*+){2}\s++(\d{1,5})\s")
# Of the markers C0 to CF, these three begin no frame.
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE = {0x01, *range(0xD0, 0xD8)}


def header_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) in pixels of a PNG, JPEG, BMP, PNM, WebP or TIFF file; None for any other content.

    Source: PNG specification, 5.3 and 11.2.1; ITU-T T.81, annex B; the file headers of BMP and netpbm;
    RFC 9649, 2.5 to 2.7 (WebP); TIFF 6.0, section 2.
    """
    found = [read for mark, read in _FORMS if data.startswith(mark)]
    try:
        return found[0](data) if found else None
    except struct.error:
        return None


def most_of_pnm(data: bytes) -> int:
    """The count that is white in a PGM or PPM file; 0 for any other content."""
    found = _PNM_MOST.match(data)
    return int(found[1]) if found else 0


def is_whole(data: bytes) -> bool:
    """Return True unless a PNG file is cut short or has a wrong checksum, a WebP file is cut short, or a JPEG
    file has no end.
    """
    if data.startswith(_JPEG):
        return data.rfind(_JPEG_END) > 0
    if data.startswith(b"RIFF"):
        return len(data) >= 8 + int.from_bytes(data[4:8], "little")
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


def _png_size(data: bytes) -> tuple[int, int] | None:
    return struct.unpack_from(">II", data, 16) if data[12:16] == b"IHDR" else None


def _bmp_size(data: bytes) -> tuple[int, int]:
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height)


def _pnm_size(data: bytes) -> tuple[int, int] | None:
    found = _PNM.match(data)
    return (int(found[1]), int(found[2])) if found else None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16] if data[8:12] == b"WEBP" else b""
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
        return width + 1, height + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return (width & 0x3FFF, height & 0x3FFF) if kind == b"VP8 " else None


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Of the first image in the file."""
    order = _TIFF[data[:4]]
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    sides = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, entry)
        if tag in _TIFF_SIDES and kind in _TIFF_KINDS:
            (sides[tag],) = struct.unpack_from(order + _TIFF_KINDS[kind], data, entry + 8)
    return tuple(sides[tag] for tag in _TIFF_SIDES) if len(sides) == len(_TIFF_SIDES) else None


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


_FORMS: tuple[tuple[bytes, Callable[[bytes], tuple[int, int] | None]], ...] = (
    (_PNG, _png_size),
    (_JPEG, _jpeg_size),
    (_BMP, _bmp_size),
    (b"RIFF", _webp_size),
    *((mark, _tiff_size) for mark in _TIFF),
    (b"P", _pnm_size),
)
