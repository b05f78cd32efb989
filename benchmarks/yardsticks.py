# SPDX-License-Identifier: Apache-2.0
"""What others need for the same answer: Cedar, Biscuit, a bare signature, a bare insert.

The policies are written from the signed mission, so that they say what the gate is asked. They
start from typed values: reading the planner's bytes, labels, risk, findings and the hash of the
action are the gate's alone, which favors the yardsticks.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import apsw
import cedarpy
import msgspec
from biscuit_auth import (
    AuthorizationError,
    AuthorizerBuilder,
    Biscuit,
    BiscuitBuilder,
    Fact,
    KeyPair,
    Policy,
)
from cryptography import x509

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, digest, unb64
from authguard_r.core.mission import Comparison, Grant, Guard, Row
from authguard_r.core.provenance import Label
from authguard_r.core.standing import use_of
from authguard_r.core.token import read_token
from authguard_r.keys.trust import Trust
from scene import GRANT, Scene

Check = Callable[[Action], bool]
_SPELLED = {
    Comparison.EQ: "==",
    Comparison.NE: "!=",
    Comparison.LT: "<",
    Comparison.LE: "<=",
    Comparison.GT: ">",
    Comparison.GE: ">=",
}
_JSON = msgspec.json.Encoder()


def values(scene: Scene, action: Action) -> dict[str, Any]:
    """Return what the rule reads of action, state, registry and clock."""
    state, standing, now = scene.state, scene.standing, scene.now
    readings, pose, arrived = state.snapshot.readings, state.snapshot.pose, state.arrived_mono_ms
    if pose is None:
        raise RuntimeError("the scene has no pose")
    use = use_of(standing, GRANT)  # type: ignore[arg-type]
    battery, holding = readings["battery_permille"], readings["holding"]  # type: ignore[index]
    return {
        "tool": action.tool,
        "source": action.source,
        "route": action.route,
        "speed_mm_s": action.params["speed_mm_s"],  # type: ignore[index]
        "robot": state.snapshot.robot,
        "place": next(iter(state.place)),
        "place_age": pose.age_ms + now.mono_ms - arrived,
        "place_label": pose.label,
        "battery_permille": battery.value,
        "battery_permille_age": battery.age_ms + now.mono_ms - arrived,
        "battery_permille_label": battery.label,
        "holding": holding.value,
        "holding_age": holding.age_ms + now.mono_ms - arrived,
        "holding_label": holding.label,
        "now": now.utc_ms,
        "status": standing.status,
        "mission": standing.digest,
        "site": scene.facts.digest,
        "profile": scene.facts.robot.profile,
        "successes": use.successes,
        "starts": use.starts,
        "actions": standing.actions,
        "motion_ms": standing.spent.motion_ms,
        "recent": len(standing.releases),
        "picked": use_of(standing, "pick-p1").last_success,  # type: ignore[arg-type]
        "gone": use.last_success,
    }


def conditions(scene: Scene, grant: Grant, row: Row) -> list[str]:
    """Return the conditions of one signed row, each as a Cedar and Biscuit expression over values.

    `{name}` stands for a value. What principal, action and resource say is not repeated.
    """
    verified = scene.verified
    mission, budgets = verified.mission, verified.mission.budgets
    found = [
        f'{{mission}} == "{verified.digest}"',
        '{status} == "active"',
        f"{{now}} >= {verified.not_before_ms}",
        f"{{now}} <= {verified.expiry_ms}",
        f"{{now}} <= {verified.issuer.usable_until_ms}",
        f'{{site}} == "{mission.site}"',
        f'{{profile}} == "{mission.profile}"',
        f'{{robot}} == "{mission.rid}"',
        f'{{tool}} == "{grant.tool}"',
        f'{{place_label}} == "{Label.TRUSTED_SENSOR}"',
        f"{{place_age}} <= {mission.place_max_age_ms}",
        f"{{successes}} < {grant.repeat}",
        f"{{starts}} < {grant.starts}",
        f"{{recent}} < {budgets.rate.count}",
        f"{{actions}} < {budgets.actions}",
        f"{{motion_ms}} <= {budgets.motion_ms - grant.max_ms}",
    ]
    if row.source is not None:
        found += [f'{{source}} == "{row.source}"', f'{{place}} == "{row.source}"']
    for limit in grant.limits:
        if limit.parameter == "speed_mm_s":
            found += [f"{{speed_mm_s}} >= {limit.low}", f"{{speed_mm_s}} <= {limit.high}"]
    for guard in (*mission.guards, *grant.guards):
        found += _guard(guard)
    found += ["{picked} > {gone}" for before in grant.after if before == "pick-p1"]
    return found


def _guard(guard: Guard) -> list[str]:
    value = f'"{guard.value}"' if isinstance(guard.value, str) else str(guard.value).lower()
    return [
        f"{{{guard.variable}}} {_SPELLED[guard.comparison]} {value}",
        f"{{{guard.variable}_age}} <= {guard.max_age_ms}",
        f'{{{guard.variable}_label}} == "{Label.TRUSTED_SENSOR}"',
    ]


def _named(expressions: list[str], spell: str) -> list[str]:
    names = {name: spell.format(name) for text in expressions for name in _names(text)}
    return [text.format_map(names) for text in expressions]


def _names(text: str) -> list[str]:
    return [part.split("}")[0] for part in text.split("{")[1:]]


def _permit(scene: Scene, grant: Grant, row: Row) -> str:
    told = _named(conditions(scene, grant, row), "context.{}")
    regions = ", ".join(f'"{region}"' for region in row.regions)
    told.append(f"[{regions}].containsAll(context.route)")
    where = f' == Region::"{row.destination}"' if row.destination is not None else ""
    return (
        f'permit(principal == Robot::"{scene.verified.mission.rid}", '
        f'action == Action::"{grant.type}", resource{where}) when {{ {" && ".join(told)} }};'
    )


def _grant(scene: Scene) -> Grant:
    return next(g for g in scene.verified.mission.actions if g.id == GRANT)


class Cedar:
    """Cedar with parsed policies and entities, asked in its fastest documented form.

    That form gives principal, action and resource as type and id, and the context as text.

    Args:
        scene: whose mission is written as policies.
        whole: one policy for each row of each navigation grant; else only the row that is asked
            about, which is less than the gate looks at.
        text: write the context with the fastest encoder there is; else as a `dict`, which the
            documentation prefers and the library writes.
    """

    def __init__(self, scene: Scene, *, whole: bool = False, text: bool = True) -> None:
        mission = scene.verified.mission
        rows = [
            (grant, row)
            for grant in mission.actions
            if grant.type == "navigate" and (whole or grant.id == GRANT)
            for row in (grant.alternatives if whole else grant.alternatives[:1])
        ]
        # principal, action, resource and route
        self.conditions = len(conditions(scene, *rows[-1])) + 4
        self._policies = cedarpy.PolicySet.from_str("\n".join(_permit(scene, *r) for r in rows))
        self._entities = cedarpy.Entities.from_json_str("[]")
        self._rid = mission.rid
        self._text = text

    def asker(self, context: dict[str, Any]) -> Check:
        """Return the check; the context's values are at hand, its spelling is not."""
        policies, entities, rid, text = self._policies, self._entities, self._rid, self._text

        def ask(action: Action) -> bool:
            request = {
                "principal": {"type": "Robot", "id": rid},
                "action": {"type": "Action", "id": action.type},
                "resource": {"type": "Region", "id": action.destination},
                "context": _JSON.encode(context).decode() if text else context,
            }
            return cedarpy.is_authorized(request, policies, entities).allowed

        return ask


def cedar_five(scene: Scene) -> Check:
    """Return the least that could be called this rule: two bounds and four values."""
    state, now, mission = scene.state, scene.now, scene.verified.mission
    grant = _grant(scene)
    limit, row = grant.limits[0], grant.alternatives[0]
    policies = cedarpy.PolicySet.from_str(
        f'permit(principal == Robot::"{mission.rid}", action == Action::"{grant.type}", '
        f'resource == Region::"{row.destination}") when {{ context.source == "{row.source}" && '
        f"context.speed >= {limit.low} && context.speed <= {limit.high} && "
        f'context.battery >= 200 && context.holding == "package-p1" && '
        f"context.time <= {scene.verified.expiry_ms} }};"
    )
    entities = cedarpy.Entities.from_json_str("[]")
    readings = state.snapshot.readings
    battery, holding = readings["battery_permille"].value, readings["holding"].value  # type: ignore[index]

    def ask(action: Action) -> bool:
        context = {
            "source": action.source,
            "speed": action.params["speed_mm_s"],  # type: ignore[index]
            "battery": battery,
            "holding": holding,
            "time": now.utc_ms,
        }
        request = {
            "principal": {"type": "Robot", "id": mission.rid},
            "action": {"type": "Action", "id": action.type},
            "resource": {"type": "Region", "id": action.destination},
            "context": _JSON.encode(context).decode(),
        }
        return cedarpy.is_authorized(request, policies, entities).allowed

    return ask


class BiscuitGate:
    """A Biscuit that carries the rule as checks; its signature was verified beforehand.

    Args:
        scene: whose mission row becomes the token's block.
    """

    def __init__(self, scene: Scene) -> None:
        grant = _grant(scene)
        row = grant.alternatives[0]
        told = conditions(scene, grant, row)
        told += [f'{{destination}} == "{row.destination}"', f'{{type}} == "{grant.type}"']
        block: list[str] = []
        for text, spelled in zip(told, _named(told, "${}"), strict=True):
            facts = ", ".join(f"{name}(${name})" for name in dict.fromkeys(_names(text)))
            block.append(f"check if {facts}, {spelled};")
        self._keys = KeyPair()
        self._token = BiscuitBuilder("\n".join(block)).build(self._keys.private_key)
        self.data = bytes(self._token.to_bytes())
        self.conditions = len(told)

    def verify(self) -> Biscuit:
        """Return the token from its bytes, signature verified."""
        return Biscuit.from_bytes(self.data, self._keys.public_key)

    def asker(self, context: dict[str, Any]) -> Check:
        """Return the check over facts and a policy that are parsed already."""
        token, policy = self._token, Policy("allow if true")
        flat = {name: value for name, value in context.items() if name != "route"}
        facts = [Fact(f"{name}({{value}})", {"value": _plain(v)}) for name, v in flat.items()]

        def ask(action: Action) -> bool:
            builder = AuthorizerBuilder()
            builder.set_limits(_limits(builder))
            for fact in facts:
                builder.add_fact(fact)
            builder.add_fact(Fact("type({value})", {"value": str(action.type)}))
            builder.add_fact(Fact("destination({value})", {"value": str(action.destination)}))
            builder.add_policy(policy)
            try:
                return builder.build(token).authorize() == 0
            except AuthorizationError:
                return False

        return ask


def _limits(builder: AuthorizerBuilder) -> Any:
    """Return limits without the wall-clock limit of a millisecond, which a busy machine hits."""
    limits = builder.limits()
    limits.max_time = timedelta(seconds=1)
    return limits


def _plain(value: Any) -> Any:
    return value if type(value) is int else str(value)


class Signatures:
    """The Ed25519 checks that one token contains, with keys and messages at hand.

    The message's signature by the leaf's key, the leaf's by its authority's, the authority's by
    the root's: three.
    """

    COUNT = 3

    def __init__(self, token: bytes, trust: Trust) -> None:
        opened = read_token(token)
        endorsement = opened.endorsements[0]
        leaf, authority = (x509.load_der_x509_certificate(unb64(c)) for c in endorsement.chain)
        self._one: Any = leaf.public_key()
        self._two: Any = authority.public_key()
        self._three: Any = trust.root.public_key()
        self._message = unb64(digest(Tag.MISSION, unb64(opened.payload)))
        self._signed = (unb64(endorsement.signature), leaf.signature, authority.signature)
        self._leaf, self._authority = leaf.tbs_certificate_bytes, authority.tbs_certificate_bytes

    def one(self) -> None:
        """Verify the message's signature."""
        self._one.verify(self._signed[0], self._message)

    def all(self) -> None:
        """Verify all three."""
        self._one.verify(self._signed[0], self._message)
        self._two.verify(self._signed[1], self._leaf)
        self._three.verify(self._signed[2], self._authority)


class BareInsert:
    """One row into one table, with the store's own connection settings, durable on return.

    Args:
        path: a new file beside the gate's store.
        size: bytes of a row: what the gate's record has.
    """

    def __init__(self, path: Path, size: tuple[int, int, int]) -> None:
        self._connection = apsw.Connection(str(path))
        self._connection.set_busy_timeout(0)
        self._connection.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
        self._connection.execute("PRAGMA journal_mode = WAL").fetchall()
        self._connection.execute("PRAGMA synchronous = FULL")
        self._connection.execute(
            "CREATE TABLE audit (seq INTEGER PRIMARY KEY, record BLOB NOT NULL, "
            "sealed BLOB NOT NULL, link BLOB NOT NULL) STRICT"
        )
        self._row = tuple(os.urandom(part) for part in size)
        self._seq = 0

    def insert(self) -> None:
        """Insert the next row; on disk on return."""
        self._connection.execute("INSERT INTO audit VALUES (?, ?, ?, ?)", (self._seq, *self._row))
        self._seq += 1

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()
