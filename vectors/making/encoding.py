# SPDX-License-Identifier: Apache-2.0
"""Encodings: values with their only bytes, and bytes that are nobody's."""

from __future__ import annotations

from typing import Any

from authguard_r.core.encoding import Tag, digest_of, encode
from fixtures import scenarios
from fixtures.decision_cases import plain

Json = dict[str, Any]


def encoding_vectors() -> Json:
    """Values with their only bytes, and bytes that are nobody's."""
    mission = scenarios.mission()
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
            ("the hospital site", Tag.SITE, scenarios.site()),
            ("an action", Tag.ACTION, scenarios.navigate("dock", "pharmacy")),
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
