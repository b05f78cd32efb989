# SPDX-License-Identifier: Apache-2.0
"""The hospital's template, its scheduler, and a robot that carries its missions out.

As in `worlds`: one valid world of the product's own parts; a test changes one thing in it.
"""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import msgspec

import worlds
from authguard_r.assembly import Simulation, folder_signer, simulate
from authguard_r.commands import Command, Verb
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.setup import Member, add_member
from authguard_r.site.source import read_text, read_yaml
from authguard_r.templates import Instance, Template, sign_instance
from authguard_r.templates.derive import compile_template

SET = msgspec.structs.replace
MINUTE_MS = 60_000


def draft(**changes: Any) -> dict[str, Any]:
    """Return the shipped template draft as plain data, with top-level fields replaced."""
    plain = read_yaml(read_text(worlds.HOSPITAL / "template.yaml"), where="template.yaml")
    assert isinstance(plain, dict)
    return {**plain, **changes}


@cache
def template() -> Template:
    """Return the shipped template, compiled at the story's instant."""
    return compile_template(draft(), worlds.site(), now=worlds.NOW)


def edited(*changes: tuple[tuple[str | int, ...], Any], **fields: Any) -> Template:
    """Return the shipped template with values at paths of its mission, and fields, replaced."""
    mission = msgspec.json.decode(msgspec.json.encode(template().mission))
    for path, value in changes:
        node = mission
        for step in path[:-1]:
            node = node[step]
        node[path[-1]] = value
    return SET(template(), mission=mission, **fields)


def digest(value: Template | None = None) -> str:
    return digest_of(Tag.TEMPLATE, value or template())


def signed(value: Template | None = None, *, by: str = "operator-1") -> bytes:
    """Return a template signed by a principal of the test set-up."""
    return sign_object(value or template(), Tag.TEMPLATE, folder_signer(worlds.trust_folder(), by))


def folder(*values: Template) -> Path:
    """Return a copy of the test set-up in which each template has its scheduler.

    The first is called `scheduler-0`, and so on; without any, the shipped one has one.
    """
    found = Path(mkdtemp(prefix="authguard-test-")) / "trust"
    shutil.copytree(worlds.trust_folder(), found)
    for number, value in enumerate(values or (template(),)):
        member = Member(
            id=f"scheduler-{number}",
            role=Role.SCHEDULER,
            robots=None,
            regions=None,
            template=digest(value),
        )
        begin = datetime.fromtimestamp(worlds.START_MS / 1000, UTC)
        add_member(found, member, now=begin, days=30)
    return found


@cache
def one_folder() -> Path:
    """One set-up for tests that change no key."""
    return folder()


def instance(number: int = 1, **changes: Any) -> Instance:
    """Return an instance of the shipped template that is valid at the story's instant."""
    at = worlds.START_MS
    plain: dict[str, Any] = {
        "template": digest(),
        "fill": {"package": "package-p1", "station": "station-101"},
        "mid": f"deliver.{number}",
        "nonce": b64(number.to_bytes(16, "big")),
        "not_before": to_timestamp(at),
        "expiry": to_timestamp(at + 25 * MINUTE_MS),
    }
    return Instance(**{**plain, **changes})


def token(
    value: Instance | None = None, *, by: str = "scheduler-0", at: Path | None = None
) -> bytes:
    """Return an instance signed by a principal of a set-up."""
    signer = folder_signer(at or one_folder(), by)
    return sign_instance(value or instance(), signer)


def simulation(
    at: Path | None = None,
    *,
    store: Path | None = None,
    start_ms: int = worlds.START_MS,
    **kwargs: Any,
) -> Simulation:
    """Return a whole gate over the symbolic robot, with the keys of a set-up."""
    return simulate(
        at or one_folder(),
        worlds.site(),
        worlds.binding(),
        rid=worlds.RID,
        start_ms=start_ms,
        store=store,
        **kwargs,
    )


def admitted(at: Path | None = None, **kwargs: Any) -> Simulation:
    """Return a gate that has taken the shipped template in."""
    sim = simulation(at, **kwargs)
    sim.gate.management.template(signed())
    return sim


def withdrawal(
    value: Template | None = None,
    *,
    by: str = "operator-1",
    at: Path | None = None,
    **changes: Any,
) -> bytes:
    """Return the signed order that withdraws a template."""
    command = Command(
        verb=Verb.WITHDRAW,
        mid=(value or template()).template,
        version=1,
        mission=digest(value),
        nonce=b64(worlds.random_bytes(16)),
        expires_ms=worlds.START_MS + 10**8,
    )
    signer = folder_signer(at or worlds.trust_folder(), by)
    return sign_object(SET(command, **changes), Tag.COMMAND, signer)


def actions(fill: dict[Any, Any]) -> tuple[Action, ...]:
    """Return what carries one delivery out, from the dock and back to it."""
    package, station = fill["package"], fill["station"]
    grip = {"type": "pick", "tool": "gripper", "object": package, "params": {"force_mn": 9_000}}
    return (
        worlds.navigate("dock", "pharmacy", speed=800),
        Action(**{**grip, "source": "pharmacy"}),
        worlds.navigate("pharmacy", station, speed=800),
        Action(**{**grip, "type": "place", "source": station, "destination": station}),
        worlds.navigate(station, "dock", speed=800),
    )


def delivered(sim: Simulation, fill: dict[Any, Any]) -> None:
    """Carry one delivery out, every step of it released and done."""
    for action in actions(fill):
        report = worlds.propose(sim, action)
        assert report.outcome is Outcome.SUCCEEDED, report
