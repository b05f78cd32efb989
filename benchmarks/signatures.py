# SPDX-License-Identifier: Apache-2.0
"""What a signature choice costs in bytes: token raw and compressed, with key id and with chain.

Nothing is timed here: the sizes are the same on every machine but for a few bytes of compressed
signatures. Source: section "Post-Quantum Considerations".
"""

from __future__ import annotations

import zlib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.encoding import Tag, encode
from authguard_r.core.identifiers import ObjectId, RegionId
from authguard_r.core.mission import Guard, Mission, Row
from authguard_r.core.token import read_token, sign_object
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.signer import folder_signer
from scene import scenarios

#: What signs, by name; two algorithms are a hybrid, both of which have to hold.
CHOICES: dict[str, tuple[Algorithm, ...]] = {
    **{str(one): (one,) for one in Algorithm},
    "hybrid": (Algorithm.ED25519, Algorithm.ML_DSA_65),
}
#: A key id stands for a chain of certificates that the verifier has already.
_KEY_ID = "A" * 43
_COUNTS = (1, 10, 100)


def token_sizes(folder: Path) -> list[dict[str, Any]]:
    """Return one row for each signature choice over the shipped mission."""
    return [_row(name, scenarios.mission(), _signer(folder, name)) for name in CHOICES]


def mission_sizes(folder: Path) -> list[dict[str, Any]]:
    """Return one row for each way in which a mission grows, signed by Ed25519 and by a hybrid."""
    signers = {name: _signer(folder, name) for name in ("ed25519", "hybrid")}
    rows: list[dict[str, Any]] = []
    for what, mission in _missions():
        for name, signer in signers.items():
            rows.append({"mission": what, **_row(name, mission, signer)})
    return rows


def _row(name: str, mission: Mission, signer: Any) -> dict[str, Any]:
    token = sign_object(mission, Tag.MISSION, signer)
    read = read_token(token)
    short = msgspec.structs.replace(
        read,
        endorsements=tuple(
            msgspec.structs.replace(e, chain=(_KEY_ID, _KEY_ID)) for e in read.endorsements
        ),
    )
    with_id = encode(short).replace(f'["{_KEY_ID}","{_KEY_ID}"]'.encode(), f'"{_KEY_ID}"'.encode())
    return {
        "signature": name,
        "payload": len(encode(mission)),
        "chain": len(token),
        "chain_zlib": len(zlib.compress(token, 9)),
        "key_id": len(with_id),
        "key_id_zlib": len(zlib.compress(with_id, 9)),
    }


def _signer(folder: Path, name: str) -> Any:
    """Return an operator's signer of a set-up that signs so."""
    trust = folder / f"trust-{name}"
    if not trust.exists():
        members = demo_members(scenarios.site(), ())
        init_folder(trust, members, now=datetime.now(UTC), algorithms=CHOICES[name])
    return folder_signer(trust, "operator-1")


def _missions() -> list[tuple[str, Mission]]:
    """Return missions that grow in one way each; ids as people choose them, then bare numbers."""
    plain = scenarios.mission()
    made: list[tuple[str, Mission]] = []
    for ids, prefix in (("readable", "medicine-package-"), ("numeric", "")):
        for count in _COUNTS:
            objects = tuple(sorted(ObjectId(f"{prefix}{n}") for n in range(count)))
            made.append(
                (f"{count} objects, {ids}", msgspec.structs.replace(plain, objects=objects))
            )
    for ids, prefix in (("readable", "nurse-station-"), ("numeric", "")):
        for count in _COUNTS:
            regions = tuple(sorted(RegionId(f"{prefix}{n}") for n in range(count)))
            made.append(
                (f"{count} regions, {ids}", msgspec.structs.replace(plain, regions=regions))
            )
            made.append((f"{count} rows, {ids}", _with_rows(plain, count, prefix)))
    for count in _COUNTS:
        guards: tuple[Guard, ...] = plain.guards[:1] * count
        made.append((f"{count} guards", msgspec.structs.replace(plain, guards=guards)))
    return made


def _with_rows(mission: Mission, count: int, prefix: str) -> Mission:
    rows = tuple(
        Row(
            source=RegionId(f"{prefix}{n}"),
            destination=RegionId(f"{prefix}{n + 1}"),
            regions=tuple(sorted((RegionId(f"{prefix}{n}"), RegionId(f"{prefix}{n + 1}")))),
        )
        for n in range(count)
    )
    first = msgspec.structs.replace(mission.actions[0], alternatives=rows)
    return msgspec.structs.replace(mission, actions=(first, *mission.actions[1:]))
