# SPDX-License-Identifier: Apache-2.0
"""Who may be what at a gate, as the command line says it: users by name or number, with roles."""

from __future__ import annotations

import os
import pwd

import typer

from authguard_r.core.errors import MalformedError
from authguard_r.wire.messages import ClientRole

#: What a node or a gateway is to its gate: it asks, drives, and says how the gate stands.
MEDIATOR = (ClientRole.AUDITOR, ClientRole.CONTROLLER, ClientRole.PLANNER)


def user_number(who: str | int, *, where: str) -> int:
    """Return a user's number on this machine.

    Raises:
        MalformedError: no such name.
    """
    if isinstance(who, int) or (who.isascii() and who.isdigit()):
        return int(who)
    try:
        return pwd.getpwnam(who).pw_uid
    except (KeyError, ValueError) as error:  # a name with a NUL is no name
        raise MalformedError(
            f"this machine has no user `{who}`; create it, or give its number", where=where
        ) from error


def every_user() -> dict[str | int, tuple[ClientRole, ...]]:
    """Return every role for each user."""
    return {os.geteuid(): tuple(role for role in ClientRole if role is not ClientRole.GATE)}


def peers_of(given: list[str]) -> dict[str | int, tuple[ClientRole, ...]]:
    """Return the roles that the command line gives each user."""
    found: dict[str | int, tuple[ClientRole, ...]] = {}
    for text in given:
        who, colon, names = text.rpartition(":")
        if not colon or not who or who in found:
            raise typer.BadParameter(
                f"expected USER:role,role, each user once, got `{text}`", param_hint="--peer"
            )
        found[who] = tuple(_role(name) for name in names.split(","))
        _require_user(who, "--peer")
    return found


def mediators_of(
    given: list[str], peers: dict[str | int, tuple[ClientRole, ...]]
) -> dict[str | int, tuple[ClientRole, ...]]:
    """Return the roles of users that mediate, which `--peer` does not name."""
    for who in given:
        if who in peers or given.count(who) > 1:
            raise typer.BadParameter(f"`{who}` comes twice", param_hint="--mediator")
        _require_user(who, "--mediator")
    return dict.fromkeys(given, MEDIATOR)


def _role(name: str) -> ClientRole:
    roles = [str(role) for role in ClientRole if role is not ClientRole.GATE]
    if name not in roles:
        raise typer.BadParameter(
            f"expected roles of {', '.join(roles)}, got `{name}`", param_hint="--peer"
        )
    return ClientRole(name)


def _require_user(who: str, option: str) -> None:
    """Refuse a user whom this machine does not know, as wrong usage of the command line."""
    try:
        user_number(who, where=option)
    except MalformedError as error:
        raise typer.BadParameter(error.message, param_hint=option) from error
