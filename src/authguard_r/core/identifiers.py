# SPDX-License-Identifier: Apache-2.0
"""The words that signed data may hold.

An identifier is ASCII, lower case and short; the site model maps every external spelling to
exactly one. Nothing here compares by prefix, pattern or similarity: authority checks use `==`.

Spec page: docs/spec/encoding.md#identifiers
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, NewType

from msgspec import Meta

IDENTIFIER = r"\A[a-z0-9][a-z0-9_.:-]{0,63}\Z"
#: 2**53 - 1: the largest integer that every JSON reader holds exactly.
MAX_INTEGER = 9_007_199_254_740_991

if TYPE_CHECKING:  # checkers want plain types below `NewType`; msgspec wants the patterns
    Identifier = str
    _Sha256 = str
else:
    Identifier = Annotated[str, Meta(pattern=IDENTIFIER)]
    _Sha256 = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_-]{43}\Z")]
Integer = Annotated[int, Meta(ge=-MAX_INTEGER, le=MAX_INTEGER)]
Count = Annotated[int, Meta(ge=0, le=MAX_INTEGER)]
Positive = Annotated[int, Meta(ge=1, le=MAX_INTEGER)]

MissionId = NewType("MissionId", Identifier)
RobotId = NewType("RobotId", Identifier)
PrincipalId = NewType("PrincipalId", Identifier)
GrantId = NewType("GrantId", Identifier)
ActionType = NewType("ActionType", Identifier)
ToolId = NewType("ToolId", Identifier)
ObjectId = NewType("ObjectId", Identifier)
RegionId = NewType("RegionId", Identifier)
ParameterId = NewType("ParameterId", Identifier)
VariableId = NewType("VariableId", Identifier)

#: SHA-256 as 43 characters of base64url without padding.
Digest = NewType("Digest", _Sha256)
Base64Url = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_-]*\Z")]
#: RFC 3339, UTC, whole seconds.
Timestamp = Annotated[str, Meta(pattern=r"\A[0-9]{4}(-[0-9]{2}){2}T([0-9]{2}:){2}[0-9]{2}Z\Z")]

_IDENTIFIER = re.compile(IDENTIFIER)


def is_identifier(text: str) -> bool:
    """True when `text` may stand in signed data."""
    return _IDENTIFIER.match(text) is not None
