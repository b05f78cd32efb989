# SPDX-License-Identifier: Apache-2.0
"""Options of attackers, from the words of a command line."""

from __future__ import annotations


def whole(name: str, text: str, *, most: int = 1_000_000) -> int:
    """Return an option that is a whole number above zero.

    Raises:
        ValueError: it is not valid, or above `most`.
    """
    if not text.isascii() or not text.isdigit() or not 0 < int(text[:12]) <= most:
        raise ValueError(f"`{name}` is expected from 1 to {most}, got `{text}`")
    return int(text)
