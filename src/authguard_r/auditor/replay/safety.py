# SPDX-License-Identifier: Apache-2.0
"""The second gate of a replay: its configuration as the log has it, and its verdict made again.

Spec page: docs/spec/audit-record.md#replay
"""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.audit.record import Record
from authguard_r.core.errors import MalformedError
from authguard_r.safety import SafetyConfig, safety_digest


class SecondGate:
    """What the safety gate is held to, record by record."""

    def __init__(self) -> None:
        #: The configuration in force; None: the log does not have it.
        self.config: dict[str, Any] | None = None
        #: A record so far has committed to one, whether it is still beside it or not.
        self.is_told = False

    def configure(self, record: Record, values: dict[str, Any], named: str) -> None:
        """Take in the configuration that a record brings, if it does.

        Args:
            record: it.
            values: what lies beside it.
            named: the open field that has the configuration's digest.

        Raises:
            MalformedError: it is no safety configuration, or not the one that the record names.
        """
        if "safety" not in record.committed:
            return
        self.is_told, self.config = True, None
        if "safety" not in values:
            return  # it is gone: `audit.missing` says so
        try:
            config = msgspec.convert(values["safety"], SafetyConfig)
        except msgspec.ValidationError as error:
            raise MalformedError(f"no safety configuration: {error}", where="safety") from error
        if safety_digest(config) != record.open.get(named):
            text = "another safety configuration than the record names"
            raise MalformedError(text, where="safety")
        self.config = values["safety"]
