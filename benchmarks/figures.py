# SPDX-License-Identifier: Apache-2.0
"""The figures of design section 9, each from the medians of one run, beside its target."""

from __future__ import annotations

from typing import Any, NamedTuple

from durable import LENGTHS
from measure import Timing, difference, ratio, steady


class Figure(NamedTuple):
    """One number that is compared.

    Args:
        id: its key.
        what: for people.
        value: a ratio, or a time in `unit`.
        unit: `x`, `ms`, `MiB`, `%`, or empty for a truth value or a count.
        of: the timings that it comes from.
        target: the most that meets it; None for a number that is only shown.
        moonshot: what would be better still.
        steady: False when the blocks differ so much that the number says little.
    """

    id: str
    what: str
    value: float | bool
    unit: str
    of: tuple[str, ...]
    target: float | bool | None = None
    moonshot: float | None = None
    steady: bool = True

    @property
    def meets(self) -> bool | None:
        """True when it meets its target, None when there is none; not to be told is not to meet."""
        if self.target is None:
            return None
        if not self.steady:
            return False
        if isinstance(self.target, bool):
            return self.value is self.target
        return self.value <= self.target

    def plain(self) -> dict[str, Any]:
        """Return it for JSON."""
        value = self.value if isinstance(self.value, bool) else round(self.value, 4)
        return {**self._asdict(), "value": value, "meets": self.meets}


def figures(timings: dict[str, Timing], revoked: dict[str, Any]) -> list[Figure]:
    """Return every figure, those with a target first."""
    return [*_targets(timings, revoked), *_shown(timings, revoked)]


def net(
    timings: dict[str, Timing],
    key: str,
    what: str,
    of: tuple[str, str],
    *,
    target: float | None = None,
) -> Figure:
    """Return how much longer the first took than the second, in milliseconds."""
    value = difference(timings[of[0]], timings[of[1]]) / 1e6
    calm = steady(*(timings[name] for name in of))
    return Figure(key, what, value, "ms", of, target, steady=calm)


def _targets(timings: dict[str, Timing], revoked: dict[str, Any]) -> list[Figure]:
    return [
        _ratio(
            timings,
            "accept_over_cedar",
            "one action normalized, decided, hashed / cedarpy, pre-parsed, this rule",
            ("gate.accept", "cedar.rule.accept"),
            target=0.5,
            moonshot=0.35,
        ),
        _ratio(
            timings,
            "refuse_over_accept",
            "a refusal / an acceptance",
            ("gate.refuse", "gate.accept"),
            target=1.5,
        ),
        _ratio(
            timings,
            "cold_token_over_signatures",
            "a cold token / the three Ed25519 checks in it",
            ("token.cold", "token.signatures"),
            target=1.5,
        ),
        net(
            timings,
            "durable_accept_net",
            "an accepted action on disk and dispatched - a bare durable insert",
            ("durable.accept", "insert.bare"),
            target=0.15,
        ),
        _ratio(
            timings,
            "normalize_over_json_1kb",
            "one action normalized with 1 kB of ledger / `json.loads` of the same text",
            ("normalize.1kB", "json.loads"),
            target=10,
        ),
        _ratio(
            timings,
            "normalize_over_json_100kb",
            "one action normalized with 100 kB of ledger / `json.loads` of the same text",
            ("normalize.100kB", "json.loads"),
            target=12,
        ),
        _ratio(
            timings,
            "formats_over_json",
            "every reply format in JSON recognized and read / `json.loads` of the same texts",
            ("read.formats", "json.loads.formats"),
            target=10,
        ),
        Figure(
            "revocation_evicts",
            f"the kept mission is gone and the next proposal refused, {revoked['count']} of "
            f"{revoked['count']} times",
            bool(revoked["kept_before"] and revoked["refused_next"] and revoked["evicted"]),
            "",
            (),
            target=True,
        ),
    ]


def _shown(timings: dict[str, Timing], revoked: dict[str, Any]) -> list[Figure]:
    beside = (
        ("accept_over_cedar_dict", "the same / cedarpy with a `dict` context", "cedar.rule_dict"),
        ("accept_over_cedar_mission", "the same / cedarpy, every navigation row", "cedar.mission"),
        ("accept_over_cedar_five", "the same / cedarpy, five values only", "cedar.five"),
        ("accept_over_biscuit", "the same / a verified Biscuit, this rule", "biscuit"),
    )
    shown = [
        _ratio(timings, key, what, ("gate.accept", f"{name}.accept")) for key, what, name in beside
    ]
    shown += [
        _ratio(
            timings,
            "refuse_over_cedar_refuse",
            "a refusal / cedarpy refusing, this rule",
            ("gate.refuse", "cedar.rule.refuse"),
        ),
        _ratio(
            timings,
            "accept_over_ed25519",
            "an acceptance / one bare Ed25519 verification",
            ("gate.accept", "ed25519.verify"),
        ),
        _ratio(
            timings,
            "known_signer_over_ed25519",
            "a new token of a signer whose certificates are known / one bare Ed25519 verification",
            ("token.known_signer", "ed25519.verify"),
        ),
        _ratio(
            timings,
            "cold_token_over_biscuit",
            "a cold token / a cold Biscuit",
            ("token.cold", "biscuit.verify"),
        ),
        net(
            timings,
            "durable_refuse_net",
            "a refusal on disk - a bare durable insert",
            ("durable.refuse", "insert.bare"),
        ),
        net(
            timings,
            "durable_accept_new_state_net",
            "as `durable_accept_net`, with a new signed snapshot verified on the way",
            ("durable.accept_new_state", "insert.bare"),
        ),
        net(
            timings,
            "ledger_net",
            "T_L: standing and record committed - a bare durable insert",
            ("T_L.ledger", "insert.bare"),
        ),
    ]
    shown += [
        net(
            timings,
            f"plan_{length}_net",
            f"one action of a cold plan of {length} - a bare durable insert",
            (f"plan.{length}", f"insert.bare.{length}"),
        )
        for length in LENGTHS
    ]
    return [*shown, *_sums(timings), *_revoked(revoked)]


def _sums(timings: dict[str, Timing]) -> list[Figure]:
    """`eq:latency`: cold verifies the token, steady has it; approval only where one is needed.

    T_L is net of the bare insert: the disk itself is nobody's merit or fault.
    """
    always = ("T_N.normalize", "T_N.complete", "T_P.decide", "T_P.digest", "T_S.assess")
    rows = (
        ("total_steady", "steady, no approval", (*always, "token.kept")),
        ("total_cold", "cold, no approval", (*always, "token.cold")),
        ("total_cold_approved", "cold, one approval", (*always, "token.cold", "T_A.approval_cold")),
    )
    ledger = difference(timings["T_L.ledger"], timings["insert.bare"])
    calm = steady(timings["T_L.ledger"], timings["insert.bare"])
    return [
        Figure(
            key,
            f"T_total, {what}, net of a bare durable insert",
            (sum(timings[name].p50 for name in names) + ledger) / 1e6,
            "ms",
            (*names, "T_L.ledger", "insert.bare"),
            steady=calm,
        )
        for key, what, names in rows
    ]


def _revoked(revoked: dict[str, Any]) -> list[Figure]:
    return [
        Figure(
            "revocation_command",
            "a signed revocation, verified and on disk",
            revoked["command_p50_us"] / 1e3,
            "ms",
            (),
        ),
        Figure(
            "revocation_next_refusal",
            "the next proposal, refused and on disk",
            revoked["next_refusal_p50_us"] / 1e3,
            "ms",
            (),
        ),
    ]


def _ratio(
    timings: dict[str, Timing],
    key: str,
    what: str,
    of: tuple[str, str],
    *,
    target: float | None = None,
    moonshot: float | None = None,
) -> Figure:
    value = ratio(timings[of[0]], timings[of[1]])
    calm = steady(*(timings[name] for name in of))
    return Figure(key, what, value, "x", of, target, moonshot, calm)
