"""A checksum at the end of a file, so that damage is noticed before anything parses the bytes.

    content, newline, "sha256 ", 64 hexadecimal digits, newline

HDF5 and zip files may be followed by further bytes, so a sealed file opens as it is.
"""

import hashlib

MARK = b"\nsha256 "
LENGTH = len(MARK) + 64 + 1


def sealed(content: bytes) -> bytes:
    """The content with its seal."""
    return content + MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def unsealed(data: bytes) -> tuple[bytes, bool]:
    """The content, and whether a seal was there; ValueError where it is broken."""
    content, seal = data[:-LENGTH], data[-LENGTH:]
    if not seal.startswith(MARK):
        return data, False
    if sealed(content) != data:
        raise ValueError("the checksum does not fit the content")
    return content, True
