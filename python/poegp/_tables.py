"""Tables of pandas as arrays: columns and rows by their names, never by their places alone."""

from __future__ import annotations


def joints(q: object, name: str, dof: int) -> object:
    """The columns of a DataFrame in the order of the joints; anything else as it is.

    Columns are ``q1_rad`` … (``q1_m`` of a sliding joint), in any order, or unnamed: 0, 1, … as pandas numbers them.
    """
    if not hasattr(q, "columns"):
        return q
    columns = list(q.columns)
    # Other units are refused with a message of their own.
    if columns == list(range(len(columns))) or any(str(column).endswith(("_deg", "_mm")) for column in columns):
        return q
    wanted = [next((c for c in (f"q{i}_rad", f"q{i}_m") if c in columns), f"q{i}_rad") for i in range(1, dof + 1)]
    if sorted(map(str, columns)) != sorted(wanted):
        raise ValueError(
            f"{name}: found the columns {', '.join(map(str, columns))}, expected {', '.join(wanted)}, in any order; "
            f"for columns in the order of the joints give {name}.to_numpy()"
        )
    return q[wanted]


def payload(kg: object, q: object, name: str) -> object:
    """The values of a Series in the order of the rows of ``q``; anything else as it is."""
    if not (hasattr(kg, "index") and hasattr(kg, "to_numpy")):
        return kg
    if hasattr(q, "columns"):
        if kg.index.equals(q.index):
            return kg.to_numpy()
        if kg.index.is_unique and q.index.is_unique and len(kg) == len(q) and q.index.isin(kg.index).all():
            return kg.reindex(q.index).to_numpy()
        raise ValueError(f"payload_kg: found a Series with another index than {name}, expected the same rows")
    # The rows of an array have no names: a Series that was put into another order does not fit them.
    if kg.index.is_monotonic_increasing:
        return kg.to_numpy()
    raise ValueError(
        f"payload_kg: found a Series whose index is not ascending, expected the order of the rows of {name}; "
        "if it has that order, give payload_kg.to_numpy()"
    )
