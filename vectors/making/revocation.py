# SPDX-License-Identifier: Apache-2.0
"""Revocation lists: how they are read, whom they refuse when, and which gives way to which.

What is expected is written here by hand, from docs/spec/token.md; nothing is asked of the code.
"""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from functools import cache
from typing import Any

from authguard_r.core.encoding import Tag, b64, digest, encode, unb64
from authguard_r.keys.algorithms import PrivateKey
from making import chains
from making.book import PEOPLE, TOP, ms
from making.chains import authority, kept, leaf, line, operator, serial_of
from unit.keys import chains as knobs
from unit.keys.chains import NOW, TODAY

Json = dict[str, Any]

DAY = timedelta(days=1)
WHERE = "revocations/people"
END_MS = ms(chains.END)
#: The serial number of the leaf of `operator-1`, and that of its authority.
OPERATOR, AUTHORITY = serial_of("leaf operator-1"), serial_of("authority people")


def at(moment: datetime) -> str:
    """Return an instant as lists have it."""
    return moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def payload(**changes: Any) -> bytes:
    """Return what the people's authority signs; what is given is changed."""
    good: Json = {
        "authority": "people",
        "number": 7,
        "issued": at(TODAY - DAY),
        "next_update": at(TODAY + 7 * DAY),
        "serials": [],
    }
    return encode({**good, **changes})


def signed(said: bytes, key: PrivateKey = PEOPLE.key, tag: Tag = Tag.REVOCATION) -> str:
    """Return a list's text."""
    signature = key.sign(unb64(digest(tag, said)))
    return encode({"payload": b64(said), "signature": b64(signature)}).decode() + "\n"


@cache
def second_line() -> dict[str, str]:
    """Return the lists of the second root and its authority, under ML-DSA."""
    top, people = line(chains.M65)
    return {
        "root-2": signed(payload(authority="root-2"), top.key),
        "people-2": signed(payload(authority="people-2"), people.key),
        "people-2, of six days": signed(
            payload(authority="people-2", next_update=at(TODAY + 6 * DAY)), people.key
        ),
    }


def lists() -> dict[str, str]:
    """Return the lists that machines hold or are offered."""
    late, early = at(TODAY - timedelta(seconds=1)), at(TODAY)
    top = TOP.key
    return {
        "root": signed(payload(authority="root"), top),
        "root, which revokes the authority": signed(
            payload(authority="root", serials=[str(AUTHORITY)]), top
        ),
        "root, stale": signed(payload(authority="root", next_update=late), top),
        "root, of six days": signed(
            payload(authority="root", next_update=at(TODAY + 6 * DAY)), top
        ),
        "root, which revokes the leaf's number": signed(
            payload(authority="root", serials=[str(OPERATOR)]), top
        ),
        "people 7": signed(payload()),
        "people 7, which revokes the leaf": signed(payload(serials=[str(OPERATOR)])),
        "people 7, which revokes another": signed(payload(serials=[str(OPERATOR + 1)])),
        "people 7, which revokes the authority's number": signed(payload(serials=[str(AUTHORITY)])),
        "people 7, in its last millisecond": signed(payload(next_update=early)),
        "people 7, stale": signed(payload(next_update=late)),
        "people 7, stale, which revokes the leaf": signed(
            payload(next_update=late, serials=[str(OPERATOR)])
        ),
        "people 7, of sixty days": signed(payload(next_update=at(TODAY + 60 * DAY))),
        "people 6": signed(payload(number=6)),
        "people 8": signed(payload(number=8)),
        "people 8, which revokes the leaf": signed(payload(number=8, serials=[str(OPERATOR)])),
        "people 9, stale": signed(payload(number=9, next_update=late)),
        "people 9, in its last millisecond": signed(payload(number=9, next_update=early)),
        "people 8, signed by the root": signed(payload(number=8), top),
        "people 8, signed by a stranger": signed(payload(number=8), knobs.key("mallory")),
        "machines 8": signed(payload(number=8, authority="machines")),
        "people 8, cut off": signed(payload(number=8))[:-9],
        **second_line(),
    }


def revocation_vectors() -> Json:
    """Lists as they are read, chains under them, and lists that take another one's place."""
    table = chains.Table("revocation.json")
    old = table.before.get("lists", {})
    top, people = line(chains.M65)
    for held, name in (
        (TOP, "root"),
        (PEOPLE, "people"),
        (leaf(PEOPLE), "operator-1"),
        (authority(TOP, name="people, certified anew"), "people, certified anew"),
        (top, "root-2"),
        (people, "people-2"),
        (operator(chains.M65), "operator-1 under the second root"),
    ):
        table.name(held, name)
    return {
        "authorities": {name: name for name in ("root", "root-2", "people", "people-2")},
        "read": reading(),
        "held": held_vectors(),
        "newer": newer_vectors(),
        "lists": {name: kept(text, old.get(name), _said) for name, text in lists().items()},
        "certificates": table.names(),
    }


def _said(text: str) -> object:
    return json.loads(text)["payload"]


def reading() -> list[Json]:
    """How one list is read under a key: what it says, or why it is none."""
    vectors = [
        _read(name, text, {"reason": reason, "where": where}, key)
        for name, (text, reason, where, key) in refused_lists().items()
    ]
    many = sorted(["17", "4", "9" * 49])
    for name, change in (
        ("a list that revokes nothing", {}),
        ("a list that revokes three", {"serials": many}),
        ("the number 0", {"number": 0}),
        ("the largest number", {"number": 2**53 - 1}),
    ):
        expect = {
            "number": change.get("number", 7),
            "issued_ms": ms(TODAY - DAY),
            "next_update_ms": ms(TODAY + 7 * DAY),
            "serials": change.get("serials", []),
        }
        vectors.append(_read(name, signed(payload(**change)), expect))
    good = signed(payload())
    expect = {**vectors[-1]["expect"], "number": 7}
    vectors.append(_read("a list without a newline", good.removesuffix("\n"), expect))
    return vectors


def _read(name: str, text: str, expect: Json, key: str = "people") -> Json:
    return {"name": name, "authority": "people", "key": key, "text": text, "expect": expect}


def refused_lists() -> dict[str, tuple[str, str, str, str]]:
    """Return texts that are no list of `people`: reason, place and under whose key."""
    good = json.loads(signed(payload(serials=["17", "4"])))
    less = {**good, "payload": b64(payload(serials=["17"]))}
    spaced = payload().replace(b'"number":7', b'"number": 7')
    wider = payload().replace(b'"number":7', b'"number":7,"omit":true')
    text = signed(payload())
    forged = "SIGNATURE_INVALID"
    refused: dict[str, tuple[str, str] | tuple[str, str, str]] = {
        "another authority's list under this key": (
            signed(payload(authority="machines")),
            "MALFORMED",
        ),
        "a list that the root signed": (signed(payload(), TOP.key), forged),
        "a list that a stranger signed": (signed(payload(), knobs.key("mallory")), forged),
        "signed as another kind": (signed(payload(), tag=Tag.APPROVAL), forged),
        "a serial number taken out": (encode(less).decode(), forged),
        "no signature": (encode({**good, "signature": ""}).decode(), forged),
        "a signature of one byte more": (
            encode({**good, "signature": b64(unb64(good["signature"]) + b"\0")}).decode(),
            forged,
        ),
        "a payload that is not canonical": (signed(spaced), "NOT_CANONICAL"),
        "a payload with a field more": (signed(wider), "MALFORMED"),
        "a next update that is no instant": (
            signed(payload(next_update="2030-02-30T12:00:00Z")),
            "SCHEMA_INVALID",
        ),
        "an instant in another zone": (
            signed(payload(next_update="2030-06-22T12:00:00+00:00")),
            "MALFORMED",
            f"{WHERE}.next_update",
        ),
        "a number below zero": (signed(payload(number=-1)), "MALFORMED", f"{WHERE}.number"),
        "serial numbers out of order": (signed(payload(serials=["4", "17"])), "MALFORMED"),
        "a serial number twice": (signed(payload(serials=["4", "4"])), "MALFORMED"),
        "a serial number below zero": (signed(payload(serials=["-4"])), "MALFORMED"),
        "the serial number 0": (signed(payload(serials=["0"])), "MALFORMED"),
        "a serial number with a zero before it": (signed(payload(serials=["04"])), "MALFORMED"),
        "a serial number in hexadecimal": (signed(payload(serials=["0x11"])), "MALFORMED"),
        "a serial number of fifty digits": (signed(payload(serials=["9" * 50])), "MALFORMED"),
        "a serial number that is no text": (
            signed(payload(serials=[4])),
            "MALFORMED",
            f"{WHERE}.serials[0]",
        ),
        "nothing": ("", "MALFORMED"),
        "cut off": (text[:-9], "MALFORMED"),
        "two newlines": (text + "\n", "NOT_CANONICAL"),
        "a space": (text.replace('":', '": ', 1), "NOT_CANONICAL"),
        "a field beside": (encode({**good, "alg": "none"}).decode(), "MALFORMED"),
    }
    found = {
        name: (said[0], said[1], said[2] if len(said) > 2 else WHERE, "people")
        for name, said in refused.items()
    }
    found["a list under the root's key"] = (text, forged, WHERE, "root")
    return found


def held_vectors() -> list[Json]:
    """Chains under lists: believed until when, or why not."""
    stale = {"reason": "REVOCATION_STALE", "where": "revocations"}
    revoked = {"reason": "CERTIFICATE_REVOKED", "where": "certificate"}
    week, week_ms = ms(TODAY + 7 * DAY), 7 * 86_400_000

    def until(at_ms: int) -> Json:
        return {"principal": "operator-1", "usable_until_ms": at_ms}

    vectors = [
        _held("fresh lists", until(week)),
        _held("another leaf on the list", until(week), people="people 7, which revokes another"),
        _held("the leaf on the list", revoked, people="people 7, which revokes the leaf"),
        _held("the authority on the root's list", revoked, root="root, which revokes the authority"),
        _held("the leaf's number on the root's list", until(week), root="root, which revokes the leaf's number"),
        _held("the authority's number on its own list", until(week), people="people 7, which revokes the authority's number"),
        _held("a stale list", stale, people="people 7, stale"),
        _held("a stale list of the root", stale, root="root, stale"),
        _held("a stale list that has the leaf", stale, people="people 7, stale, which revokes the leaf"),
        _held("the list's last millisecond", until(NOW.utc_ms), people="people 7, in its last millisecond"),
        _held("no list of the authority", stale, people=None),
        _held("no list of the root", stale, root=None),
        _held("no list at all", stale, root=None, people=None),
        _held("the list of the authority before it was certified anew", stale, chain=["operator-1", "people, certified anew"]),
        _held("the root's list ends first", until(ms(TODAY + 6 * DAY)), root="root, of six days"),
        _held("a list that outlives the root's", until(week), people="people 7, of sixty days"),
        _held("the lists' last millisecond", until(week), now_ms=NOW.utc_ms + week_ms),
        _held("a millisecond later", stale, now_ms=NOW.utc_ms + week_ms + 1),
    ]  # fmt: skip
    both: Json = {"roots": ["root", "root-2"], "also": {"root-2": "root-2", "people-2": "people-2"}}
    second = {**both, "chain": ["operator-1 under the second root", "people-2"]}
    six = {**second, "also": {"root-2": "root-2", "people-2": "people-2, of six days"}}
    gone = {**second, "also": {"people-2": "people-2"}}
    vectors += [
        _held("two roots: the first one's chain", until(week), **both),
        _held("two roots: the second one's chain", until(week), **second),
        _held("two roots: a list that ends first", until(ms(TODAY + 6 * DAY)), **six),
        _held("two roots: no list of the second", stale, **gone),
    ]
    return vectors


def _held(
    name: str,
    expect: Json,
    *,
    root: str | None = "root",
    people: str | None = "people 7",
    also: dict[str, str] | None = None,
    chain: list[str] | None = None,
    roots: list[str] | None = None,
    now_ms: int = NOW.utc_ms,
) -> Json:
    held = {"root": root, "people": people, **(also or {})}
    return {
        "name": name,
        "roots": roots or ["root"],
        "lists": {name: text for name, text in held.items() if text is not None},
        "chain": chain or ["operator-1", "people"],
        "now_ms": now_ms,
        "expect": expect,
    }


def newer_vectors() -> list[Json]:
    """A list that is offered to a machine that has one: what it says, and what holds after it."""
    stale = {"reason": "REVOCATION_STALE", "where": WHERE}
    forged = {"reason": "SIGNATURE_INVALID", "where": WHERE}
    kept_on = {"principal": "operator-1", "usable_until_ms": ms(TODAY + 7 * DAY)}
    last = {"principal": "operator-1", "usable_until_ms": NOW.utc_ms}
    dead = {"reason": "CERTIFICATE_REVOKED", "where": "certificate"}
    revoking = "people 8, which revokes the leaf"
    offers: list[tuple[str, str, str, Json, Json]] = [
        ("the next number", "people 7", "people 8", {"number": 8}, kept_on),
        ("the next number, with the leaf", "people 7", revoking, {"number": 8}, dead),
        ("a number left out", "people 6", "people 8", {"number": 8}, kept_on),
        ("the same list again", "people 7", "people 7", stale, kept_on),
        ("another list of the same number", "people 7", "people 7, which revokes the leaf", stale, kept_on),
        ("an older number", "people 7", "people 6", stale, kept_on),
        ("an older list without the leaf", revoking, "people 7", stale, dead),
        ("the same number without the leaf", revoking, "people 8", stale, dead),
        ("a newer one that is stale", "people 7", "people 9, stale", stale, kept_on),
        ("a newer one in its last millisecond", "people 7", "people 9, in its last millisecond", {"number": 9}, last),
        ("a newer one in the place of a stale one", "people 7, stale", "people 8", {"number": 8}, kept_on),
        ("a newer one that the root signed", "people 7", "people 8, signed by the root", forged, kept_on),
        ("a newer one that a stranger signed", "people 7", "people 8, signed by a stranger", forged, kept_on),
        ("the list of an authority that is not here", "people 7", "machines 8", {"reason": "MALFORMED", "where": "revocations"}, kept_on),
        ("a newer one cut off", "people 7", "people 8, cut off", {"reason": "MALFORMED", "where": "revocations"}, kept_on),
    ]  # fmt: skip
    vectors = []
    for name, held, offered, expect, then in offers:
        vector = _held(name, expect, people=held)
        vectors.append({**vector, "offered": offered, "then": then})
    return vectors
