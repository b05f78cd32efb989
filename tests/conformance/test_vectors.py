# SPDX-License-Identifier: Apache-2.0
"""The published vectors hold for the gate and for the oracle, and every reason has its pair."""

from __future__ import annotations

import json
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

import authguard_reference as oracle
import authguard_reference.templates as oracle_templates
from authguard_r.audit.deviation import deviation
from authguard_r.core.action import Action
from authguard_r.core.approval import VerifiedApproval, VerifiedPreApproval
from authguard_r.core.decide import decide
from authguard_r.core.encoding import Tag, decode, digest, encode_fast
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.mission import Mission, ProtectedField
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import DECIDED, Reason
from authguard_r.core.standing import Standing
from authguard_r.core.token import index_mission, verify_mission
from authguard_r.enforcement.templates import Instance, Template, covered
from authguard_r.enforcement.templates import require_sound as require_sound_template
from authguard_r.keys.algorithms import require_sound
from authguard_r.keys.revocation import read_list
from authguard_r.keys.trust import ROOT_LISTS, Trust
from authguard_r.normalize import Binder, read_plan
from authguard_r.normalize.dialects import Dialect, ReplyForm, read_reply
from authguard_r.wire import messages
from authguard_r.wire.frames import FrameReader, raw_frame, read_body
from authguard_r.wire.messages import Kind
from fixtures import frame_streams, scenarios
from fixtures.cases import case
from fixtures.vectors import attested, facts_from, load

VECTORS = scenarios.ROOT / "vectors"


GATE = load("gate.json")


def named(vector: dict[str, Any]) -> str:
    return " ".join([vector["reason"], vector["kind"], vector.get("note", "")]).strip()


def test_the_gate_gives_the_published_answer() -> None:
    for vector in GATE["vectors"]:
        with case(named(vector)):
            given, expect = vector["input"], vector["expect"]
            facts = facts_from(given.get("facts", GATE["facts"]))
            mission = msgspec.convert(given["mission"], Mission)
            issuer = Principal(
                id=mission.issuer,
                role=given.get("issuer", {}).get("role", "operator"),
                scope=scenarios.EVERYWHERE,
                usable_until_ms=given["usable_until_ms"],
            )
            standing = given["standing"]
            decision = decide(
                index_mission(mission, given["digest"], issuer),
                msgspec.convert(given["action"], Action),
                state=attested(given["state"], facts),
                facts=facts,
                now=msgspec.convert(given["now"], Now),
                standing=None if standing is None else msgspec.convert(standing, Standing),
                approvals=tuple(msgspec.convert(a, VerifiedApproval) for a in given["approvals"]),
                preapprovals=tuple(
                    msgspec.convert(a, VerifiedPreApproval) for a in given.get("preapprovals", ())
                ),
            )
            assert str(decision.verdict) == expect["verdict"]
            assert [str(reason) for reason in decision.reasons] == expect["reasons"]
            if decision.match is not None:
                assert decision.match.indexed.grant.id == expect["grant"]


def test_the_oracle_gives_the_published_answer() -> None:
    for vector in GATE["vectors"]:
        with case(named(vector)):
            given, expect = dict(vector["input"]), vector["expect"]
            facts = given.pop("facts", GATE["facts"])
            mission = given.pop("mission")
            verdict = oracle.decide(mission, facts=facts, **given)
            assert {name: verdict[name] for name in expect} == expect
            allowed = oracle.authorized(mission, facts=facts, **given)
            assert allowed is (expect["verdict"] == "accept")


def test_every_reason_of_the_gate_has_a_vector_alone_and_a_near_miss() -> None:
    pairs = {(vector["reason"], vector["kind"]) for vector in GATE["vectors"]}
    assert pairs == {(str(r), kind) for r in DECIDED for kind in ("alone", "near miss")}


def test_every_deviation_is_the_published_share() -> None:
    for vector in GATE["deviations"]:
        share = Fraction(*vector["deviation"])
        weights = {ProtectedField(name): n for name, n in vector["weights"].items()}
        assert deviation(map(Reason, vector["reasons"]), weights) == share, vector
        assert oracle.action_deviation(vector["reasons"], vector["weights"]) == share, vector


def test_every_accepted_encoding_is_byte_exact() -> None:
    for vector in load("encoding.json")["accepted"]:
        data = encode_fast(vector["value"])
        assert data.decode() == vector["canonical"]
        assert digest(Tag(vector["tag"]), data) == vector["digest"]


def test_every_other_encoding_is_refused() -> None:
    for vector in load("encoding.json")["refused"]:
        with pytest.raises(MalformedError):
            decode(vector["text"].encode(), Mission)


def test_every_planner_text_means_what_is_published() -> None:
    binder = Binder(scenarios.site(), scenarios.binding())
    for vector in load("normalize.json")["vectors"]:
        try:
            plan = read_plan(vector["raw"].encode(), binder=binder)
            got: Any = {
                "actions": [json.loads(msgspec.json.encode(step.action)) for step in plan.steps]
            }
        except MalformedError as error:
            got = {"refusal": {"reason": str(error.reason), "where": error.where}}
        assert got == vector["expect"], vector["name"]


def test_every_reply_is_read_or_refused_as_published() -> None:
    for vector in load("replies.json")["vectors"]:
        form = msgspec.convert(vector.get("reply"), ReplyForm | None)
        try:
            reading = read_reply(vector["raw"], Dialect.AUTO, form)
            calls = [{"tool": c.tool, "arguments": _spelled(c.arguments)} for c in reading.calls]
            got: Any = {"dialect": reading.dialect, "around": reading.around, "calls": calls}
        except MalformedError as error:
            got = {"refusal": {"reason": str(error.reason), "where": error.where}}
        assert got == vector["expect"], vector["name"]


def _spelled(arguments: Any) -> Any:
    return {n: {"decimal": str(v)} if isinstance(v, Decimal) else v for n, v in arguments.items()}


@pytest.mark.parametrize("under", ["one root", "two roots"])
def test_every_token_is_taken_or_refused_as_published(under: str) -> None:
    content = load("token.json")
    if under == "two roots":
        content |= content["hybrid"]
    roots = x509.load_pem_x509_certificates(content["root"].encode())
    certs = dict(zip(ROOT_LISTS, roots, strict=False))
    for name, pem in content["authorities"].items():
        certs[name] = x509.load_pem_x509_certificate(pem.encode())
    lists = {}
    for name, cert in certs.items():
        key = require_sound(cert.public_key(), where=name)
        data = content["revocations"][name].encode()
        lists[cert.public_bytes(Encoding.DER)] = read_list(data, authority=name, key=key)
    trust, now = Trust(tuple(roots), lists), Now(content["now_ms"], 0)
    for vector in content["vectors"]:
        try:
            verify_mission(
                vector["token"].encode(), verifier=trust, now=now, roles=frozenset(content["roles"])
            )
            got = "ok"
        except AuthGuardError as error:
            got = str(error.reason)
        assert got == vector["expect"], vector["name"]


TEMPLATES = load("template.json")


@pytest.mark.parametrize("vector", TEMPLATES["instances"], ids=lambda v: str(v["name"]))
def test_every_instance_makes_the_published_mission_or_none(vector: dict[str, Any]) -> None:
    template = msgspec.convert(TEMPLATES["template"], Template)
    require_sound_template(template)
    assert digest(Tag.TEMPLATE, encode_fast(template)) == TEMPLATES["digest"]
    instance, expect = msgspec.convert(vector["instance"], Instance), vector["expect"]
    if "refusal" in expect:
        with pytest.raises(AuthGuardError) as error:
            covered(instance, template, TEMPLATES["digest"])
        found = {"reason": str(error.value.reason), "where": error.value.where}
        assert found == expect["refusal"]
        return
    mission = covered(instance, template, TEMPLATES["digest"])
    assert encode_fast(mission) == encode_fast(expect["mission"])
    assert digest(Tag.MISSION, encode_fast(mission)) == expect["digest"]
    again = oracle_templates.expand(TEMPLATES["template"], vector["instance"])
    assert encode_fast(msgspec.convert(again, Mission)) == encode_fast(expect["mission"])


@pytest.mark.parametrize("vector", TEMPLATES["unsound"], ids=lambda v: str(v["name"]))
def test_every_unsound_template_is_refused_where_it_is_published(vector: dict[str, Any]) -> None:
    with pytest.raises(MalformedError) as error:
        require_sound_template(msgspec.convert(vector["template"], Template))
    found = {"reason": str(error.value.reason), "where": error.value.where}
    assert found == vector["expect"]


FRAMES = load("frames.json")


def message_named(name: str) -> type[msgspec.Struct]:
    kind: type[msgspec.Struct] = getattr(messages, name)
    return kind


def test_every_message_is_framed_and_read_as_published() -> None:
    for vector in FRAMES["accepted"]:
        (item,) = FrameReader(lambda _: 1 << 12).feed(bytes.fromhex(vector["hex"]))
        read = read_body(item.body, message_named(vector["message"]))
        assert (item.kind, item.id) == (vector["kind"], vector["id"])
        assert json.loads(item.body) == vector["body"]
        assert raw_frame(item.kind, item.id, item.body).hex() == vector["hex"]
        assert json.loads(msgspec.json.encode(read)) == vector["read"], vector["name"]


def test_every_message_has_a_published_frame() -> None:
    published = {vector["message"] for vector in FRAMES["accepted"]}
    assert {body.__name__ for body in messages.BODY.values()} <= published
    assert set(map(int, Kind)) == {vector["kind"] for vector in FRAMES["accepted"]}


def test_every_body_is_taken_or_refused_as_published() -> None:
    for vector in FRAMES["bodies"]:
        try:
            read = read_body(bytes.fromhex(vector["hex"]), message_named(vector["message"]))
            got: dict[str, Any] = {"read": json.loads(msgspec.json.encode(read))}
        except MalformedError as error:
            got = {"error": str(error.reason), "where": error.where}
        assert got == vector["expect"], vector["name"]


def test_every_stream_is_cut_or_ended_as_published() -> None:
    may = {role: {messages.Kind[name] for name in names} for role, names in FRAMES["may"].items()}
    for vector in FRAMES["streams"]:
        kinds = {Kind.HELLO} if vector["role"] is None else may[vector["role"]]
        bounds = {int(kind): FRAMES["bounds"][kind.name] for kind in kinds}
        reader = FrameReader(lambda kind, bounds=bounds: bounds.get(kind, 0))  # type: ignore[misc]
        chunks = [bytes.fromhex(chunk) for chunk in vector["chunks"]]
        assert frame_streams.cut(reader, chunks) == vector["expect"], vector["name"]


@pytest.mark.complete
def test_the_vectors_are_what_the_generator_writes_save_for_fresh_keys(tmp_path: Path) -> None:
    script = [sys.executable, str(VECTORS / "generate.py"), str(tmp_path)]
    subprocess.run(script, check=True)
    written = {path.name for path in tmp_path.iterdir()}
    # the log's come from a program of their own, and are held to it by their own test
    assert written == {path.name for path in VECTORS.glob("*.json")} - {"log.json", "sealed.json"}
    for name in written - {"token.json"}:
        assert (tmp_path / name).read_text() == (VECTORS / name).read_text(), name
