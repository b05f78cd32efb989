# SPDX-License-Identifier: Apache-2.0
"""A store, a log and tokens of the version before fences: they are read, opened and go on.

`tests/fixtures/older/story.tar.xz` is what `authguard demo --out` of that version wrote, with its
own trust folder. The clock goes on where that version's stood.
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import pytest

from authguard_r.access.gate_config import GateConfig, Peer, default_config
from authguard_r.audit.record import read_record
from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.cli import call
from authguard_r.core.encoding import Tag, b64, decode, encode
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import simulate
from authguard_r.site.source import convert
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios

STORY = Path(__file__).resolve().parents[1] / "fixtures" / "older" / "story.tar.xz"
HOUR_MS = 3_600_000


@pytest.fixture
def story(tmp_path: Path) -> Path:
    with tarfile.open(STORY) as packed:
        packed.extractall(tmp_path, filter="data")
    return tmp_path


def test_an_older_log_is_whole_and_its_decisions_are_made_again(
    story: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store, trust = str(story / "robot.db"), str(story / "trust")
    kept = ("--checkpoint", str(story / "robot.checkpoint"), "--trust", trust, "--json")
    assert call(["audit", "verify", store, *kept]) == 0
    assert json.loads(capsys.readouterr().out)["missing"] == []
    assert call(["audit", "replay", store, "--trust", trust, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["agree"] == told["decisions"] == 7


def test_an_older_store_opens_and_its_missions_go_on(story: Path) -> None:
    store = story / "robot.db"
    last_ms = max(read_record(row.record, where="").link.time_ms for row in read_rows(store))
    sim = simulate(
        story / "trust",
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=last_ms + 1_000,
        store=store,
    )
    # as that version held an operator's stop
    sim.gate.ledger.run(lambda act: act.put("stop", "operator", b"1"))
    token = (story / "deliver-p1.v2.token").read_bytes()
    with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
        sim.gate.management.activate(token)
    drafted = convert(scenarios.draft(mission="next"), Draft, where="next")
    now = Now(last_ms + 1_000, 0)
    begin = compile_draft(drafted, scenarios.site(), now=now, nonce=b64(bytes(16)))
    signer = folder_signer(story / "trust", begin.issuer)

    def order(verb: Verb, standing: Standing) -> str:
        value = Command(
            verb=verb,
            mid=standing.mid,
            version=standing.version,
            mission=standing.digest,
            nonce=b64(str(verb).encode()),
            expires_ms=last_ms + HOUR_MS,
            issued_ms=sim.robot.wall_ms() + 1,
        )
        return str(sim.gate.management.command(sign_object(value, Tag.COMMAND, signer)).status)

    before = sim.gate.management.standing(MissionId("deliver-p1"))
    assert before is not None
    assert order(Verb.COMPLETE, before) == "completed"
    handed = sign_object(begin, Tag.MISSION, signer)
    assert sim.gate.management.issue(handed).status == "issued"
    standing = sim.gate.management.activate(handed)
    assert standing.status == "suspended"  # the stop stands
    assert order(Verb.RESUME, standing) == "active"
    assert scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome == "succeeded"
    sim.gate.close()


def test_an_older_configuration_is_read_as_it_was_written() -> None:
    """What that version did not know is left out at its default: the bytes are the same."""
    config = default_config(
        scenarios.RID, (Peer(uid=7, roles=(ClientRole.OPERATOR,)),), Mode.ENFORCE
    )
    plain = json.loads(encode(config))
    assert not {"version", "state_wait_ms"} & plain.keys()
    assert decode(encode(config), GateConfig, where="config") == config
