# SPDX-License-Identifier: Apache-2.0
"""What the lint can say of a mission before it is signed: codes, findings, and the measures.

A finding is advice about a structure that is whole and legal; whether it is refused is the
signer's rule. Spec page: docs/spec/lint.md
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.facts import SiteFacts
from authguard_r.core.mission import Mission
from authguard_r.enforcement.confirmation import LintCode
from authguard_r.site.model import Site


class Severity(StrEnum):
    """`error`: not signed unless the signer accepts the code by name; `warning`: shown."""

    ERROR = "error"
    WARNING = "warning"


class LintFinding(Struct, frozen=True, kw_only=True):
    """One thing that a signer should look at.

    Args:
        code: its kind.
        where: the place in the mission (`actions[2].guards`).
        message: what is so.
        mend: how to settle it.
        severity: whether `sign` refuses it.
    """

    code: LintCode
    where: str
    message: str
    mend: str
    severity: Severity


class Measures(Struct, frozen=True, kw_only=True):
    """Where the lint draws its lines; a site may draw them elsewhere.

    Args:
        window_factor: a window may be this many times the time that all leases need.
        window_floor_ms: a window up to this is never too long, in milliseconds: people need time
            to sign and start.
        stream_ms: longest lease of a stream, in milliseconds.
        retention_ms: longest window of a mission that stores what it records, in milliseconds.
        forceful_percent: share of the profile's top force from which a grant is forceful.
    """

    window_factor: int = 4
    window_floor_ms: int = 900_000
    stream_ms: int = 5_000
    retention_ms: int = 86_400_000
    forceful_percent: int = 60


class LintScene(Struct, frozen=True, kw_only=True):
    """What every rule reads.

    Args:
        mission: the structure that is to be signed.
        site: the very site that it binds.
        facts: the same site as its gate reads it.
        measures: where the lines are.
        task: the words of the task, one by one, case folded.
    """

    mission: Mission
    site: Site
    facts: SiteFacts
    measures: Measures
    task: tuple[str, ...]


def error(code: LintCode, where: str, message: str, mend: str) -> LintFinding:
    """Return a finding that `sign` refuses."""
    return LintFinding(code=code, where=where, message=message, mend=mend, severity=Severity.ERROR)


def warning(code: LintCode, where: str, message: str, mend: str) -> LintFinding:
    """Return a finding that is shown."""
    return LintFinding(
        code=code, where=where, message=message, mend=mend, severity=Severity.WARNING
    )
