"""Text that a page shows, compared with what a program prints.

`...` matches any text. An integer may differ by a tenth, and a number with a decimal point by one
in its last digit. Spaces and line breaks are equal, so that a page may break long lines.
"""

from __future__ import annotations

import re

NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?![\w.]*\w)")
OFF = 0.1


def differs(shown: str, printed: str, decimals_vary: bool = False) -> str:
    """Return a text on the difference, empty if there is none.

    `decimals_vary`: numbers with a decimal point may have any value, such as times of a machine.
    """
    pieces = [re.escape(NUMBER.sub("#", text)) for text in re.split(r"\s*\.{3}\s*", _tidy(shown))]
    pattern = ".*?".join(pieces).replace(re.escape("#"), f"({NUMBER.pattern})")
    found = re.fullmatch(pattern, _tidy(printed), re.DOTALL)
    if not found:
        return f"shown:\n{shown}\nprinted:\n{printed}"
    numbers = NUMBER.findall(_tidy(shown))
    for claim, value in zip(numbers, found.groups(), strict=True):
        decimals = len(claim.partition(".")[2])
        allowed = max(OFF * abs(float(claim)), 1.001 * 10.0**-decimals if decimals else 0)
        if decimals and decimals_vary:
            continue
        if abs(float(claim) - float(value)) > allowed:
            return f"shown: {claim}, printed: {value}, in\n{printed}"
    return ""


def says(text: str, *words: str) -> bool:
    """Whether a text contains these words in this order, with any text between them."""
    at = 0
    for each in words:
        at = text.find(each, at)
        if at < 0:
            return False
        at += len(each)
    return True


def _tidy(text: str) -> str:
    return " ".join(text.split())
