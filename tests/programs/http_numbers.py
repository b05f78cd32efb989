# SPDX-License-Identifier: Apache-2.0
"""What schemathesis is told of the decision point that a JSON schema cannot say.

A number is refused for how it is spelled: more than 40 characters, or a size beyond 40 digits.
"""

from __future__ import annotations

from typing import Any

import schemathesis

_MOST = 1e40


@schemathesis.hook
def map_body(context: Any, body: Any) -> Any:
    """Return a body without numbers of that kind."""
    return sensible(body)


def sensible(value: Any) -> Any:
    """Return the value with 0 in the place of numbers that are refused for their size."""
    if isinstance(value, dict):
        return {name: sensible(item) for name, item in value.items()}
    if isinstance(value, list):
        return [sensible(item) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value if value == 0 or 1 / _MOST < abs(value) < _MOST else 0
    return value
