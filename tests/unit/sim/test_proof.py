# SPDX-License-Identifier: Apache-2.0
"""Who a controller believes: the gate of its own robot that answers its own hello, nobody else."""

from __future__ import annotations

import msgspec
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from authguard_r.client.driver import BOUNDS
from authguard_r.client.handshake import Handshake, Speaks
from authguard_r.client.proof import MAX_WELCOME, Conversation, prove
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    MalformedError,
    RefusedError,
)
from authguard_r.core.identifiers import Digest
from authguard_r.wire.frames import frame, raw_frame
from authguard_r.wire.messages import ClientRole, Fault, Kind, Renew, Welcome
from fixtures import scenarios
from fixtures.cases import case
from unit.sim.controller_bench import NONCE, framed, handshake, ticket, welcome


def conversation() -> Conversation:
    return Conversation(handshake(), nonce=NONCE, bounds=BOUNDS, now=lambda: scenarios.NOW)


def test_the_gate_of_this_robot_is_believed() -> None:
    proven = prove(welcome(), handshake(), nonce=NONCE, now=scenarios.NOW)
    assert proven.welcome.robot == scenarios.RID


def test_nobody_else_is_believed() -> None:
    for by, changes in [
        (None, {}),
        (f"gate-{scenarios.OTHER}", {}),
        (f"gate-{scenarios.OTHER}", {"robot": scenarios.OTHER}),
        (f"gate-{scenarios.OTHER}", {"robot": scenarios.OTHER, "claims": scenarios.OTHER}),
        ("operator-1", {}),
        ("site-authority-1", {}),
        (f"estimator-{scenarios.RID}", {}),
        (f"gate-{scenarios.RID}", {"nonce": b64(bytes(32))}),
        (f"gate-{scenarios.RID}", {"role": ClientRole.ESTIMATOR}),
        (f"gate-{scenarios.RID}", {"robot": scenarios.OTHER}),
        (f"gate-{scenarios.RID}", {"claims": scenarios.OTHER}),
        (f"gate-{scenarios.RID}", {"tag": Tag.STATE}),
        (f"gate-{scenarios.RID}", {"protocol": "authguard-r/gate/2"}),
    ]:
        with case(by, changes), pytest.raises((AuthenticityError, MalformedError)):
            prove(welcome(by, **changes), handshake(), nonce=NONCE, now=scenarios.NOW)


WORDS = {"site": Digest("s" * 43), "binding": Digest("b" * 43)}


def test_a_gate_that_speaks_the_same_words_is_taken() -> None:
    asks = replace(handshake(), speaks=Speaks(**WORDS))
    assert (
        prove(welcome(**WORDS), asks, nonce=NONCE, now=scenarios.NOW).welcome.site == WORDS["site"]
    )


@pytest.mark.parametrize(
    ("word", "said"),
    [("site", "x" * 43), ("site", None), ("binding", "x" * 43), ("binding", UNSET)],
)
def test_a_gate_that_speaks_other_words_is_not_taken(word: str, said: object) -> None:
    """What it releases would be rebuilt as something that nobody decided."""
    asks = replace(handshake(), speaks=Speaks(**WORDS))
    with pytest.raises(RefusedError, match="SITE_MISMATCH") as refused:
        prove(welcome(**{**WORDS, word: said}), asks, nonce=NONCE, now=scenarios.NOW)
    assert refused.value.where == f"welcome.{word}"


def test_a_gate_that_refuses_says_why() -> None:
    fault = framed(Kind.ERROR, Fault(code="ROLE_DENIED", message="no", where="peer"))
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        prove(fault, handshake(), nonce=NONCE, now=scenarios.NOW)


def test_an_order_instead_of_a_welcome_is_no_proof() -> None:
    with pytest.raises(MalformedError):
        prove(framed(Kind.HALT, {}), handshake(), nonce=NONCE, now=scenarios.NOW)


def test_a_proof_that_nobody_can_check_is_not_asked_for() -> None:
    blind = Handshake(role=ClientRole.CONTROLLER, client="c", robot=scenarios.RID)
    with pytest.raises(RuntimeError):
        prove(welcome(), blind, nonce=NONCE, now=scenarios.NOW)


def test_what_comes_with_the_welcome_is_heard_after_it() -> None:
    said = raw_frame(Kind.WELCOME, 0, welcome().body)
    both = said + frame(Kind.RENEW, 0, Renew(ticket=ticket(1)))
    talk = conversation()
    (heard,) = talk.receive(both)
    assert (heard.kind, talk.proven is not None) == (Kind.RENEW, True)
    talk = conversation()
    assert [item.kind for n in range(len(both)) for item in talk.receive(both[n : n + 1])] == [
        Kind.RENEW
    ]


def test_orders_with_a_false_welcome_never_come_out() -> None:
    talk = conversation()
    said = raw_frame(Kind.WELCOME, 0, welcome("operator-1").body)
    with pytest.raises(AuthenticityError):
        talk.receive(said + frame(Kind.HALT, 0, {}))
    assert talk.proven is None


@pytest.mark.parametrize("kind", [Kind.STOP, Kind.HELLO, Kind.PROPOSE, 200])
def test_a_kind_that_no_gate_sends_ends_the_conversation(kind: int) -> None:
    talk = conversation()
    talk.receive(raw_frame(Kind.WELCOME, 0, welcome().body))
    with pytest.raises(MalformedError):
        talk.receive(raw_frame(kind, 0, b"{}"))  # type: ignore[arg-type]


def test_a_body_that_is_too_long_is_not_read() -> None:
    with pytest.raises(MalformedError, match="INPUT_TOO_LARGE"):
        conversation().receive(raw_frame(Kind.WELCOME, 0, b"x" * (MAX_WELCOME + 1))[:9])


def test_a_second_welcome_is_not_read() -> None:
    talk = conversation()
    talk.receive(raw_frame(Kind.WELCOME, 0, welcome().body))
    with pytest.raises(MalformedError):
        talk.receive(raw_frame(Kind.WELCOME, 0, welcome().body))


def test_the_first_message_asks_for_a_proof() -> None:
    said = msgspec.json.decode(conversation().hello()[9:])
    assert (said["role"], said["nonce"]) == ("controller", NONCE)
    assert Welcome.__struct_config__.forbid_unknown_fields
