# SPDX-License-Identifier: Apache-2.0
"""Writes the vectors: inputs with the answers that every implementation must give.

    .venv/bin/python vectors/generate.py

Gate vectors hold one case for each reason alone and one near miss for each; the instant is fixed,
so that the files change only when the language does. Schema: vectors/README.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests")]

import worlds  # noqa: E402

#: 2026-01-15T14:05:00Z, whatever day it is.
worlds.START_MS = 1_768_485_900_000
worlds.NOW = type(worlds.NOW)(worlds.START_MS, 10_000)

import cases  # noqa: E402
from authguard_r.core.encoding import Tag, b64, digest, digest_of, encode  # noqa: E402
from authguard_r.core.errors import MalformedError  # noqa: E402
from authguard_r.core.quantities import Now  # noqa: E402
from authguard_r.core.token import sign_object  # noqa: E402
from authguard_r.normalize import Binder, normalize  # noqa: E402
from cases import ALONE, Case, plain  # noqa: E402

Json = dict[str, Any]


def main() -> None:
    """Write every file."""
    write("encoding.json", encoding_vectors())
    write("gate.json", gate_vectors())
    write("normalize.json", normalize_vectors())
    write("token.json", token_vectors())


def write(name: str, content: Json) -> None:
    """Write one file in a stable form."""
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=True)
    (ROOT / "vectors" / name).write_text(text + "\n")


# encoding


def encoding_vectors() -> Json:
    """Values with their only bytes, and bytes that are nobody's."""
    mission = worlds.mission()
    accepted = [
        {
            "name": name,
            "tag": str(tag),
            "value": plain(value),
            "canonical": encode(value).decode(),
            "digest": digest_of(tag, value),
        }
        for name, tag, value in (
            ("the hospital mission", Tag.MISSION, mission),
            ("the hospital site", Tag.SITE, worlds.site()),
            ("an action", Tag.ACTION, worlds.navigate("dock", "pharmacy")),
        )
    ]
    text = encode(mission).decode()
    refused = {
        "a space": text.replace('":', '": ', 1),
        "a duplicate key": text.replace('{"actions"', '{"mid":"x","actions"', 1),
        "another order": '{"version":1,' + text[1:].replace(',"version":1', "", 1),
        "a float": text.replace('"version":1', '"version":1.0'),
        "an exponent": text.replace('"version":1', '"version":1e0'),
        "a null": text.replace('"version":1', '"supersedes":null,"version":1'),
        "an explicit default": text.replace('"data":{', '"completes":false,"data":{', 1)
        if '"data":{' in text
        else text.replace('"chooser"', '"after":[],"chooser"', 1),
        "an escape": text.replace("deliver-p1", "\\u0064eliver-p1"),
        "an unknown field": text.replace('"version":1', '"version":1,"zone":1'),
        "a truth value for a number": text.replace('"version":1', '"version":true'),
        "not a number": text.replace('"version":1', '"version":NaN'),
        "too large a number": text.replace('"version":1', '"version":9007199254740992'),
        "a byte order mark": "\ufeff" + text,
        "something behind": text + " ",
        "cut off": text[:-1],
        "nothing": "",
    }
    return {
        "accepted": accepted,
        "refused": [
            {"name": name, "kind": "mission", "text": value} for name, value in refused.items()
        ],
    }


# gate


def at_the_end(rnd: Random) -> Case:
    """Exactly t = expiry."""
    case = cases._plain(rnd)
    return replace(case, now=Now(worlds.START_MS + 1_200_000, case.now.mono_ms))


def at_the_beginning(rnd: Random) -> Case:
    """Exactly t = not_before."""
    case = cases._plain(rnd)
    return replace(case, now=Now(worlds.START_MS, case.now.mono_ms))


def at_the_bound(rnd: Random) -> Case:
    """Exactly the largest value of each limit."""
    case = cases._plain(rnd, "pick", "wait")
    params = {limit.parameter: limit.high for limit in case.grant.limits}
    return cases._with_action(case, params=params)


def last_in_window(rnd: Random) -> Case:
    """One release fewer than the rate allows."""
    case = cases._plain(rnd)
    count = case.mission.budgets.rate.count - 1
    return cases._with_standing(case, releases=tuple(case.now.mono_ms - n for n in range(count)))


def last_start(rnd: Random) -> Case:
    """One start fewer than allowed."""
    case = cases._plain(rnd)
    assert case.standing is not None
    use = cases.set_(case.standing.uses["wanted"], starts=case.grant.starts - 1)
    return cases._with_standing(case, uses={**case.standing.uses, "wanted": use})


def last_success(rnd: Random) -> Case:
    """One success fewer than allowed."""
    case = cases._plain(rnd)
    assert case.standing is not None
    use = cases.set_(case.standing.uses["wanted"], successes=case.grant.repeat - 1)
    return cases._with_standing(case, uses={**case.standing.uses, "wanted": use})


def last_of_budget(rnd: Random) -> Case:
    """The last action of the budget."""
    case = cases._plain(rnd)
    return cases._with_standing(case, actions=case.mission.budgets.actions - 1)


def just_fresh(rnd: Random) -> Case:
    """A pose exactly as old as allowed."""
    case = cases._plain(rnd, "pick", "navigate")
    assert case.state is not None
    arrived = case.now.mono_ms - case.state.arrived_mono_ms
    return cases._pose(case, age_ms=case.mission.place_max_age_ms - arrived)


def just_charged(rnd: Random) -> Case:
    """A guard at exactly its value."""
    return cases._with_reading(cases._plain(rnd), rnd, value=100)


def last_moment_of_certificate(rnd: Random) -> Case:
    """The certificate's last millisecond."""
    case = cases._plain(rnd)
    return replace(case, usable_until_ms=case.now.utc_ms)


def last_moment_of_request(rnd: Random) -> Case:
    """The approval request's last millisecond."""
    case = cases._approval_base(rnd)
    assert case.standing is not None
    request = cases.set_(case.standing.requests["wanted"], expires_ms=case.now.utc_ms)
    return cases._with_standing(case, requests={"wanted": request})


NEAR: dict[str, Callable[[Random], Case]] = {
    "EXPIRED": at_the_end,
    "NOT_YET_VALID": at_the_beginning,
    "PARAMETER_OUT_OF_BOUNDS": at_the_bound,
    "RATE_EXCEEDED": last_in_window,
    "STARTS_EXHAUSTED": last_start,
    "REPEAT_EXHAUSTED": last_success,
    "BUDGET_EXCEEDED": last_of_budget,
    "STATE_STALE": just_fresh,
    "GUARD_FALSE": just_charged,
    "CERTIFICATE_EXPIRED": last_moment_of_certificate,
    "APPROVAL_TIMEOUT": last_moment_of_request,
    "APPROVAL_REQUIRED": cases._approval_base,
    "APPROVAL_DENIED": cases._approval_base,
}


def gate_vectors() -> Json:
    """For every reason: a case that has it alone, and a near miss that is accepted."""
    vectors: list[Json] = []
    for reason in sorted(ALONE):
        vectors.append(gate_vector(reason, "alone", ALONE[reason]))
        vectors.append(gate_vector(reason, "near miss", NEAR.get(reason, cases._plain)))
    return {"facts": cases.plain_facts(cases.FACTS), "vectors": vectors}


def gate_vector(reason: str, kind: str, build: Callable[[Random], Case]) -> Json:
    """Return the first case from the seed on that is what its kind says."""
    wanted = [reason] if kind == "alone" else []
    for seed in range(1_000):
        case = build(Random(seed))
        decision = cases.decide_case(case)
        if [str(r) for r in decision.reasons] == wanted:
            return {
                "reason": reason,
                "kind": kind,
                "input": gate_input(case),
                "expect": {
                    "verdict": str(decision.verdict),
                    "reasons": wanted,
                    "grant": None if decision.match is None else decision.match.indexed.grant.id,
                    "required": None if decision.need is None else decision.need.required,
                    "risk": None if decision.need is None else decision.need.risk,
                },
            }
    raise SystemExit(f"no {kind} for {reason}")


def gate_input(case: Case) -> Json:
    """Return the inputs of a decision as plain data; facts only where they differ."""
    state = None
    if case.state is not None:
        state = {
            "snapshot": plain(case.state.snapshot),
            "arrived_mono_ms": case.state.arrived_mono_ms,
        }
    given: Json = {
        "mission": plain(case.mission),
        "digest": digest_of(Tag.MISSION, case.mission),
        "usable_until_ms": case.usable_until_ms,
        "action": plain(case.action),
        "state": state,
        "now": plain(case.now),
        "standing": None if case.standing is None else plain(case.standing),
        "approvals": [plain(item) for item in case.approvals],
    }
    if case.facts is not cases.FACTS:
        given["facts"] = cases.plain_facts(case.facts)
    return given


# normalize


def normalize_vectors() -> Json:
    """Planner texts with the actions they mean, or the refusal and its place."""
    go = '{"tool": "navigate_to", "arguments": {"destination": "%s", "speed": %s}}'
    texts: dict[str, str] = {
        "a place by its name": go % ("Station 101", "0.8"),
        "a place by its id": go % ("station-101", "0.8"),
        "rounded against the planner": go % ("Station 101", "0.8001"),
        "by default": '{"tool": "navigate_to", "arguments": {"destination": "Dock"}}',
        "a call": 'navigate_to(destination="Station 101", speed=0.8)',
        "two calls": 'scan()\nsay(text="hello")',
        "another case": go % ("station 101", "0.8"),
        "a stray space": go % ("Station 101 ", "0.8"),
        "a homoglyph": go % ("St\u0430tion 101", "0.8"),
        "no such place": go % ("Station 999", "0.8"),
        "too fast for the type": go % ("Station 101", "3.0001"),
        "no speed at all": go % ("Station 101", "0"),
        "backwards": go % ("Station 101", "-0.8"),
        "not a number": go % ("Station 101", "NaN"),
        "a number in quotes": go % ("Station 101", '"0.8"'),
        "a truth value": go % ("Station 101", "true"),
        "a refused field": '{"tool": "navigate_to", "arguments": {"destination": "Dock", "behavior_tree": "x"}}',
        "an unknown field": '{"tool": "navigate_to", "arguments": {"destination": "Dock", "mission": "x"}}',
        "a missing field": '{"tool": "navigate_to", "arguments": {"speed": 0.5}}',
        "an unknown tool": '{"tool": "fly", "arguments": {}}',
        "one unknown tool among known ones": "scan()\nfly()",
        "what changes belief": '{"tool": "relocalize", "arguments": {"place": "Dock"}}',
        "a duplicate key": '{"tool": "scan", "tool": "wait", "arguments": {}}',
        "an extra key": '{"tool": "scan", "arguments": {}, "mission": "m"}',
        "an empty plan": '{"plan": []}',
        "prose": "I will go to Station 101.",
        "an expression": "navigate_to(destination=open('x').read())",
    }
    binder = Binder(worlds.site(), worlds.binding())
    vectors = []
    for name, text in texts.items():
        try:
            plan = normalize(text.encode(), binder=binder)
            expect: Json = {"actions": [plain(step.action) for step in plan.steps]}
        except MalformedError as error:
            expect = {"refusal": {"reason": str(error.reason), "where": error.where}}
        vectors.append({"name": name, "raw": text, "expect": expect})
    return {
        "site": "examples/hospital/site.yaml",
        "binding": "examples/hospital/binding.yaml",
        "vectors": vectors,
    }


# tokens


def token_vectors() -> Json:
    """Tokens under a root that lives for a century, and why each is refused."""
    from datetime import UTC, datetime

    from authguard_r.assembly import demo_members, folder_signer
    from authguard_r.keys.setup import init_folder

    begin = datetime.fromtimestamp(worlds.START_MS / 1000, UTC)
    with TemporaryDirectory() as name:
        folder = Path(name) / "trust"
        init_folder(folder, demo_members(worlds.site(), (worlds.RID,)), now=begin, days=36_500)
        operator = folder_signer(folder, "operator-1")
        supervisor = folder_signer(folder, "supervisor-1")
        mission = worlds.mission()
        good = sign_object(mission, Tag.MISSION, operator).decode()
        other = sign_object(mission, Tag.SELECTION, operator).decode()
        foreign = cases.set_(mission, issuer="operator-9")
        unsound = cases.set_(mission, not_before="2030-01-01T00:00:00Z")
        tokens = {
            "authentic": (good, None),
            "signed by a supervisor": (
                sign_object(
                    cases.set_(mission, issuer="supervisor-1"), Tag.MISSION, supervisor
                ).decode(),
                "ROLE_DENIED",
            ),
            "another issuer in the mission": (
                sign_object(foreign, Tag.MISSION, operator).decode(),
                "ISSUER_MISMATCH",
            ),
            "another kind": (other, "WRONG_KIND"),
            "another kind relabeled": (
                other.replace(Tag.SELECTION, Tag.MISSION),
                "SIGNATURE_INVALID",
            ),
            "ends before it begins": (
                sign_object(unsound, Tag.MISSION, operator).decode(),
                "SCHEMA_INVALID",
            ),
            "a space": (good.replace('":', '": ', 1), "NOT_CANONICAL"),
            "cut off": (good[:-10], "MALFORMED"),
        }
        lists = {p.stem: p.read_text() for p in sorted((folder / "revocations").glob("*.json"))}
        authorities = {
            p.stem: p.read_text() for p in sorted((folder / "authorities").glob("*.pem"))
        }
        return {
            "now_ms": worlds.START_MS,
            "root": (folder / "root.pem").read_text(),
            "authorities": authorities,
            "revocations": lists,
            "roles": ["operator", "safety_officer"],
            "vectors": [
                {"name": n, "token": t, "expect": e or "ok"} for n, (t, e) in tokens.items()
            ],
            "raw_digest_of_authentic": digest(Tag.RAW, good.encode()),
            "note": b64(b"keys are made anew at each generation; only the public parts are here"),
        }


if __name__ == "__main__":
    main()
