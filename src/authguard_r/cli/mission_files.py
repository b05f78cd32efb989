# SPDX-License-Identifier: Apache-2.0
"""Mission files as the commands read and write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import typer

from authguard_r.authoring.compile.lint import LintFinding
from authguard_r.cli.file_kinds import COMPILED, expecting
from authguard_r.core.encoding import Tag, decode, digest_of, unb64
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Mission, require_schema
from authguard_r.core.token import read_token
from authguard_r.keys.trust import read_file


def payload_of(path: Path) -> bytes:
    """Return the canonical bytes in a file: `compile`'s own, or a token's, its signature unread.

    Raises:
        MalformedError: a token that is not valid.
    """
    data = read_file(path)
    if b'"endorsements"' in data:
        data = unb64(read_token(data).payload, where="token.payload")
    return data.removesuffix(b"\n")


def read_unverified(path: Path) -> Mission:
    """Return a mission from `compile`'s file or from a token: schema-valid, its signature unread.

    Raises:
        MalformedError: neither.
    """
    with expecting(path, read_file(path), COMPILED):
        mission = decode(payload_of(path), Mission, where="mission")
        require_schema(mission)
    return mission


def mission_digest(mission: Mission) -> Digest:
    """Return the digest that a signature over the mission binds."""
    return digest_of(Tag.MISSION, mission)


def beside_token(token: Path) -> Path:
    """Return where the confirmation of a token lies: its name without suffix, in its folder."""
    return token.with_suffix(".confirmation.json")


def warn(text: str) -> None:
    """Say on standard error what went ahead all the same."""
    typer.echo(f"WARNING {text}", err=True)


def lint_json(findings: tuple[LintFinding, ...]) -> list[Any]:
    """Return findings as they are printed."""
    return [msgspec.to_builtins(finding) for finding in findings]
