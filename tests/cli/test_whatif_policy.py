# SPDX-License-Identifier: Apache-2.0
"""An organization's risk policy in a what-if and on the card: neither says less than a gate."""

from __future__ import annotations

import io
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals.organization import OrganizationPolicy, policy_digest
from authguard_r.cli import call
from authguard_r.core.encoding import Tag
from authguard_r.core.token import sign_object
from authguard_r.enforcement.json_views import action_json
from authguard_r.keys.signer import folder_signer
from fixtures import scenarios

SITE = ["--site", "h/site.yaml"]
DECIDE = ["decide", "--token", "m.token", "--trust", "trust", *SITE, "--state", "s.json"]
REVIEW = ["mission", "review", "m.token", *SITE]
MAY_ASK = "  an organization's risk policy may ask more people: review with --risk-policy"
GO = action_json(scenarios.navigate("dock", "pharmacy", speed=800))


class Shell:
    """One working folder with a signed mission in it, and what the last command printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: str, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call(list(arguments))
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *arguments: str) -> tuple[int, Any]:
        code, out = self(*arguments, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    made = Shell(capsys, monkeypatch)
    assert made("mission", "compile", "h/mission.yaml", *SITE, "--out", "m.json")[0] == 0
    stem = "trust/keys/operator-1"
    keys = ("--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem")
    assert made("mission", "sign", "m.json", *keys, *SITE, "--yes", "--out", "m.token")[0] == 0
    Path("s.json").write_bytes(msgspec.json.encode(scenarios.state().snapshot))
    Path("a.json").write_text(json.dumps(GO))
    return made


def policy(**changes: Any) -> OrganizationPolicy:
    """The mission's own policy with thresholds of the hospital's."""
    plain = {
        "schema": "authguard-r/risk-policy/1",
        "organization": "hospital",
        "version": 7,
        "issued": "2026-01-01T00:00:00Z",
        "policy": msgspec.structs.replace(scenarios.mission().risk_policy, **changes),
    }
    return msgspec.convert(plain, OrganizationPolicy)


def written(value: OrganizationPolicy, *, by: str = "safety-officer-1") -> list[str]:
    token = sign_object(value, Tag.RISK_POLICY, folder_signer(Path("trust"), by))
    Path("policy.token").write_bytes(token)
    return ["--risk-policy", "policy.token"]


STRICT = {"tau_1": 10, "tau_2": 10, "t": 3}


def test_a_stricter_policy_turns_what_the_mission_accepts_into_a_request(shell: Shell) -> None:
    code, alone = shell.json(*DECIDE, "--action", "a.json")
    assert (code, alone["outcome"], alone["risk_policy"]) == (0, "accept", None)
    assert alone["required_approvals"] == 1
    value = policy(**STRICT)
    code, asked = shell.json(*DECIDE, "--action", "a.json", *written(value))
    assert (code, asked["outcome"], asked["authoritative"]) == (3, "request_approval", False)
    assert (asked["reasons"], asked["required_approvals"]) == (["APPROVAL_REQUIRED"], 3)
    assert asked["risk_policy"] == {
        "organization": "hospital",
        "version": 7,
        "digest": policy_digest(value),
        "signer": "safety-officer-1",
    }


def test_people_are_told_whose_policy_counted_and_only_then(shell: Shell) -> None:
    code, text = shell(*DECIDE, "--action", "a.json", *written(policy(**STRICT)))
    assert (code, text.split()[0]) == (3, "REQUEST_APPROVAL")
    assert text.endswith("  decided with the risk policy of hospital, version 7\n")
    assert "risk policy" not in shell(*DECIDE, "--action", "a.json")[1]


def test_a_looser_policy_takes_nothing_away_from_the_missions_own(shell: Shell) -> None:
    draft = Path("h/mission.yaml").read_text().replace("tau_1: 30", "tau_1: 10")
    Path("d.yaml").write_text(draft)
    assert shell("mission", "compile", "d.yaml", *SITE, "--out", "m.json")[0] == 0
    signer = folder_signer(Path("trust"), "operator-1")
    mission = msgspec.json.decode(Path("m.json").read_bytes(), type=type(scenarios.mission()))
    Path("m.token").write_bytes(sign_object(mission, Tag.MISSION, signer))
    loose = written(policy(tau_1=1000, tau_2=1000))
    code, asked = shell.json(*DECIDE, "--action", "a.json", *loose)
    assert (code, asked["required_approvals"]) == (3, 2)
    _, card = shell.json(*REVIEW, "--trust", "trust", *loose)
    line = "    asks 1 further person(s) at its riskiest (10, by the mission's own policy)"
    assert line in card["card"]


def test_every_line_of_a_stream_is_decided_with_the_policy(shell: Shell) -> None:
    lines = [{"id": 1, "action": GO}, {"id": 2}, {"id": 3, "action": GO}]
    stdin = "\n".join(map(json.dumps, lines)).encode()
    code, out = shell(*DECIDE, "--jsonl", *written(policy(**STRICT)), stdin=stdin)
    answers = [json.loads(line) for line in out.splitlines()]
    assert (code, [answer["id"] for answer in answers]) == (0, [1, 2, 3])
    assert [answer.get("outcome") for answer in answers] == [
        "request_approval",
        None,
        "request_approval",
    ]
    assert [answer.get("risk_policy", {}).get("version") for answer in answers] == [7, None, 7]


@pytest.mark.parametrize("asked", [[*DECIDE, "--action", "a.json"], [*REVIEW, "--trust", "trust"]])
def test_a_policy_that_the_wrong_role_signed_is_not_authentic(
    shell: Shell, asked: list[str]
) -> None:
    for by in ("operator-1", "supervisor-1"):
        code, refused = shell.json(*asked, *written(policy(), by=by))
        assert (code, refused["error"]["code"]) == (4, "ROLE_DENIED")
    Path("policy.token").write_bytes(Path("m.token").read_bytes())
    code, refused = shell.json(*asked, "--risk-policy", "policy.token")
    assert (code, refused["error"]["code"]) == (4, "WRONG_KIND")
    Path("policy.token").write_bytes(b"\xff")
    assert shell.json(*asked, "--risk-policy", "policy.token")[0] == 4
    assert shell.json(*asked, "--risk-policy", "nowhere.token")[0] == 5


def test_the_card_names_the_organization_and_asks_whom_the_stricter_asks(shell: Shell) -> None:
    code, alone = shell.json(*REVIEW)
    assert (code, alone["risk_policy"]) == (0, None)
    assert alone["card"].count(MAY_ASK) == 1
    value = policy(**STRICT, roles=("safety_officer",), valid_ms=60_000)
    code, card = shell.json(*REVIEW, "--trust", "trust", *written(value))
    assert (code, card["risk_policy"]["digest"]) == (0, policy_digest(value))
    assert (MAY_ASK in card["card"], card["digest"]) == (False, alone["digest"])
    assert card["card_digest"] != alone["card_digest"]
    ways = [line for line in card["card"] if line.startswith("    asks ")]
    asked = "    asks 2 further person(s) at its riskiest ({}, by the policy of hospital)"
    assert ways == [
        asked.format(10),
        asked.format(20),
        asked.format(10),
        asked.format(15),
        "    asks no second person: its risk is at most 0 by either policy",
        asked.format(10),
    ]
    start = card["card"].index(
        "The risk policy of hospital, version 7: each grant needs the approvals of the stricter one"
    )
    assert card["card"][start + 1 : start + 3] == [
        (
            "  below its risk 10 it asks no one; from 10 a second person, from 10 on 3 people in "
            "all, the signer included"
        ),
        "  of the roles that both name: safety_officer; a request lives 1 min",
    ]


def test_a_card_counts_nobodys_policy_without_a_root_to_hold_it_to(shell: Shell) -> None:
    code, text = shell(*REVIEW, *written(policy()))
    assert (code, "needs --trust" in text) == (2, True)
    code, text = shell(*REVIEW, "--trust", "trust")
    assert (code, "needs --risk-policy" in text) == (2, True)
