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
import streams  # noqa: E402
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
    write("frames.json", streams.every())
    write("gate.json", gate_vectors())
    write("normalize.json", normalize_vectors())
    write("template.json", template_vectors())
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


def confined(rnd: Random, without: str | None = None, **lost: Any) -> Case:
    """Both approvers reach this robot and the action's places only; the first one lacks one."""
    case = cases._approval_base(rnd)
    places = cases._places(case.action)
    held = cases.Scope(robots=frozenset({worlds.RID}), regions=frozenset(places))
    gone = {getattr(case.action, without)} if without else set()
    first = cases.set_(held, **{"regions": frozenset(places - gone), **lost})
    return cases._rescoped(case, (first, held))


#: Approvers whose certificates confine them: to what the action needs, or to less.
SCOPES: dict[str, Callable[[Random], Case]] = {
    "approvers who reach the robot and the action's places": confined,
    "an approver without the destination": lambda rnd: confined(rnd, "destination"),
    "an approver without the source": lambda rnd: confined(rnd, "source"),
    "an approver without the robot": lambda rnd: confined(rnd, robots=frozenset({worlds.OTHER})),
    "an approver without any region": lambda rnd: confined(rnd, regions=frozenset()),
}


def gate_vectors() -> Json:
    """For every reason: a case that has it alone, and a near miss that is accepted."""
    vectors: list[Json] = []
    for reason in sorted(ALONE):
        vectors.append(gate_vector(reason, "alone", ALONE[reason]))
        vectors.append(gate_vector(reason, "near miss", NEAR.get(reason, cases._plain)))
    for name, build in SCOPES.items():
        lost = name.startswith("an approver without")
        kind, reason = ("alone" if lost else "near miss"), "APPROVAL_REQUIRED"
        vectors.append({**gate_vector(reason, kind, build, confined=True), "note": name})
    return {"facts": cases.plain_facts(cases.FACTS), "vectors": vectors}


def gate_vector(
    reason: str, kind: str, build: Callable[[Random], Case], *, confined: bool = False
) -> Json:
    """Return the first case from the seed on that is what its kind says."""
    wanted = [reason] if kind == "alone" else []
    for seed in range(1_000):
        case = build(Random(seed))
        case = case if confined else cases.everywhere(case)
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


# templates


def template_vectors() -> Json:
    """A template, instances with the missions that they make or why not, and unsound templates."""
    import deliveries
    from authguard_r.core.errors import AuthGuardError
    from authguard_r.templates import covered, require_sound

    template, hashed = deliveries.template(), deliveries.digest()
    made = deliveries.instance()
    fill = made.fill
    asked: dict[str, Json] = {
        "the first values": {},
        "the last values": {"fill": {"package": "package-p2", "station": "station-103"}},
        "a value outside its set": {"fill": {**fill, "station": "plant-room"}},
        "a hole too few": {"fill": {"package": "package-p1"}},
        "a hole too many": {"fill": {**fill, "tool": "gripper"}},
        "another template's": {"template": "A" * 43},
        "a name under another template": {"mid": "delivery.1"},
        "a name with nothing of its own": {"mid": "deliver."},
        "a second too long": {"expiry": "2026-01-15T14:30:01Z"},
        "after the template's end": {
            "not_before": "2027-01-01T00:00:00Z",
            "expiry": "2027-01-01T00:01:00Z",
        },
    }
    instances = []
    for name, changes in asked.items():
        instance = cases.set_(made, **changes)
        try:
            mission = covered(instance, template, hashed)
            digested = digest_of(Tag.MISSION, mission)
            expect: Json = {"mission": plain(mission), "digest": digested}
        except AuthGuardError as error:
            expect = {"refusal": {"reason": str(error.reason), "where": error.where}}
        instances.append({"name": name, "instance": plain(instance), "expect": expect})
    hole = {"hole": "station"}
    unsound = {
        "a hole for a tool": deliveries.edited((("actions", 0, "tool"), hole)),
        "a hole for a whole row": deliveries.edited((("actions", 0, "alternatives", 0), hole)),
        "a place for an object": deliveries.edited(
            (("actions", 1, "alternatives", 0, "object"), hole)
        ),
        "a hole that nobody declared": deliveries.edited((("regions", 0), {"hole": "nowhere"})),
        "a nonce of its own": deliveries.edited((("nonce",), "A" * 22)),
        "a number in the task": deliveries.edited((("task",), ["go", 1])),
    }
    refused = []
    for name, value in unsound.items():
        try:
            require_sound(value)
        except MalformedError as error:
            expect = {"reason": str(error.reason), "where": error.where}
            refused.append({"name": name, "template": plain(value), "expect": expect})
    return {
        "template": plain(template),
        "digest": hashed,
        "instances": instances,
        "unsound": refused,
    }


# tokens


def token_vectors() -> Json:
    """Tokens under roots that live for a century, and why each is refused."""
    from authguard_r.keys.algorithms import Algorithm

    with TemporaryDirectory() as name:
        folder = trust_set_up(Path(name) / "one")
        content = trust_parts(folder, tokens(folder))
        both = trust_set_up(Path(name) / "two", Algorithm.ED25519, Algorithm.ML_DSA_65)
        return {
            **content,
            "hybrid": trust_parts(both, hybrid_tokens(both)),
            "now_ms": worlds.START_MS,
            "roles": ["operator", "safety_officer"],
            "raw_digest_of_authentic": digest(Tag.RAW, content["vectors"][0]["token"].encode()),
            "note": b64(b"keys are made anew at each generation; only the public parts are here"),
        }


def trust_set_up(folder: Path, *algorithms: Any) -> Path:
    """Make a trust folder in which one more operator is confined to a robot and its regions."""
    from datetime import UTC, datetime

    from authguard_r.assembly import demo_members
    from authguard_r.keys.certificate import Role
    from authguard_r.keys.setup import Member, init_folder

    begin = datetime.fromtimestamp(worlds.START_MS / 1000, UTC)
    operator, regions = Role.OPERATOR, worlds.mission().regions
    members = (
        *demo_members(worlds.site(), (worlds.RID,)),
        Member(id="confined", role=operator, robots=(worlds.RID,), regions=regions),
        Member(id="no-robot", role=operator, regions=regions),
        Member(id="another-robot", role=operator, robots=(worlds.OTHER,), regions=regions),
        Member(id="one-region-less", role=operator, robots=(worlds.RID,), regions=regions[1:]),
    )
    known = {"algorithms": algorithms} if algorithms else {}
    init_folder(folder, members, now=begin, days=36_500, **known)
    return folder


def trust_parts(folder: Path, made: dict[str, tuple[str, str | None]]) -> Json:
    """Return the public parts of a trust folder with tokens for them."""
    lists = {p.stem: p.read_text() for p in sorted((folder / "revocations").glob("*.json"))}
    authorities = {p.stem: p.read_text() for p in sorted((folder / "authorities").glob("*.pem"))}
    return {
        "root": (folder / "root.pem").read_text(),
        "authorities": authorities,
        "revocations": lists,
        "vectors": [{"name": n, "token": t, "expect": e or "ok"} for n, (t, e) in made.items()],
    }


def signed_mission(folder: Path, by: str, **changes: Any) -> str:
    """Return the hospital's mission with another issuer, signed by it."""
    from authguard_r.assembly import folder_signer

    mission = cases.set_(worlds.mission(), **{"issuer": by, **changes})
    return sign_object(mission, Tag.MISSION, folder_signer(folder, by)).decode()


def tokens(folder: Path) -> dict[str, tuple[str, str | None]]:
    """Return tokens under one root."""
    from authguard_r.assembly import folder_signer

    operator = folder_signer(folder, "operator-1")
    good = signed_mission(folder, "operator-1")
    other = sign_object(worlds.mission(), Tag.SELECTION, operator).decode()
    late = "2030-01-01T00:00:00Z"
    return {
        "authentic": (good, None),
        "signed by a supervisor": (signed_mission(folder, "supervisor-1"), "ROLE_DENIED"),
        "another issuer in the mission": (
            signed_mission(folder, "operator-1", issuer="operator-9"),
            "ISSUER_MISMATCH",
        ),
        "another kind": (other, "WRONG_KIND"),
        "another kind relabeled": (other.replace(Tag.SELECTION, Tag.MISSION), "SIGNATURE_INVALID"),
        "ends before it begins": (
            signed_mission(folder, "operator-1", not_before=late),
            "SCHEMA_INVALID",
        ),
        "a space": (good.replace('":', '": ', 1), "NOT_CANONICAL"),
        "cut off": (good[:-10], "MALFORMED"),
        "by an operator of this robot and these regions": (
            signed_mission(folder, "confined"),
            None,
        ),
        "by an operator of no robot": (signed_mission(folder, "no-robot"), "SIGNER_OUT_OF_SCOPE"),
        "by an operator of another robot": (
            signed_mission(folder, "another-robot"),
            "SIGNER_OUT_OF_SCOPE",
        ),
        "by an operator of one region less": (
            signed_mission(folder, "one-region-less"),
            "SIGNER_OUT_OF_SCOPE",
        ),
    }


def hybrid_tokens(folder: Path) -> dict[str, tuple[str, str | None]]:
    """Return tokens under two roots, which want a signature under each."""
    from authguard_r.core.encoding import encode_fast
    from authguard_r.core.token import read_token

    good = signed_mission(folder, "operator-1")
    whole = read_token(good.encode())
    first, second = whole.endorsements
    foreign = read_token(signed_mission(folder, "confined", issuer="operator-1").encode())

    def made_of(*endorsements: Any) -> str:
        return encode_fast(cases.set_(whole, endorsements=endorsements)).decode()

    return {
        "authentic": (good, None),
        "the other way round": (made_of(second, first), None),
        "without the second signature": (made_of(first), "SIGNATURE_MISSING"),
        "without the first signature": (made_of(second), "SIGNATURE_MISSING"),
        "the first signature twice": (made_of(first, first), "SIGNATURE_MISSING"),
        "the signatures exchanged": (
            made_of(
                cases.set_(first, signature=second.signature),
                cases.set_(second, signature=first.signature),
            ),
            "SIGNATURE_INVALID",
        ),
        "the second signature of another principal": (
            made_of(first, foreign.endorsements[1]),
            "ISSUER_MISMATCH",
        ),
    }


if __name__ == "__main__":
    main()
