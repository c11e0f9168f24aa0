"""Zip archives of arrays (npz, skops): their headers are checked before anything is unpacked.

A zip archive can unpack to a thousand times its size, and an array can claim any shape.
https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html and APPNOTE.TXT of PKWARE
describe the headers.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np

from holdfast.core.errors import TooLarge
from holdfast.core.reading import require_file

NOT_AN_ARCHIVE = (
    OSError,
    ValueError,
    EOFError,
    TypeError,
    AttributeError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What zipfile, zlib and numpy raise for no archive, or a damaged, encrypted or pickled one."""
MOST_BYTES = 4 << 30
"""Of all members together: two minutes of a camera, or forty times the largest public data set."""
MOST_RATIO, SMALL_BYTES = 500, 16 << 20
"""Measured numbers shrink to a fifth and drawn pictures to a hundredth of their size.

A small archive of zeros does no harm.
"""
MOST_DIRECTORY_BYTES = 1 << 20
"""The list of members is read as a whole; this is enough for some ten thousand members."""
_END, _END_BYTES, _LONGEST_COMMENT = b"PK\x05\x06", 22, 65535
_LOCATOR_64 = b"PK\x06\x07"
_LOCATOR_64_BYTES = 20


def require_modest_archive(path: Path) -> None:
    """Raise TooLarge where an archive unpacks to too much, or an array claims more than it has.

    Raises DataNotFound for a device or a pipe, one of NOT_AN_ARCHIVE for a file that is no archive.
    """
    require_file(path)
    _require_short_directory(path)
    with zipfile.ZipFile(path) as archive:
        # the sizes that the directory claims; _require_claim compares them with the arrays
        members = archive.infolist()
        unpacked = sum(one.file_size for one in members)
        packed = sum(one.compress_size for one in members)
        if unpacked > MOST_BYTES:
            raise _too_large(f"it would unpack to {unpacked / 1e9:.1f} GB", path)
        # a bomb is far above what measured numbers or drawn pictures can be packed to
        if unpacked > SMALL_BYTES and unpacked > MOST_RATIO * packed:
            raise _too_large(
                f"it would unpack to {unpacked // max(packed, 1)} times its size", path
            )
        # other methods, such as lzma, have no bound on the memory of their decoder
        if not {one.compress_type for one in members} <= {
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        }:
            raise ValueError("a compression method that numpy and skops do not write")
        for member in members:
            if member.filename.endswith(".npy"):
                with archive.open(member) as opened:
                    _require_claim(opened, member, path)


def _require_claim(opened: IO[bytes], member: zipfile.ZipInfo, path: Path) -> None:
    """The shape in an array's header must match the member's size."""
    # newer headers may be 4 GiB long; numpy writes 1.0 for every array of ours
    if np.lib.format.read_magic(opened) != (1, 0):
        raise ValueError("an array header of another version")
    shape, _, dtype = np.lib.format.read_array_header_1_0(opened)
    claimed, there = math.prod(shape) * dtype.itemsize, member.file_size - opened.tell()
    if not dtype.hasobject and claimed != there:
        raise _too_large(
            f"its array {member.filename} claims {claimed} bytes but has {there}", path
        )


def _require_short_directory(path: Path) -> None:
    """Raise TooLarge by the end record, before zipfile reads the list of members into memory."""
    with path.open("rb") as file:
        file.seek(0, 2)
        file.seek(
            max(0, file.tell() - _LONGEST_COMMENT - _END_BYTES - _LOCATOR_64_BYTES)
        )
        tail = file.read()
    # the end record may be followed by a comment, so it is searched from the back
    at = tail.rfind(_END)
    # a zip64 locator stands right before the end record
    long_form = at >= _LOCATOR_64_BYTES and tail[at - _LOCATOR_64_BYTES :].startswith(
        _LOCATOR_64
    )
    if at >= 0 and (
        long_form
        or int.from_bytes(tail[at + 12 : at + 16], "little") > MOST_DIRECTORY_BYTES
    ):
        raise _too_large("its list of members is too long", path)


def _too_large(what: str, path: Path) -> TooLarge:
    """The error of every check here."""
    return TooLarge(
        what,
        where=path,
        cause="a damaged or malicious file",
        next_step="copy the file again",
    )
