"""What a written file may replace: an empty file or one of its kind, as the trainer decides."""

from __future__ import annotations

from pathlib import Path

from poegp.errors import Error

MAGIC = b"POEGPARM"
#: What the head of every report contains.
REPORT = b'<meta name="generator" content="poegp trainer'


def is_signed(blob: bytes) -> bool:
    """Whether the header of a model states a signature."""
    return blob.startswith(MAGIC) and len(blob) > 10 and bool(blob[10] & 1)


def check(path: Path, kind: str, new: bytes = b"") -> None:
    """Raise an error if the file at ``path`` is not of this kind, ``"model"`` or ``"report"``, or is a signed model."""
    if not path.is_file():
        return
    there = path.read_bytes()
    if not there or there == new:
        return
    is_own = there.startswith(MAGIC) if kind == "model" else REPORT in there[:2000]
    expected = {"model": "a model without a signature", "report": "a report"}[kind]
    if not is_own:
        found = "a file with other contents"
    elif is_signed(there) and not is_signed(new):
        found = "a signed model"
    else:
        return
    raise Error(
        f"{path}: found {found}, expected a new file, or {expected}; nothing was written: name another file, or delete this one"
    )
