"""Changes of bytes, of what stands in a file's place, of images, archives and ledgers."""

import os
import shutil
import sqlite3
import struct
import warnings
import zipfile
import zlib
from contextlib import closing
from pathlib import Path
from typing import Any

from hostile_changes import UNLESS_OPTIONAL, Change
from hypothesis import strategies as st

_INSERTED = (b"\0", b"\xff\xfe", b"\xed\xa0\x80", b"\n\n", b"\x1b[31m", b"\xe2\x80\xa8", b"9")


def content(draw: Any, path: Path) -> Change:
    size = path.stat().st_size
    at, bit = draw(st.integers(0, max(0, size - 1))), draw(st.integers(0, 7))
    put = draw(st.sampled_from(_INSERTED))
    flip = f"bit {bit} of byte {at} flipped"
    changes = {
        flip: (False, lambda old: old[:at] + bytes([old[at] ^ 1 << bit]) + old[at + 1 :] if old else b"\0"),
        f"cut at byte {at}": (path.suffix == ".png", lambda old: old[:at]),
        f"{put!r} inserted at byte {at}": (False, lambda old: old[:at] + put + old[at:]),
        "other bytes": (True, lambda old: bytes((i * 197 + 13) % 256 for i in range(300))),
        "CRLF": (False, lambda old: old.replace(b"\n", b"\r\n")),
        "byte order mark": (False, lambda old: b"\xef\xbb\xbf" + old),
        "empty": (True, lambda old: b""),
        "8 GiB of zeros appended": (True, None),
    }
    what = draw(st.sampled_from([flip, flip, flip, *changes]))
    strict, change = changes[what]
    if change is None:
        return what, strict, lambda path: os.truncate(path, 8 << 30)
    return what, strict, lambda path: path.write_bytes(change(path.read_bytes()))


def place(draw: Any, path: Path) -> Change:
    twin = draw(st.sampled_from(("{0} (copy){1}", "{0}0{1}", "._{0}{1}", "{0}{1}~")))
    name = twin.format(path.stem, path.suffix)
    changes = {
        "missing": (UNLESS_OPTIONAL, Path.unlink),
        f"a copy named {name}": (True, lambda path: shutil.copy(path, path.with_name(name))),
        "a folder in its place": (True, lambda path: (path.unlink(), path.mkdir())),
        "a FIFO in its place": (True, lambda path: (path.unlink(), os.mkfifo(path))),
        "a link to itself": (True, lambda path: (path.unlink(), path.symlink_to(path.name))),
        "a link to /dev/zero": (True, lambda path: (path.unlink(), path.symlink_to("/dev/zero"))),
        "a link to /dev/full": (True, lambda path: (path.unlink(), path.symlink_to("/dev/full"))),
    }
    what = draw(st.sampled_from(list(changes)))
    return what, *changes[what]


def image(draw: Any, path: Path) -> Change:
    width, height = draw(
        st.sampled_from(((1, 1), (30_000, 30_000), (2**31 - 1, 1), (0, 64), (96, 65), (64, 96), (36, 36)))
    )
    data = path.read_bytes()
    header = data[12:16] + struct.pack(">II", width, height) + data[24:29]
    changed = data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]
    return f"its header says {width}x{height}", True, lambda path: path.write_bytes(changed)


def archive(draw: Any, path: Path) -> Change:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    names = sorted(members)
    what = draw(st.sampled_from(("encrypted", "method", "size", "removed", "twice", "slip", "text", "lzma")))
    pairs = list(members.items())
    if what == "removed":
        pairs = pairs[1:]
    elif what == "twice":
        pairs.append(pairs[0])
    elif what in ("slip", "text"):
        pairs.append(("../../slipped.png" if what == "slip" else "readme.txt", pairs[0][1]))

    def apply(path: Path) -> None:
        method = zipfile.ZIP_LZMA if what == "lzma" else zipfile.ZIP_STORED
        with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(path, "w", method) as archive:
            for name, data in pairs:
                archive.writestr(name, data)
        data = bytearray(path.read_bytes())
        central = data.find(b"PK\x01\x02")
        if what == "encrypted":
            data[central + 8] |= 1
        elif what == "method":
            data[central + 10 : central + 12] = struct.pack("<H", 99)
        elif what == "size":
            data[central + 24 : central + 28] = struct.pack("<I", 3 << 30)
        path.write_bytes(data)

    return f"archive of {len(names)}: {what}", what != "text", apply


_STATEMENTS = (
    "UPDATE rows SET row = replace(row, 'completed', 'banana')",
    "UPDATE rows SET row = NULL",
    "UPDATE rows SET row = replace(row, 'made up', '')",
    "UPDATE rows SET row = x'00ff'",
    "UPDATE rows SET row = '[]', digest = '' WHERE number = 1",
    "UPDATE rows SET key = 'x' || key",
    "UPDATE rows SET digest = NULL",
    "UPDATE errors SET row = NULL",
    "UPDATE errors SET row = replace(row, 'made up', 'x')",
    "DELETE FROM errors",
    "UPDATE sums SET number = 'x'",
    "UPDATE meta SET value = 'x' WHERE key = 'owner'",
    "UPDATE meta SET value = '99' WHERE key = 'form'",
    "DELETE FROM meta WHERE key = 'owner'",
    "DELETE FROM meta WHERE key = 'digest'",
    "DELETE FROM meta",
    "DELETE FROM sums",
    "DROP TABLE rows",
    "DROP TABLE meta",
    "DROP TABLE errors",
    "ALTER TABLE rows RENAME COLUMN row TO line",
    "ALTER TABLE rows DROP COLUMN digest",
    "ALTER TABLE errors DROP COLUMN row",
)  # fmt: skip


def rows(draw: Any, path: Path) -> Change:
    statement = draw(st.sampled_from(_STATEMENTS))

    def apply(path: Path) -> None:
        with closing(sqlite3.connect(path)) as ledger, ledger:
            ledger.execute(statement)

    return statement, True, apply
