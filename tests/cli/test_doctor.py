# SPDX-License-Identifier: Apache-2.0
"""The doctor looks at the whole set-up: exit 0 when nothing is unsafe, 5 when something is."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from authguard_r.approvals.organization import OrganizationPolicy, open_policy
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.authoring.keys.setup import Member, add_member
from authguard_r.cli import call
from authguard_r.cli.inputs import load_site, wall_now
from authguard_r.core.encoding import Tag
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.operations.offline import offline_gate
from authguard_r.site.model import profile_digest
from authguard_r.site.source import read_text
from fixtures import emergency_policies, scenarios
from unit.server.robots import ME, config, peers, robot

LEVELS = {"ok", "warning", "unsafe"}
DAY_MS = 86_400_000


def doctor(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = call(["doctor", *words, "--json"])
    told = json.loads(capsys.readouterr().out)
    for item in told.get("advice", ()):
        assert set(item) == {"part", "level", "code", "message", "place", "mend"}
        assert item["level"] in LEVELS
        assert item["mend"] or item["level"] == "ok"
    return code, told


def codes(told: dict[str, Any], level: str) -> set[str]:
    return {item["code"] for item in told["advice"] if item["level"] == level}


@pytest.fixture
def demo(tmp_path: Path, monkeypatch: Any) -> list[str]:
    """A whole set-up in one folder, as the first hour makes it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.trust_folder(), "trust")
    Path("run").mkdir()
    signer = folder_signer(Path("trust"), "site-authority-1")
    Path("gate.token").write_bytes(sign_object(config(), Tag.GATE, signer))
    return [
        *("--trust", "trust", "--site", str(scenarios.HOSPITAL / "site.yaml")),
        *("--binding", str(scenarios.HOSPITAL / "binding.yaml"), "--store", "robot.db"),
        *("--gate", "run", "--config", "gate.token", "--key", "trust/keys/gate-courier-1.key.pem"),
        *("--cert", "trust/keys/gate-courier-1.cert.pem"),
    ]


def test_a_trial_in_one_folder_is_warned_of_and_not_refused(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    code, told = doctor(capsys, *demo)
    assert (code, told["safe"]) == (0, True), codes(told, "unsafe")
    assert {"DEMO_ROOT", "UNCOMPARED", "USER"} <= codes(told, "warning")
    assert call(["doctor", *demo]) == 0
    assert "warning  trust: the root says `demo`" in capsys.readouterr().out


def test_a_store_that_is_not_there_is_said_and_no_mend_has_to_be_guessed(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, told = doctor(capsys, *demo)
    store = next(item for item in told["advice"] if item["part"] == "store")
    assert (store["level"], store["place"]) == ("warning", "robot.db")
    assert "does not exist yet" in store["message"]
    mend = next(item["mend"] for item in told["advice"] if item["part"] == "binding")
    binding, site = demo[demo.index("--binding") + 1], demo[demo.index("--site") + 1]
    assert mend == f"authguard binding check {binding} --site {site} --interface FILE"
    Path("file").write_text("")
    demo[demo.index("--gate") + 1] = "file"
    code, told = doctor(capsys, *demo)
    assert (code, "expected a folder" in str(told["advice"])) == (5, True)


def test_one_unsafe_part_is_5_and_named(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("trust/keys/gate-courier-1.key.pem").chmod(0o640)
    code, told = doctor(capsys, *demo)
    assert (code, told["safe"], codes(told, "unsafe")) == (5, False, {"KEY_MODE"})


@pytest.mark.parametrize("part", ["--site", "--binding", "--config"])
def test_a_part_that_cannot_be_read_is_unsafe(
    demo: list[str], part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("junk").write_text("[")
    words = [*demo]
    words[words.index(part) + 1] = "junk"
    code, told = doctor(capsys, *words)
    assert code == 5
    assert {item["place"] for item in told["advice"] if item["level"] == "unsafe"} >= {"junk"}
    words[words.index(part) + 1] = "missing"
    assert doctor(capsys, *words)[0] == 5


def test_a_part_without_what_it_is_read_by_is_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor(capsys, "--config", "gate.token")[0] == 2
    assert doctor(capsys, "--binding", "ros-mcp")[0] == 2
    assert doctor(capsys, "--user", "no-such-user-here")[0] == 4


def test_a_shipped_binding_is_compared_with_its_own_interface(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*demo]
    words[words.index("--binding") + 1] = "ros-mcp"
    _, told = doctor(capsys, *words)
    assert not any("compared with no interface" in item["message"] for item in told["advice"])


def test_a_folder_that_init_made_is_looked_at_whole_and_says_what_is_still_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tools.json").write_text('[{"type": "function", "name": "go"}]')
    assert call(["init", "--from", "openai", "tools.json", "--out", "cell"]) == 0
    capsys.readouterr()
    code, told = doctor(capsys, "cell")
    assert code == 0
    said = {item["message"]: item["place"] for item in told["advice"]}
    assert said["`robot-1` can do nothing yet"] == "robots.robot-1.profile.tools"
    assert any(text.startswith("unreviewed") for text in said)
    assert any("every field bound" in text for text in said)
    assert doctor(capsys, "cell", "--interface", "missing")[0] == 5
    site = Path("cell/site.yaml")
    site.write_text(site.read_text().replace("tools: {}", "tools: {wait: [base]}"))
    code, told = doctor(capsys, "cell")
    assert code == 5
    mends = [item["mend"] for item in told["advice"] if item["level"] == "unsafe"]
    assert mends == ["make keys for it: authguard keys init FOLDER --site cell/site.yaml"]
    assert doctor(capsys, "tools.json")[0] == 2


def test_a_robots_own_folders_are_safe_for_its_user_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup = robot(tmp_path)
    words = [
        *("--trust", str(setup.trust), "--key", str(setup.key), "--cert", str(setup.chain)),
        *("--store", str(setup.store), "--gate", str(setup.run)),
    ]
    code, told = doctor(capsys, *words, "--user", str(ME))
    assert (code, codes(told, "unsafe")) == (0, set())
    code, told = doctor(capsys, *words, "--user", str(ME + 1))
    assert code == 5
    assert {"KEY_OWNER", "OWNER"} <= codes(told, "unsafe")


def test_roles_that_one_user_has_are_unsafe(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, *others = peers()
    both = replace(first, roles=tuple(sorted((*first.roles, *second.roles))))
    signer = folder_signer(Path("trust"), "site-authority-1")
    shared = config(peers=(both, *others))
    Path("gate.token").write_bytes(sign_object(shared, Tag.GATE, signer))
    code, told = doctor(capsys, *demo)
    # in one folder roles are not separated anyway; a gate that is no trial refuses it
    assert (code, "SHARED_USER" in codes(told, "warning")) == (0, True)


# the policies that a gate is told of


def days(number: int) -> str:
    """Return the instant so many days from now, by the machine's clock, which the doctor reads."""
    return to_timestamp(wall_now(None).utc_ms + number * DAY_MS)


def option(words: list[str], name: str, value: str) -> list[str]:
    """Return the command with one option named otherwise."""
    place = words.index(name) + 1
    return [*words[:place], value, *words[place + 1 :]]


def of(part: str, told: dict[str, Any]) -> list[tuple[str, str]]:
    """Return level and message of everything that was said of a part."""
    return [(item["level"], item["message"]) for item in told["advice"] if item["part"] == part]


def risk_policy(**changes: Any) -> OrganizationPolicy:
    plain = {
        "schema": "authguard-r/risk-policy/1",
        "organization": "hospital",
        "version": 2,
        "issued": days(-1),
        "policy": replace(scenarios.mission().risk_policy, tau_1=10, tau_2=60),
        **changes,
    }
    return msgspec.convert(plain, OrganizationPolicy)


def write_risk(
    *, by: str = "safety-officer-1", folder: str | Path = "trust", **changes: Any
) -> str:
    token = sign_object(risk_policy(**changes), Tag.RISK_POLICY, folder_signer(Path(folder), by))
    Path("policy.token").write_bytes(token)
    return "policy.token"


@pytest.fixture
def marked(demo: list[str]) -> list[str]:
    """The set-up at a site that marks where it is safe."""
    text = read_text(scenarios.HOSPITAL / "site.yaml") + "emergency: {places: {dock: charging}}\n"
    Path("site.yaml").write_text(text)
    return option(demo, "--site", "site.yaml")


def write_emergency(
    *capabilities: dict[str, Any],
    by: str = "safety-officer-1",
    folder: str | Path = "trust",
    **changes: Any,
) -> str:
    here = load_site(Path("site.yaml"))
    dates = {"not_before": days(-2), "expiry": days(90)}
    value = emergency_policies.policy(
        *(capabilities or (emergency_policies.GO_SAFE, emergency_policies.CALL)),
        at=here,
        **{**dates, **changes},
    )
    Path("emergency.token").write_bytes(emergency_policies.token(value, by=by, folder=Path(folder)))
    return "emergency.token"


def short_lived(name: str, **scope: Any) -> str:
    """Give the folder one more safety officer, whose certificate ends in twenty days."""
    member = Member(id=name, role=Role.SAFETY_OFFICER, **{"robots": None, "regions": None, **scope})
    add_member(Path("trust"), member, now=datetime.now(UTC), days=20)
    return name


def test_policies_that_a_gate_takes_are_fine_and_said(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--risk-policy", write_risk(), "--emergency-policy", write_emergency())
    code, told = doctor(capsys, *marked, *words)
    assert (code, told["safe"]) == (0, True), codes(told, "unsafe")
    ((risk, of_risk),) = of("risk policy", told)
    ((emergency, of_emergency),) = of("emergency policy", told)
    assert (risk, emergency) == ("ok", "ok")
    assert of_risk.startswith("`hospital`, version 2, signed by `safety-officer-1`, until ")
    assert of_emergency.startswith("`courier-emergency`, version 1, signed by `safety-officer-1`")


def test_a_folder_is_looked_through_for_the_policies_of_the_how_tos(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write_risk()
    write_emergency(site="A" * 43)
    code, told = doctor(capsys, ".")
    assert (code, of("risk policy", told)[0][0]) == (5, "ok")
    ((level, message),) = of("emergency policy", told)
    assert (level, message.startswith("SITE_MISMATCH")) == ("unsafe", True)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"by": "operator-1"}, "ROLE_DENIED"),
        ({"by": "supervisor-1"}, "ROLE_DENIED"),
        ({"folder": emergency_policies.trust_folder()}, "CERTIFICATE_INVALID"),
        ({"policy": replace(scenarios.mission().risk_policy, tau_1=9, tau_2=8)}, "SCHEMA_INVALID"),
    ],
)
def test_a_risk_policy_that_the_gate_would_refuse_is_unsafe(
    demo: list[str],
    changes: dict[str, Any],
    reason: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, told = doctor(capsys, *demo, "--risk-policy", write_risk(**changes))
    ((level, message),) = of("risk policy", told)
    assert (code, level, message.split(":")[0]) == (5, "unsafe", reason)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"by": "operator-1"}, "ROLE_DENIED"),
        ({"by": "site-authority-1"}, "ROLE_DENIED"),
        ({"folder": emergency_policies.trust_folder()}, "CERTIFICATE_INVALID"),
        ({"robot": scenarios.OTHER}, "ROBOT_MISMATCH"),
        ({"site": "A" * 43}, "SITE_MISMATCH"),
        ({"profile": "A" * 43}, "PROFILE_MISMATCH"),
        ({"expiry": -1}, "EXPIRED"),
        ({"not_before": 1}, "NOT_YET_VALID"),
    ],
)
def test_an_emergency_policy_that_the_gate_would_refuse_is_unsafe(
    marked: list[str],
    changes: dict[str, Any],
    reason: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fields = {k: days(v) if isinstance(v, int) else v for k, v in changes.items()}
    token = write_emergency(**fields)
    code, told = doctor(capsys, *marked, "--emergency-policy", token)
    ((level, message),) = of("emergency policy", told)
    assert (code, level, message.split(":")[0]) == (5, "unsafe", reason)


def test_an_emergency_policy_that_is_not_narrow_is_unsafe(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    token = write_emergency({**emergency_policies.GO_SAFE, "destination": "office-1"})
    code, told = doctor(capsys, *marked, "--emergency-policy", token)
    ((level, message),) = of("emergency policy", told)
    assert (code, level) == (5, "unsafe")
    assert "emergency.capabilities[0].destination" in message


def test_an_emergency_policy_beyond_its_signers_scope_is_unsafe(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    token = write_emergency(by=short_lived("officer-2", regions=("dock",)))
    code, told = doctor(capsys, *marked, "--emergency-policy", token)
    ((level, message),) = of("emergency policy", told)
    assert (code, level, message.split(":")[0]) == (5, "unsafe", "SIGNER_OUT_OF_SCOPE")


@pytest.mark.parametrize("kind", ["--risk-policy", "--emergency-policy"])
def test_a_policy_dies_with_its_signer(
    marked: list[str], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    token = write_risk() if kind == "--risk-policy" else write_emergency()
    revoke(Path("trust"), principal="safety-officer-1", serial=None, now=datetime.now(UTC), days=30)
    code, told = doctor(capsys, *marked, kind, token)
    ((level, message),) = of(kind[2:].replace("-", " "), told)
    assert (code, level, message.split(":")[0]) == (5, "unsafe", "CERTIFICATE_REVOKED")


@pytest.mark.parametrize("data", [b"", b"{}", b"\xff", None])
@pytest.mark.parametrize("kind", ["--risk-policy", "--emergency-policy"])
def test_what_is_no_policy_is_unsafe(
    marked: list[str], kind: str, data: bytes | None, capsys: pytest.CaptureFixture[str]
) -> None:
    if data is not None:
        Path("junk").write_bytes(data)
    code, told = doctor(capsys, *marked, kind, "junk")
    ((level, _),) = of(kind[2:].replace("-", " "), told)
    assert (code, level) == (5, "unsafe")


def test_one_policy_is_not_the_other(marked: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--risk-policy", write_emergency(), "--emergency-policy", write_risk())
    code, told = doctor(capsys, *marked, *words)
    assert code == 5
    for part in ("risk policy", "emergency policy"):
        ((level, message),) = of(part, told)
        assert (level, message.split(":")[0]) == ("unsafe", "WRONG_KIND")


def test_a_policy_that_ends_within_thirty_days_is_warned_of(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    ends = days(29)
    code, told = doctor(capsys, *marked, "--emergency-policy", write_emergency(expiry=ends))
    ((level, message),) = of("emergency policy", told)
    assert (code, level) == (0, "warning")
    assert message.endswith(f"no gate starts with it after {ends}")
    token = write_emergency(expiry=days(31))
    _, told = doctor(capsys, *marked, "--emergency-policy", token)
    assert of("emergency policy", told)[0][0] == "ok"


@pytest.mark.parametrize("kind", ["--risk-policy", "--emergency-policy"])
def test_a_policy_whose_signers_certificate_ends_soon_is_warned_of(
    marked: list[str], kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    by = short_lived("officer-2")
    token = write_risk(by=by) if kind == "--risk-policy" else write_emergency(by=by)
    code, told = doctor(capsys, *marked, kind, token)
    ((level, message),) = of(kind[2:].replace("-", " "), told)
    assert (code, level) == (0, "warning")
    assert "no gate starts with it after" in message


def seen(**changes: Any) -> None:
    """Let the store see the organization's policy, as a gate that starts with it does."""
    trust = read_trust(Path("trust"))
    data = Path(write_risk(**changes)).read_bytes()
    policy = open_policy(data, verifier=trust, now=wall_now(None))
    gate = offline_gate(Path("trust"), scenarios.site(), rid=scenarios.RID, store=Path("robot.db"))
    gate.management.hold_policy(policy)
    gate.close()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 2}, None),
        ({"version": 3}, None),
        ({"version": 1}, "SUPERSEDED"),
        ({"version": 2, "issued": "2026-01-01T00:00:00Z"}, "SUPERSEDED"),
        ({"version": 3, "organization": "elsewhere"}, "ISSUER_MISMATCH"),
    ],
)
def test_a_risk_policy_is_held_to_what_the_store_has_seen(
    demo: list[str],
    changes: dict[str, Any],
    reason: str | None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    issued = days(-2)
    seen(issued=issued)
    before = Path("robot.db").read_bytes()
    token = write_risk(**{"issued": issued, **changes})
    code, told = doctor(capsys, *demo, "--risk-policy", token)
    bad = [message for level, message in of("risk policy", told) if level == "unsafe"]
    assert code == (0 if reason is None else 5)
    assert [message.split(":")[0] for message in bad] == ([] if reason is None else [reason])
    assert Path("robot.db").read_bytes() == before  # looking changes nothing


def test_a_gate_goes_back_to_no_risk_policy_never(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    seen()
    code, told = doctor(capsys, *demo)
    ((level, message),) = of("risk policy", told)
    assert (code, level, message.split(":")[0]) == (5, "unsafe", "SUPERSEDED")
    # who looks at a store alone has not said how a gate is started
    code, told = doctor(capsys, "--trust", "trust", "--store", "robot.db")
    assert (code, of("risk policy", told)) == (0, [])


def test_a_store_that_cannot_be_read_says_so_once(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("robot.db").write_bytes(b"junk" * 1_000)
    code, told = doctor(capsys, *demo, "--risk-policy", write_risk())
    assert (code, [level for level, _ in of("risk policy", told)]) == (5, ["ok"])
    assert {item["part"] for item in told["advice"] if item["level"] == "unsafe"} == {"store"}


def test_without_a_configuration_the_certificate_says_whose_policy_it_must_be(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    lifter = profile_digest(load_site(Path("site.yaml")).robots[scenarios.OTHER].profile)
    token = write_emergency(emergency_policies.CALL, robot=scenarios.OTHER, profile=lifter)
    words = ("--trust", "trust", "--site", "site.yaml", "--emergency-policy", token)
    for cert, levels in (
        (("--cert", "trust/keys/gate-courier-1.cert.pem"), "unsafe"),
        (("--cert", "trust/keys/gate-lifter-1.cert.pem"), None),
        (("--cert", "trust/keys/operator-1.cert.pem"), None),
        ((), None),
    ):
        _, told = doctor(capsys, *words, *cert)
        ((level, message),) = of("emergency policy", told)
        if levels is None:
            assert "ROBOT_MISMATCH" not in message
        else:
            assert (level, message.split(":")[0]) == (levels, "ROBOT_MISMATCH")


def test_policies_that_others_can_write_are_unsafe_on_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup = robot(tmp_path)
    policy = tmp_path / "gate" / "policy.token"
    policy.write_bytes(b"{}")
    policy.chmod(0o666)
    words = ("--trust", str(setup.trust), "--risk-policy", str(policy), "--user", str(ME))
    code, told = doctor(capsys, *words)
    assert (code, "WRITABLE" in codes(told, "unsafe")) == (5, True)


def test_a_policy_without_what_it_is_read_by_is_usage(
    demo: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert doctor(capsys, "--risk-policy", "policy.token")[0] == 2
    assert doctor(capsys, "--emergency-policy", "e.token", "--trust", "trust")[0] == 2
    site = demo[demo.index("--site") + 1]
    assert doctor(capsys, "--emergency-policy", "e.token", "--site", site)[0] == 2


def test_beside_a_broken_part_the_policies_are_no_second_finding(
    marked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--risk-policy", write_risk(), "--emergency-policy", write_emergency())
    Path("site.yaml").write_text("[")
    code, told = doctor(capsys, *marked, *words)
    assert (code, of("emergency policy", told)) == (5, [])
    (Path("trust") / "root.pem").write_text("junk")
    code, told = doctor(capsys, *marked, *words)
    assert (code, of("risk policy", told), "TRUST" in codes(told, "unsafe")) == (5, [], True)
