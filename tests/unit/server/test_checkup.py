# SPDX-License-Identifier: Apache-2.0
"""One safe gate; each test makes one thing unsafe, and the gate does not start."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import apsw
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from authguard_r.access.gate_config import Peer
from authguard_r.authoring.binding.samples import probe_site
from authguard_r.authoring.keys.setup import init_folder
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import ActionType, RobotId, ToolId
from authguard_r.core.quantities import Now
from authguard_r.keys.certificate import Role
from authguard_r.normalize.binding import Argument, ArgumentUse, Binding, ToolBinding, ways_of
from authguard_r.normalize.interface import Surface, shipped_interface
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.operations.checkup import GateSetup, checkup, is_safe, require_safe
from authguard_r.operations.checkup.advice import Advice, AdviceCode, Level
from authguard_r.operations.checkup.meaning import binding_advice
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from authguard_r.store.clocks import SIMULATED, SystemClock
from authguard_r.store.sqlite import open_store
from authguard_r.store.transactions import Ledger
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from unit.server.robots import ME, NOW, config, mine, robot, write_key

DAY_MS = 86_400_000
BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)


def unsafe(setup: GateSetup, now: Now = NOW) -> list[Advice]:
    return [item for item in checkup(setup, now) if item.level is Level.UNSAFE]


def refused(setup: GateSetup, code: AdviceCode, now: Now = NOW) -> Advice:
    """Return the one unsafe finding; a gate outside a demonstration does not start with it."""
    found = unsafe(setup, now)
    assert [item.code for item in found] == [code]
    with pytest.raises(EnvironmentFault) as error:
        require_safe(setup, now)
    assert found[0].message[:200] in error.value.message
    return found[0]


def advice(setup: GateSetup, code: AdviceCode, now: Now = NOW) -> Advice:
    (found,) = [item for item in checkup(setup, now) if item.code is code]
    return found


def test_a_safe_gate_starts(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    assert unsafe(setup) == []
    found = require_safe(setup, NOW)
    assert is_safe(found)
    assert {AdviceCode.KEY_MODE, AdviceCode.STORE, AdviceCode.DISK, AdviceCode.SQLITE} <= {
        item.code for item in found
    }


def test_nothing_named_is_nothing_but_the_machine() -> None:
    assert len(checkup(GateSetup(demo=False, uid=ME), NOW)) == 6


def test_a_root_for_demonstration_refuses_a_gate_that_is_none() -> None:
    setup = GateSetup(demo=False, uid=os.geteuid(), trust=scenarios.trust_folder())
    found = unsafe(setup)
    assert found[0].code is AdviceCode.DEMO_ROOT
    with pytest.raises(EnvironmentFault) as error:
        require_safe(setup, NOW)
    assert error.value.where == str(scenarios.trust_folder())
    told = require_safe(replace(setup, demo=True), NOW)
    assert AdviceCode.DEMO_ROOT in {item.code for item in told if item.level is Level.WARNING}


def test_a_demonstration_starts_with_what_would_refuse_any_other(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    assert setup.key is not None
    setup.key.chmod(0o644)
    (tmp_path / "trust").chmod(0o777)
    refused(replace(setup, trust=None), AdviceCode.KEY_MODE)
    assert {item.code for item in unsafe(setup)} == {AdviceCode.KEY_MODE, AdviceCode.WRITABLE}
    with pytest.raises(EnvironmentFault, match=r"\(and [12] more: authguard doctor\)"):
        require_safe(setup, NOW)
    told = require_safe(replace(setup, demo=True), NOW)
    assert {item.code for item in told if item.level is Level.UNSAFE} == {AdviceCode.KEY_MODE}


def test_a_folder_that_is_no_trust_folder_is_unsafe(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    (tmp_path / "trust" / "root.pem").write_text("junk")
    refused(replace(setup, site=None, config=None), AdviceCode.TRUST)


def test_anothers_key_beside_the_gate_refuses_it(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    path = write_key(tmp_path / "gate" / "operator.key.pem", Ed25519PrivateKey.generate())
    assert refused(setup, AdviceCode.STRAY_KEY).place == str(path)


def test_a_key_in_the_trust_folder_is_held_to_its_mode(tmp_path: Path) -> None:
    setup = replace(robot(tmp_path), key=None)
    keys = tmp_path / "trust" / "keys"
    keys.mkdir()
    mine(keys, 0o700)
    path = write_key(keys / "operator.key.pem", Ed25519PrivateKey.generate())
    assert unsafe(setup) == []
    path.chmod(0o640)
    refused(setup, AdviceCode.KEY_MODE)


def test_a_stale_list_refuses_and_one_that_ends_soon_is_said(tmp_path: Path) -> None:
    setup = replace(robot(tmp_path, list_days=20), chain=None)
    assert unsafe(setup) == []
    assert all(item.code is not AdviceCode.REVOCATIONS for item in checkup(setup, NOW))
    soon = Now(NOW.utc_ms + 14 * DAY_MS + 1, 0)  # it was signed a day ago, for 20 days
    found = advice(setup, AdviceCode.REVOCATIONS, soon)
    assert (found.level, found.part) == (Level.WARNING, "revocations/machines")
    before = checkup(setup, Now(NOW.utc_ms + 14 * DAY_MS, 0))
    assert all(item.code is not AdviceCode.REVOCATIONS for item in before)
    late = Now(NOW.utc_ms + 30 * DAY_MS, 0)
    assert refused(setup, AdviceCode.REVOCATIONS, late).part == "revocations/machines"


def test_a_certificate_that_ended_refuses_and_one_that_ends_soon_is_said(tmp_path: Path) -> None:
    setup = robot(tmp_path, days=41)  # valid since yesterday
    assert unsafe(setup) == []
    least = Now(NOW.utc_ms + 10 * DAY_MS, 0)
    assert all(item.code is not AdviceCode.CERTIFICATE for item in checkup(setup, least))
    soon = Now(NOW.utc_ms + 10 * DAY_MS + 1, 0)
    assert advice(setup, AdviceCode.CERTIFICATE, soon).level is Level.WARNING
    refused(setup, AdviceCode.CERTIFICATE, Now(NOW.utc_ms + 60 * DAY_MS, 0))


def test_short_lists_are_no_reason_to_issue_certificates_again(tmp_path: Path) -> None:
    setup = robot(tmp_path, list_days=8)
    assert {item.code for item in checkup(setup, NOW)}.isdisjoint(
        {AdviceCode.CERTIFICATE, AdviceCode.REVOCATIONS}
    )


def test_peoples_and_authorities_keys_are_told_also_where_nobody_named_the_gates(
    tmp_path: Path,
) -> None:
    setup = robot(tmp_path)
    keys = scenarios.trust_folder() / "keys"
    for place, name in (("run", "operator-1"), ("store", "gate-courier-1")):
        for end in ("key.pem", "cert.pem"):
            target = tmp_path / place / f"{name}.{end}"
            target.write_bytes((keys / f"{name}.{end}").read_bytes())
            mine(target, 0o600)
    machines = Ed25519PrivateKey.generate()
    held = write_key(tmp_path / "trust" / "notes.txt", machines)
    (tmp_path / "gate" / "broken.key.pem").write_text("-----BEGIN PRIVATE KEY-----")
    broken = mine(tmp_path / "gate" / "broken.key.pem", 0o600)
    strays = {item.place for item in checkup(setup, NOW) if item.code is AdviceCode.STRAY_KEY}
    assert strays == {
        str(held),
        str(broken),
        str(tmp_path / "run/operator-1.key.pem"),
        str(tmp_path / "store/gate-courier-1.key.pem"),
    }
    # without --key only what is certainly another's: a person's
    found = refused(replace(setup, key=None), AdviceCode.STRAY_KEY)
    assert found.place == str(tmp_path / "run/operator-1.key.pem")
    assert "of role `operator`" in found.message


def test_the_key_of_an_authority_is_called_so(tmp_path: Path) -> None:
    init_folder(tmp_path / "auth", (), now=BEGIN, title="Hospital root")
    setup = GateSetup(demo=False, uid=os.geteuid(), trust=tmp_path / "auth", config=config())
    told = {
        Path(item.place).name: item.message
        for item in checkup(setup, NOW)
        if item.code is AdviceCode.STRAY_KEY
    }
    for name in ("root", "people", "site", "machines"):
        assert f"of the authority `{name}`" in told[f"{name}.key.pem"]
    (tmp_path / "auth/root.pem").write_bytes(b"junk")
    found = checkup(setup, NOW)
    assert {item.code for item in found if item.code is AdviceCode.STRAY_KEY} == set()
    assert AdviceCode.TRUST in {item.code for item in found}
    assert not [
        i for i in checkup(replace(setup, trust=None), NOW) if i.code is AdviceCode.STRAY_KEY
    ]


@pytest.mark.parametrize("damage", ["missing", "junk"])
def test_a_certificate_that_cannot_be_read_refuses(tmp_path: Path, damage: str) -> None:
    setup = robot(tmp_path)
    assert setup.chain is not None
    setup.chain.write_text("junk")
    assert refused(setup, AdviceCode.CERTIFICATE).place == str(setup.chain)
    if damage == "missing":
        setup.chain.unlink()
        assert {item.code for item in unsafe(setup)} == {AdviceCode.CERTIFICATE, AdviceCode.MISSING}


def test_every_certificate_in_the_trust_folder_is_looked_at(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    keys = tmp_path / "trust" / "keys"
    keys.mkdir()
    mine(keys, 0o700)
    (keys / "a.cert.pem").write_text("junk")
    assert refused(setup, AdviceCode.CERTIFICATE).part == "keys/a.cert.pem"


@pytest.mark.parametrize(
    ("role", "names"),
    [(Role.ESTIMATOR, {}), (Role.GATE, {"robots": ()})],
)
def test_a_certificate_that_is_no_gates_refuses(
    tmp_path: Path, role: Role, names: dict[str, Any]
) -> None:
    refused(robot(tmp_path, role=role, **names), AdviceCode.CERTIFICATE)


def test_a_configuration_of_another_robot_refuses(tmp_path: Path) -> None:
    setup = replace(robot(tmp_path), config=config(robot=RobotId("lifter-1")))
    refused(setup, AdviceCode.CONFIG)


@pytest.mark.parametrize("names", [{"profile": "A" * 43}, {"robots": ("nobody",)}])
def test_a_site_with_another_robot_than_the_certificates_refuses(
    tmp_path: Path, names: dict[str, Any]
) -> None:
    setup = replace(robot(tmp_path, **names), config=None)
    refused(setup, AdviceCode.SITE)


def test_a_planner_that_is_the_controller_refuses(tmp_path: Path) -> None:
    peer = Peer(uid=70_001, roles=(ClientRole.CONTROLLER, ClientRole.PLANNER))
    refused(replace(robot(tmp_path), config=config(peers=(peer,))), AdviceCode.SHARED_USER)


def test_a_run_folder_that_others_can_write_refuses(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    assert setup.run is not None
    setup.run.chmod(0o777)
    refused(setup, AdviceCode.WRITABLE)
    setup.run.chmod(0o755)
    assert advice(replace(setup, run=tmp_path / "none"), AdviceCode.MISSING).level is Level.WARNING


def test_a_run_folder_that_is_a_file_refuses(tmp_path: Path) -> None:
    setup, file = robot(tmp_path), tmp_path / "file"
    file.write_text("")
    found = advice(replace(setup, run=file), AdviceCode.MISSING)
    assert (found.level, found.mend) == (Level.UNSAFE, "name a folder")


def test_a_run_folder_whose_sockets_have_no_name_left_refuses(tmp_path: Path) -> None:
    run = tmp_path / ("r" * 100)
    run.mkdir()
    setup = replace(robot(tmp_path), run=mine(run, 0o755))
    refused(setup, AdviceCode.PATH_LONG)


def test_a_file_that_the_gate_believes_and_others_can_write_refuses(tmp_path: Path) -> None:
    path = tmp_path / "binding.yaml"
    path.write_text("x")
    setup = replace(robot(tmp_path), files=(mine(path, 0o666),))
    assert refused(setup, AdviceCode.WRITABLE).part == "binding.yaml"
    # a shipped binding is a name, not a file
    assert unsafe(replace(setup, files=(Path("ros-mcp"),))) == []


def test_a_store_without_its_folder_refuses(tmp_path: Path) -> None:
    setup = replace(robot(tmp_path), store=tmp_path / "none" / "robot.db")
    refused(setup, AdviceCode.MISSING)


def lay(setup: GateSetup, sql: str = "") -> Path:
    """Make the gate's store, empty, its user's alone."""
    assert setup.store is not None
    open_store(setup.store).close()
    if sql:
        connection = apsw.Connection(str(setup.store))
        connection.execute(sql)
        connection.close()
    return mine(setup.store, 0o600)


def test_a_store_says_how_it_is_anchored(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    store = lay(setup)
    assert advice(setup, AdviceCode.ANCHOR).message.startswith("unanchored")
    store.with_suffix(".checkpoint").write_bytes(b"")
    assert advice(setup, AdviceCode.ANCHOR).message.startswith(
        "its checkpoint is where the store is"
    )
    assert advice(setup, AdviceCode.ANCHOR).level is Level.WARNING


def test_a_store_that_others_can_write_refuses_and_one_that_they_read_is_said(
    tmp_path: Path,
) -> None:
    setup = robot(tmp_path)
    store = lay(setup)
    store.chmod(0o644)
    assert advice(setup, AdviceCode.READABLE).level is Level.WARNING
    store.chmod(0o602)
    refused(setup, AdviceCode.WRITABLE)
    store.chmod(0o600)
    wal = store.with_name(f"{store.name}-wal")
    wal.write_bytes(b"")
    mine(wal, 0o666)
    assert [item.place for item in unsafe(setup)] == [str(wal)]


def test_a_file_that_is_no_store_refuses(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    assert setup.store is not None
    setup.store.write_text("junk")
    mine(setup.store, 0o600)
    refused(setup, AdviceCode.STORE)


def test_a_store_that_a_gate_holds_is_left_to_it(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    assert setup.store is not None
    held = open_store(setup.store)
    try:
        for path in setup.store.parent.iterdir():
            mine(path, 0o600)
        found = advice(setup, AdviceCode.STORE)
    finally:
        held.close()
    assert found.level is Level.WARNING
    assert "a running gate has it open" in found.message


def test_a_log_that_was_changed_is_found_by_a_deep_look_alone(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    row = "INSERT INTO audit VALUES (0, CAST('x' AS BLOB), CAST('y' AS BLOB), zeroblob(32))"
    lay(setup, row)
    assert unsafe(setup) == []
    refused(replace(setup, deep=True), AdviceCode.STORE)


def test_a_whole_log_is_said_to_be(tmp_path: Path) -> None:
    setup = replace(robot(tmp_path), deep=True)
    lay(setup)
    assert advice(setup, AdviceCode.STORE).message == "0 records, whole"


@pytest.mark.parametrize("clock", ["system", SIMULATED])
def test_a_clock_behind_the_log_is_unsafe_and_the_gate_still_serves_stops(
    tmp_path: Path, clock: str
) -> None:
    setup = robot(tmp_path)
    assert setup.store is not None
    ledger = Ledger(
        open_store(setup.store),
        SystemClock(),
        robot=scenarios.RID,
        salts=os.urandom,
        genesis={"clock": clock},
    )
    ledger.run(lambda act: act.make_active(None))
    now = ledger.now()
    ledger.close()
    mine(setup.store, 0o600)
    assert unsafe(setup, now) == []
    early = Now(now.utc_ms - 60_000, 0)
    # a simulated log has its own time
    wanted = [] if clock == SIMULATED else [AdviceCode.CLOCK_BEHIND]
    assert [item.code for item in unsafe(setup, early)] == wanted
    require_safe(setup, early)


TOOLS = ToolBinding(
    type=ActionType("wait"),
    tool=ToolId("base"),
    arguments={
        "ms": Argument(use=ArgumentUse.MAPPED, to="params.duration_ms"),
        "topic": Argument(use=ArgumentUse.FIXED, value="/initialpose"),
    },
)


def test_a_tool_that_moves_beliefs_under_an_ordinary_name_refuses(tmp_path: Path) -> None:
    binding = Binding(schema="authguard-r/binding/1", id="b", tools={"pause": TOOLS})
    site = probe_site(binding, standard_words())
    found = [i for i in binding_advice(binding, site, interface=()) if i.level is Level.UNSAFE]
    assert AdviceCode.STATE_WRITING in {item.code for item in found}
    assert "`initialpose`" in next(i for i in found if i.code is AdviceCode.STATE_WRITING).message


@pytest.mark.parametrize("name", shipped_names())
def test_no_shipped_binding_moves_beliefs_under_an_ordinary_name(name: str) -> None:
    binding = convert(binding_source(name), Binding, where=name)
    site = probe_site(binding, standard_words())
    found = list(binding_advice(binding, site, interface=shipped_interface(name) or ()))
    assert [item for item in found if item.level is Level.UNSAFE] == []


def test_a_field_of_the_interface_that_is_not_bound_refuses(tmp_path: Path) -> None:
    setup = robot(tmp_path)
    binding = scenarios.binding()
    assert advice(setup, AdviceCode.UNCOMPARED).level is Level.WARNING
    surfaces = tuple(
        Surface(
            name,
            message=False,
            leaves=tuple({f: 0 for w in ways_of(binding, name) for f in w.tool.arguments}),
            open=frozenset(),
        )
        for name in binding.tools
    )
    assert advice(replace(setup, interface=surfaces), AdviceCode.BINDING).level is Level.OK
    some = advice(replace(setup, interface=surfaces[:1]), AdviceCode.UNCOMPARED)
    assert some.message.startswith("the interface says nothing of")
    first = surfaces[0]
    more = Surface(first.name, False, (*first.leaves, "no_such_field"), frozenset())
    found = refused(replace(setup, interface=(more, *surfaces[1:])), AdviceCode.UNMAPPED)
    assert found.mend.startswith("authguard binding check")
