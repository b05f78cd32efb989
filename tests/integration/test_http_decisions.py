# SPDX-License-Identifier: Apache-2.0
"""A gate over HTTP: what it would decide, what it decided and carried out, and what may be read.

Real gates, real `authguard serve`, a real client. Source: docs/spec/http.md
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fixtures import scenarios
from fixtures.decision_point import (
    BEARER,
    EVALUATION,
    EVALUATIONS,
    GRANTED,
    HIJACKED,
    Served,
    question,
    serving,
    starts,
)
from fixtures.gate_process import PATIENCE_S, RunningGate, until

SCOPE = "DESTINATION_OUT_OF_SCOPE"
ELSEWHERE = question("navigate_to", scenarios.OTHER, destination="Pharmacy")


@pytest.fixture(scope="module")
def house() -> Iterator[tuple[RunningGate, Served]]:
    with RunningGate(robot=True, estimator=True) as gate:
        gate.activate()
        with serving(gate) as served:
            ready = lambda: served.post(EVALUATION, GRANTED).json()["decision"]  # noqa: E731
            until(ready, "the mission's first second")
            yield gate, served


@pytest.fixture
def served(house: tuple[RunningGate, Served]) -> Served:
    return house[1]


@pytest.mark.smoke
def test_a_permit_uses_nothing_up_and_says_so(house: tuple[RunningGate, Served]) -> None:
    gate, served = house
    before, used = len(gate.records()), starts(gate)
    for _ in range(5):  # more often than the grant may be used
        answer = served.post(EVALUATION, GRANTED).json()
        assert answer["decision"] is True, answer
    said = answer["context"]
    assert (said["authoritative"], said["consumes"], said["holds_ms"]) == (False, False, 0)
    assert (said["outcome"], said["reasons"], said["robot"]) == ("accept", [], scenarios.RID)
    assert said["mission"]["mid"] == "deliver-p1"
    assert len(said["action_digest"]) == 43
    assert (len(gate.records()), starts(gate)) == (before, used)


@pytest.mark.smoke
def test_what_the_mission_does_not_grant_is_denied_with_codes_alone(served: Served) -> None:
    answer = served.post(EVALUATION, HIJACKED)
    said = answer.json()
    assert answer.status_code == 200
    assert said["decision"] is False
    assert said["context"]["reasons"][0] == SCOPE
    assert not {"findings", "detail"} & set(said["context"])


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        (ELSEWHERE, "ROBOT_MISMATCH"),
        ({**GRANTED, "resource": {"type": "building", "id": scenarios.RID}}, "ROBOT_MISMATCH"),
        (question("open_every_door"), "TOOL_UNKNOWN"),
        (question("navigate_to", destination="Atlantis"), "NAME_UNKNOWN"),
        (question("navigate_to", destination="Pharmacy", fast=True), "FIELD_UNKNOWN"),
        (question("navigate_to", destination="Pharmacy", speed=1e30), "VALUE_OUT_OF_RANGE"),
    ],
)
def test_what_is_not_this_robots_or_means_nothing_is_denied(
    served: Served, asked: Any, reason: str
) -> None:
    said = served.post(EVALUATION, asked).json()
    assert (said["decision"], said["context"]["reasons"]) == (False, [reason])


CLAIMS = st.dictionaries(
    st.sampled_from(
        ["provenance", "labels", "state", "time", "now", "mission", "standing", "meta", "approvals",
         "role", "source", "decision", "authoritative", "robot", "reasons", "token"]
    ),
    st.recursive(
        st.none() | st.booleans() | st.integers(-9, 9) | st.sampled_from(
            ["operator", "trusted_sensor", "accept", "2099-01-01T00:00:00Z", "pharmacy", "active"]
        ),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
        max_leaves=5,
    ),
)  # fmt: skip


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(context=CLAIMS, subject=CLAIMS, resource=CLAIMS, who=st.text(max_size=20))
def test_l2_what_a_request_claims_changes_nothing(
    house: tuple[RunningGate, Served], context: Any, subject: Any, resource: Any, who: str
) -> None:
    """Forged labels, state, time and standing: the answer is the same, and none of it is echoed."""
    _, served = house
    for plain in (GRANTED, HIJACKED):
        hostile = {
            **plain,
            "subject": {"type": who, "id": who, "properties": subject},
            "resource": {**plain["resource"], "properties": resource},
            "context": context,
        }
        assert told(served, hostile) == told(served, plain)


def told(served: Served, asked: Any) -> Any:
    """Return the answer, but for how many people it takes by now."""
    answer = served.post(EVALUATION, asked)
    assert answer.status_code == 200
    return answer.json()


@pytest.mark.parametrize(
    ("body", "where"),
    [
        (b"", "body"),
        (b"{", "body"),
        (b"[]", "body"),
        (b"\xff{}", "input"),
        (b"\xef\xbb\xbf{}", "body"),
        (b'{"subject": 1, "subject": 2}', "body"),
        (json.dumps(GRANTED).encode()[:-1] + b', "context": {"a": 1, "a": 2}}', "body"),
        (json.dumps(GRANTED).encode()[:-1] + b', "context": {"a": NaN}}', "body"),
        (json.dumps(GRANTED).encode()[:-1] + b', "context": {"a": "\\ud800"}}', "body"),
        (json.dumps({**GRANTED, "context": json.loads("[" * 40 + "]" * 40)}).encode(), "body"),
        (json.dumps({**GRANTED, "labels": {}}).encode(), "body"),
        (json.dumps({**GRANTED, "subject": {"type": "a"}}).encode(), "body.subject"),
        (json.dumps({**GRANTED, "action": {"name": "scan", "propertys": {}}}).encode(),
         "body.action"),
        (json.dumps({**GRANTED, "action": {"name": "scan", "properties": None}}).encode(),
         "body.action.properties"),
    ],
)  # fmt: skip
def test_a_body_with_two_readings_or_none_is_refused_with_its_place(
    served: Served, body: bytes, where: str
) -> None:
    answer = served.post(EVALUATION, body)
    problem = answer.json()
    assert answer.status_code == 400
    assert problem["code"] == "MALFORMED"
    assert problem["where"].startswith(where)


def test_a_body_that_is_too_long_or_no_json_is_not_read(served: Served) -> None:
    long = json.dumps({**GRANTED, "context": {"a": "x" * 300_000}}).encode()
    assert served.post(EVALUATION, long).status_code == 413
    for kind in ("text/plain", "application/json; charset=latin-1", ""):
        answer = served.post(EVALUATION, b"{}", headers={"content-type": kind})
        assert (answer.status_code, answer.json()["where"]) == (415, "content-type")
    packed = {"content-type": "application/json", "content-encoding": "gzip"}
    assert served.post(EVALUATION, b"{}", headers=packed).status_code == 415


def test_a_batch_takes_what_it_leaves_out_from_the_whole(served: Served) -> None:
    asked = {
        **{name: GRANTED[name] for name in ("subject", "resource", "action")},
        "evaluations": [{}, {"action": HIJACKED["action"]}, {"resource": ELSEWHERE["resource"]}],
    }
    answers = served.post(EVALUATIONS, asked).json()["evaluations"]
    assert [answer["decision"] for answer in answers] == [True, False, False]
    assert answers[2]["context"]["reasons"] == ["ROBOT_MISMATCH"]


@pytest.mark.parametrize(
    ("semantic", "decisions"),
    [
        (None, [False, True, False, True]),
        ("execute_all", [False, True, False, True]),
        ("deny_on_first_deny", [False]),
        ("permit_on_first_permit", [False, True]),
    ],
)
def test_a_batch_ends_where_its_semantic_says(
    served: Served, semantic: str | None, decisions: list[bool]
) -> None:
    asked = {"evaluations": [HIJACKED, GRANTED, HIJACKED, GRANTED]}
    if semantic is not None:
        asked["options"] = {"evaluations_semantic": semantic}  # type: ignore[assignment]
    answers = served.post(EVALUATIONS, asked).json()["evaluations"]
    assert [answer["decision"] for answer in answers] == decisions


def test_a_batch_of_nothing_is_the_one_question(served: Served) -> None:
    for asked in (GRANTED, {**GRANTED, "evaluations": []}):
        assert served.post(EVALUATIONS, asked).json()["decision"] is True


@pytest.mark.parametrize(
    ("asked", "where"),
    [
        ({"evaluations": [GRANTED, {**GRANTED, "subject": 1}]}, "body.evaluations[1].subject"),
        ({"evaluations": [GRANTED, {"action": {"name": "scan"}}]}, "evaluations[1].subject"),
        ({"evaluations": [{"subject": GRANTED["subject"], "action": GRANTED["action"]}]},
         "evaluations[0].resource"),
        ({"evaluations": []}, "body.subject"),
        ({"evaluations": [GRANTED] * 101}, "body.evaluations"),
        ({**GRANTED, "options": {"evaluations_semantic": "most"}},
         "body.options.evaluations_semantic"),
        ({**GRANTED, "options": {"evaluation_semantics": "execute_all"}}, "body.options"),
    ],
)  # fmt: skip
def test_a_batch_that_leaves_something_open_is_not_guessed_at(
    served: Served, asked: Any, where: str
) -> None:
    answer = served.post(EVALUATIONS, asked)
    assert (answer.status_code, answer.json()["where"]) == (400, where)


def test_a_requests_number_comes_back_as_it_was(served: Served) -> None:
    for number in ("bfe9eb29-ab87", "any thing: at all\t!", "x" * 256):
        answer = served.post(EVALUATION, GRANTED, headers={"x-request-id": number})
        assert answer.headers["x-request-id"] == number
    assert "x-request-id" not in served.get("/v1/status").headers
    long = served.get("/v1/status", headers={"x-request-id": "x" * 257})
    assert (long.status_code, long.json()["where"]) == (400, "x-request-id")


def test_where_everything_is(served: Served) -> None:
    found = served.get("/.well-known/authzen-configuration").json()
    assert found == {
        "policy_decision_point": served.url,
        "access_evaluation_endpoint": served.url + EVALUATION,
        "access_evaluations_endpoint": served.url + EVALUATIONS,
    }


def test_what_may_be_read(house: tuple[RunningGate, Served]) -> None:
    gate, served = house
    assert served.get("/v1/mission").json()["mission"]["mid"] == "deliver-p1"
    assert served.get("/v1/status").json()["mode"] == "enforce"
    assert "authguard_mission_active 1.0" in served.get("/v1/metrics").text
    assert served.get("/v1/approvals").json() == []
    seen: list[int] = []
    page: dict[str, Any] = {"next": 0}
    while page["next"] is not None:
        page = served.get(f"/v1/records?first={page['next']}&count=2").json()
        seen += [record["seq"] for record in page["records"]]
    assert seen == [record.seq for record in gate.records()]
    assert served.get("/v1/records/1/explanation").json()["what"] == "mission deliver-p1 version 1"


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/v1/records/999999/explanation", 404),
        ("/v1/records/x/explanation", 400),
        ("/v1/records/-1/explanation", 400),
        ("/v1/records?first=1&first=2", 400),
        ("/v1/records?count=0", 400),
        ("/v1/records?count=1001", 400),
        ("/v1/records?first=99999999999999999999", 400),
        ("/v1/records?token=" + "t" * 40, 400),
        ("/v1/approvals/1", 404),
        ("/v1/approvals/0", 400),
        ("/v1/status?verbose=1", 400),
        ("/v1/status/", 404),
        ("/v1/proposals", 404),
    ],
)
def test_what_is_not_there_or_not_asked_for_so(served: Served, path: str, status: int) -> None:
    answer = served.get(path)
    assert answer.status_code == status
    assert set(answer.json()) == {"code", "message", "where"}


def test_nothing_takes_an_order_an_approval_or_a_mission(served: Served) -> None:
    paths = served.get("/openapi.json").json()["paths"]
    posts = [path for path, methods in paths.items() if set(methods) != {"get"}]
    assert posts == [EVALUATION, EVALUATIONS]
    for path in ("/v1/mission", "/v1/approvals", "/v1/approvals/1", "/v1/status", "/v1/records"):
        for method in ("POST", "PUT", "PATCH", "DELETE"):
            with served.client() as client:
                answer = client.request(method, path, json={})
            assert (answer.status_code, answer.json()["code"]) == (405, "METHOD_NOT_ALLOWED")
            assert set(answer.headers["allow"].split(", ")) == {"GET", "HEAD"}
    for path in ("/v1/orders", "/v1/stop", "/v1/missions", "/v1/proposals"):
        assert served.post(path, {}).status_code == 404


@pytest.mark.parametrize(
    ("level", "shown"),
    [("fields", {"field", "reason", "step"}),
     ("full", {"field", "reason", "step", "expected", "got"})],
)  # fmt: skip
def test_more_is_disclosed_only_where_somebody_said_so(
    house: tuple[RunningGate, Served], level: str, shown: set[str]
) -> None:
    with serving(house[0], "--disclosure", level) as served:
        said = served.post(EVALUATION, HIJACKED).json()["context"]
        assert said["findings"][0]["reason"] == SCOPE
        assert set(said["findings"][0]) == shown
        assert ("action" in said.get("detail", {})) is (level == "full")
        for asked, place, text in [
            (question("open_every_door"), "plan[0].tool", "expected a bound tool"),
            (question("navigate_to", destination="Pharmacy", speed="fast"), "plan[0].speed",
             "expected a number"),
            (question("navigate_to", destination=None), "plan[0].destination",
             "expected the name of a region"),
        ]:  # fmt: skip
            unread = served.post(EVALUATION, asked).json()["context"]
            (finding,) = unread["findings"]
            assert (unread["retryable"], set(finding)) == (False, shown), asked
            assert finding["field"] == place
            assert text in finding.get("expected", text)


def test_null_leaves_an_optional_argument_out_and_no_needed_one(served: Served) -> None:
    given = {"destination": "Pharmacy", "speed": None, "via": None, "behavior_tree": None}
    assert served.post(EVALUATION, question("navigate_to", **given)).json()["decision"] is True
    for name in ("destination", "no_such_field"):
        said = served.post(EVALUATION, question("navigate_to", **{**given, name: None})).json()
        assert said["decision"] is False, name


def test_a_thousand_at_once_are_all_answered_rightly(served: Served) -> None:
    asked = [GRANTED, HIJACKED, ELSEWHERE, question("open_every_door")]
    wanted = [[], [SCOPE], ["ROBOT_MISMATCH"], ["TOOL_UNKNOWN"]]

    async def talk() -> list[httpx2.Response]:
        limits = httpx2.Limits(max_connections=200)
        async with httpx2.AsyncClient(
            base_url=served.url, headers=BEARER, timeout=PATIENCE_S, limits=limits
        ) as client:
            return await asyncio.gather(
                *(
                    client.post(EVALUATION, json=asked[n % 4], headers={"x-request-id": f"{n}"})
                    for n in range(1_000)
                )
            )

    for number, answer in enumerate(asyncio.run(talk())):
        said = answer.json()
        assert answer.headers["x-request-id"] == str(number)
        assert said["decision"] is (number % 4 == 0)
        assert said["context"]["reasons"][:1] == wanted[number % 4]


def test_a_planners_words_are_never_in_the_log(served: Served) -> None:
    words = "zebra-quarantine"
    asked = {**question(words, **{words: words}), "context": {words: words}}
    asked["subject"] = {"type": words, "id": words}
    served.post(EVALUATION, asked, headers={"x-request-id": f"{words} said so"})
    served.post(f"/{words}?{words}={words}", {})
    with served.client() as client:
        client.request("ZEBRA-QUARANTINE", "/v1/status", headers={"user-agent": words})
    lines = until(lambda: [r for r in served.requests() if r["method"] == "-"], "the line")
    assert lines[0]["status"] == 405
    assert words not in served.text().lower()
    assert "t" * 40 not in served.text()
