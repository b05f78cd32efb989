# SPDX-License-Identifier: Apache-2.0
"""Exceptions through a socket: what the gate raised is what its client raises."""

from __future__ import annotations

import pytest

from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    ClarificationError,
    ControllerError,
    EnvironmentFault,
    MalformedError,
    RefusedError,
    StoreError,
)
from authguard_r.core.reasons import Reason
from authguard_r.wire.faults import from_fault, to_fault
from authguard_r.wire.frames import frame, read_body
from authguard_r.wire.messages import Fault, Kind
from fixtures.cases import case

FAMILIES = (
    MalformedError,
    AuthenticityError,
    RefusedError,
    ClarificationError,
    EnvironmentFault,
)
RAISED = [
    MalformedError("m", where="w", reason=Reason.INPUT_TOO_LARGE),
    AuthenticityError("m", where="w", reason=Reason.ROLE_DENIED),
    RefusedError("m", where="w", reason=Reason.BUSY),
    ClarificationError("which one", field="object"),
    StoreError("m", where="w"),
    ControllerError("m"),
    AuthGuardError("m", reason=Reason.INTERNAL_FAULT, where="w"),
]


@pytest.mark.parametrize("error", RAISED, ids=lambda error: type(error).__name__)
def test_an_exception_keeps_its_family_code_words_and_place(error: AuthGuardError) -> None:
    sent = frame(Kind.ERROR, 1, to_fault(error))[9:]
    got = from_fault(read_body(sent, Fault))
    families = [kind for kind in FAMILIES if isinstance(error, kind)] or [EnvironmentFault]
    assert type(got) is families[0]
    assert (got.reason, got.message, got.where) == (error.reason, error.message, error.where)


def test_every_code_without_a_family_has_its_usual_one() -> None:
    for reason in sorted(Reason):
        with case(reason):
            got = from_fault(Fault(code=str(reason), message="m", where="w"))
            assert type(got) in FAMILIES
            assert got.reason is reason


def test_the_usual_family_of_a_code() -> None:
    for code, family in [
        ("MALFORMED", MalformedError),
        ("INPUT_TOO_LARGE", MalformedError),
        ("SIGNATURE_INVALID", AuthenticityError),
        ("ROLE_DENIED", AuthenticityError),
        ("BUSY", EnvironmentFault),
        ("STORE_FULL", EnvironmentFault),
        ("CLARIFICATION_NEEDED", ClarificationError),
        ("KEY_REUSED", RefusedError),
    ]:
        with case(code, family):
            assert type(from_fault(Fault(code=code, message="m", where=""))) is family


def test_a_code_that_is_unknown_here_keeps_its_name() -> None:
    got = from_fault(Fault(code="NEWER", message="m", where="w"))
    assert (type(got), got.reason) == (EnvironmentFault, Reason.INTERNAL_FAULT)
    assert got.message == "`NEWER`: m"
