"""Real photographs: what is found in the half for tuning, beside peers."""

from __future__ import annotations

from harness import Result, Table
from photographs.evaluate import COLUMNS, MISSING, PICTURES, by_picture, evaluate, of_half

QUICK = 4
"""Pictures of a quick measurement."""

NOTE = (
    "Truth is marked by eye; centres in a picture that was marked twice are 0.55 px apart (RMS). "
    "Found: one to one within half a radius of the part's centre. Angles: modulo symmetry, apart "
    "from one zero for each class of a picture; class: among found parts that got one. Taught: at "
    "most five examples of each class, from the same picture; `not shown` are the other parts. The "
    "half that is held out: python -m photographs.evaluate --held-out"
)


def measure(quick: bool) -> Result:
    """Judge ours and its peers on the photographs for tuning that are there."""
    there, missing = of_half("tuning")
    sentences = []
    if missing:
        sentences.append(f"{missing} of {missing + len(there)} photographs are missing: {MISSING}")
    rows, scores, refused = evaluate(there[:QUICK] if quick else there, figures=not quick)
    sentences += [
        f"{row['method']}: {row['found']} of {row['parts']} parts found, {row['false']} invented"
        for row in rows
        if str(row["method"]).startswith("ours")
    ]
    sentences += [f"not taught: {line}" for line in refused]
    pictures = by_picture(scores)
    return Result(
        [
            Table("photographs", "Photographs for tuning", COLUMNS, rows, NOTE),
            Table("pictures", PICTURES, pictures["columns"], pictures["rows"]),
        ],
        sentences,
    )
