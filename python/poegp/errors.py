"""What poegp raises.

Arguments that make no sense raise ``ValueError`` or ``TypeError``, files that cannot be written ``OSError``.
"""

from __future__ import annotations


class Error(Exception):
    """A calibration or a correction that is not possible."""


class InputError(Error, ValueError):
    """Something in a file or a table that its author can repair.

    ``line`` counts from 1; of a DataFrame or a dictionary the header is line 1 and the first row line 2. ``column`` counts
    from 1, too. Each is None where the error is about the file as a whole.
    """

    file: str = ""
    line: int | None = None
    column: int | None = None
    column_name: str | None = None
    found: str = ""
    expected: str = ""
    help: str | None = None


class DataRefused(Error):
    """The measurements are not fit for a calibration.

    Each cause stands in brackets at the end of its line. ``calibrate(..., accept=[cause])`` lowers the refusal to a warning.
    """
