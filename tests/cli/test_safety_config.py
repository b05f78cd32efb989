# SPDX-License-Identifier: Apache-2.0
"""A safety configuration from what people write to what a gate reads; a slip signs nothing."""

from __future__ import annotations

import io
import json
import pwd
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.cli import call
from authguard_r.core.identifiers import (
    ActionType,
    Identifier,
    ObjectId,
    RegionId,
    VariableId,
)
from authguard_r.keys.trust import read_trust
from authguard_r.safety import (
    ExternalChecker,
    Rule,
    SafetyConfig,
    default_config,
    open_config,
    safety_digest,
)
from authguard_r.safety.config import Executable
from authguard_r.site.model import Site, profile_digest
from authguard_r.site.source import read_site, read_yaml
from fixtures import scenarios

SITE = ["--site", "h/site.yaml"]
MAKE = ["safety-config", "make", *SITE, "--robot", "courier-1", "--out", "s.yaml"]
#: A user that every machine has, besides root.
USER = next(entry for entry in pwd.getpwall() if 0 < entry.pw_uid < 65_534)
#: What is sound, so that what is added to it is the only fault.
SOUND = "robot: courier-1\n"


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *words: str, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call(list(words))
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out + out.err

    def json(self, *words: str) -> tuple[int, Any]:
        code, out = self(*words, "--json")
        return code, json.loads(out)


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    return Shell(capsys, monkeypatch)


def asking(by: str = "safety-officer-1", site: str = "h/site.yaml") -> list[str]:
    stem = f"trust/keys/{by}"
    keys = ["--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem"]
    return ["safety-config", "sign", "s.yaml", "--site", site, *keys]


def signing(by: str = "safety-officer-1", site: str = "h/site.yaml") -> list[str]:
    return [*asking(by, site), "--yes"]


def opened() -> SafetyConfig:
    """Return what a gate would read."""
    data = Path("s.token").read_bytes()
    return open_config(data, verifier=read_trust(Path("trust")), now=scenarios.NOW)


def site_without(*kinds: str) -> dict[str, Any]:
    """Return the hospital as plain data without some action types."""
    plain: Any = read_yaml((scenarios.HOSPITAL / "site.yaml").read_text(), where="site")
    for kind in kinds:
        del plain["vocabulary"][kind]
        for robot in plain["robots"].values():
            robot["profile"]["tools"].pop(kind, None)
    return dict(plain)


def envelope_of(site: Site) -> SafetyConfig:
    """Return the robot's own envelope as a form offers it: under the site's version."""
    return replace(default_config(site, scenarios.RID), version=site.version)


def test_what_is_made_and_signed_is_the_robots_own_envelope(shell: Shell) -> None:
    own = envelope_of(scenarios.site())
    code, made = shell.json(*MAKE)
    assert (code, made["digest"]) == (0, safety_digest(own))
    code, signed = shell.json(*signing(), "--trust", "trust")
    assert (code, signed["file"], signed["changed"]) == (0, "s.token", [])
    assert opened() == own
    code, shown = shell.json("safety-config", "show", "s.token", "--trust", "trust")
    assert (code, shown["valid"], shown["digest"]) == (0, True, safety_digest(own))


def test_what_is_left_out_or_empty_is_the_robots_own_and_shown(shell: Shell) -> None:
    code, made = shell(*MAKE)
    assert code == 0
    for left_out in ("", "max_speed:\nkeep_out:\nmasses:\nexecutable:\nrules:\nchecker:\n"):
        Path("s.yaml").write_text(SOUND + left_out)
        code, shown = shell(*signing())
        assert code == 0
        assert opened() == envelope_of(scenarios.site())
        assert shown.splitlines()[:-2] == made.splitlines()[:-1]
        assert "  keeps out of plant-room\n" in shown
        assert "  unlike the robot's own envelope: nothing\n" in shown


def test_every_field_of_a_configuration_can_be_said(shell: Shell) -> None:
    Path("s.yaml").write_text(
        "robot: lifter-1\nid: ward-3\nversion: 7\nmax_speed: 1.8 km/h\nmax_force: 12 N\n"
        "max_payload: 2 kg\nhuman_distance: 150 cm\nhuman_speed: 0.2 m/s\nmax_age: 0.5 s\n"
        "masses: {package-p1: 800 g, sharps-bin: 1600}\nkeep_out: [office-2, office-1, office-1]\n"
        "executable: [{type: navigate, variable: docked, equals: nobody}]\n"
        "paced: {wait: 10 mm/s}\nin_place: [place, pick]\n"
        "rules:\n  - {id: home, formula: F destination = dock, message: to the dock}\n"
        f"checker: {{id: mine, socket: /run/c.sock, timeout: 40 ms, uid: {USER.pw_name}}}\n"
    )
    code, signed = shell.json(*signing())
    wanted = SafetyConfig(
        schema="authguard-r/safety/1",
        id=Identifier("ward-3"),
        version=7,
        rid=scenarios.OTHER,
        profile=profile_digest(scenarios.site().robots[scenarios.OTHER].profile),
        max_speed_mm_s=500,
        max_force_mn=12_000,
        max_payload_g=2_000,
        masses_g={ObjectId("package-p1"): 800, ObjectId("sharps-bin"): 1_600},
        keep_out=(RegionId("office-1"), RegionId("office-2")),
        human_distance_mm=1_500,
        human_speed_mm_s=200,
        max_age_ms=500,
        executable=(
            Executable(type=ActionType("navigate"), variable=VariableId("docked"), equals="nobody"),
        ),
        paced={ActionType("wait"): 10},
        in_place=(ActionType("pick"), ActionType("place")),
        rules=(Rule(id="home", formula="F destination = dock", message="to the dock"),),
        checker=ExternalChecker(id="mine", socket="/run/c.sock", timeout_ms=40, uid=USER.pw_uid),
    )
    assert (code, opened()) == (0, wanted)
    same = {"schema", "id", "version", "rid", "profile"}
    assert set(signed["changed"]) == set(SafetyConfig.__struct_fields__) - same


def test_what_is_wider_than_the_robots_own_is_told_before_anybody_signs(shell: Shell) -> None:
    Path("s.yaml").write_text(SOUND + "max_speed: 2 m/s\nkeep_out: []\nid: loose\nversion: 9\n")
    code, shown = shell(*asking(), stdin=b"y\n")
    assert code == 0
    assert "  speed at most 2 m/s\n" in shown
    assert "  keeps out of no region\n" in shown
    assert "  unlike the robot's own envelope: max_speed_mm_s, keep_out\n" in shown


def test_signing_asks_and_no_is_no(shell: Shell) -> None:
    shell(*MAKE)
    for answer in (b"n\n", b""):
        assert shell(*asking(), stdin=answer)[0] == 2
        assert not Path("s.token").exists()
    assert shell(*asking(), "--out", "t.token", stdin=b"y\n")[0] == 0
    assert Path("t.token").exists()


@pytest.mark.parametrize("by", ["operator-1", "supervisor-1", "site-authority-1"])
def test_nobody_but_a_safety_officer_signs(shell: Shell, by: str) -> None:
    shell(*MAKE)
    for trust in ([], ["--trust", "trust"]):
        code, refused = shell.json(*signing(by), *trust)
        assert (code, refused["error"]["code"]) == (1, "ROLE_DENIED")
    assert not Path("s.token").exists()


FAULTS = [
    ("robot: [", 4, "s.yaml"),
    ("id: ward-3\n", 4, "s.yaml"),
    (SOUND + "speed: 1 m/s\n", 4, "s.yaml"),
    (SOUND + "profile: AAAA\n", 4, "s.yaml"),
    ("robot: courier-9\n", 4, "s.yaml:robot"),
    (SOUND + "version: -1\n", 4, "s.yaml:version"),
    (SOUND + "max_speed: 1.5\n", 3, "s.yaml:max_speed"),
    (SOUND + "max_speed: 1 kg\n", 4, "s.yaml:max_speed"),
    (SOUND + "max_speed: 1/3 m/s\n", 4, "s.yaml:max_speed"),
    (SOUND + "max_speed: true\n", 4, "s.yaml:max_speed"),
    (SOUND + "max_speed: -1 m/s\n", 4, "s.yaml:max_speed_mm_s"),
    (SOUND + "human_distance: '2'\n", 3, "s.yaml:human_distance"),
    (SOUND + "masses: {package-p1: '800'}\n", 3, "s.yaml:masses.package-p1"),
    (SOUND + "masses: {package-p9: 1 kg}\n", 4, "s.yaml:masses"),
    (SOUND + "keep_out: [office-1, ofice-2]\n", 4, "s.yaml:keep_out"),
    (SOUND + "keep_out: plant-room\n", 4, "s.yaml:keep_out"),
    (SOUND + "in_place: [pik]\n", 4, "s.yaml:in_place"),
    (SOUND + "paced: {hover: 1 m/s}\n", 4, "s.yaml:paced"),
    (
        SOUND + "executable: [{type: pik, variable: holding, equals: nothing}]\n",
        4,
        "s.yaml:executable[0].type",
    ),
    (SOUND + "executable: [{type: pick, variable: holding}]\n", 4, "s.yaml:executable[0]"),
    (SOUND + "rules: [{id: a}]\n", 4, "s.yaml:rules[0]"),
    (SOUND + "rules: [{id: a, formula: G type}]\n", 4, "s.yaml:rules[0].formula:7"),
    (
        SOUND + "rules: [{id: a, formula: 'true'}, {id: b, formula: 'false'}]\n",
        4,
        "s.yaml:rules[1].formula",
    ),
    (SOUND + "rules: [{id: a, formula: !x}]\n", 4, "s.yaml"),
    (
        SOUND + "rules: [{id: a, formula: 'true'}, {id: a, formula: 'true'}]\n",
        4,
        "s.yaml:rules",
    ),
    (SOUND + f"rules: [{{id: a, formula: '{'x' * 1_001}'}}]\n", 4, "s.yaml:rules[0].formula"),
    (SOUND + 'rules: [{id: a, formula: "true", message: "a\\nb"}]\n', 4, "s.yaml:rules[0].message"),
    (SOUND + "checker: {id: c, socket: /run/c, timeout: '50'}\n", 3, "s.yaml:checker.timeout"),
    (SOUND + "checker: {id: c, socket: /run/c, timeout: 0 ms}\n", 4, "s.yaml:checker.timeout_ms"),
    (SOUND + "checker: {id: c, socket: /run/c, timeout: 2 s}\n", 4, "s.yaml:checker.timeout_ms"),
    (SOUND + "checker: {id: c, socket: run/c, timeout: 1 s}\n", 4, "s.yaml:checker.socket"),
    (SOUND + "checker: {id: c, socket: /r c, timeout: 1 s}\n", 4, "s.yaml:checker.socket"),
    (
        SOUND + f"checker: {{id: c, socket: /{'c' * 107}, timeout: 1 s}}\n",
        4,
        "s.yaml:checker.socket",
    ),
    (SOUND + "checker: {id: c, timeout: 1 s}\n", 4, "s.yaml:checker"),
    (
        SOUND + "checker: {id: c, socket: /run/c, timeout: 1 s, uid: no-such-user-here}\n",
        4,
        "s.yaml:checker.uid",
    ),
    (
        SOUND + 'checker: {id: c, socket: /run/c, timeout: 1 s, uid: "a\\0b"}\n',
        4,
        "s.yaml:checker.uid",
    ),
    (SOUND + "checker: {id: c, socket: /run/c, timeout: 1 s, uid: -1}\n", 4, "s.yaml:checker.uid"),
    (
        SOUND + f"checker: {{id: c, socket: /run/c, timeout: 1 s, uid: '{'9' * 900}'}}\n",
        4,
        "s.yaml:checker.uid",
    ),
]


@pytest.mark.parametrize(
    ("text", "code", "where"), FAULTS, ids=[fault[0][-40:] for fault in FAULTS]
)
def test_what_cannot_be_is_refused_with_its_place(
    shell: Shell, text: str, code: int, where: str
) -> None:
    Path("s.yaml").write_text(text)
    got, refused = shell.json(*signing())
    assert (got, refused["error"]["where"]) == (code, where)
    assert not Path("s.token").exists()


@pytest.mark.parametrize(
    "formula",
    [
        "F destination = dokc",
        "G !type = hover",
        "G object != package-p9",
        "G !route contains attic",
        "G params.speed <= 5",
    ],
)
def test_a_rule_of_words_that_the_site_does_not_have_is_not_signed(
    shell: Shell, formula: str
) -> None:
    sound = "rules: [{id: a, formula: F destination = dock}, {id: b, formula: '%s'}]\n"
    Path("s.yaml").write_text(SOUND + sound % formula)
    code, refused = shell.json(*signing())
    assert (code, refused["error"]["code"]) == (4, "NAME_UNKNOWN")
    assert refused["error"]["where"] == "s.yaml:rules[1].formula"
    assert not Path("s.token").exists()


def test_more_rules_than_a_gate_follows_are_too_many(shell: Shell) -> None:
    rules = [{"id": f"r{number}", "formula": "true"} for number in range(33)]
    Path("s.yaml").write_text(json.dumps({"robot": "courier-1", "rules": rules}))
    code, refused = shell.json(*signing())
    assert (code, refused["error"]["code"]) == (4, "INPUT_TOO_LARGE")
    assert refused["error"]["where"] == "s.yaml:rules"


def test_the_card_names_rules_and_the_checker_and_cannot_be_forged(shell: Shell) -> None:
    Path("s.yaml").write_text(
        SOUND + "rules:\n"
        "  - {id: plain, formula: F destination = dock}\n"
        "  - {id: said, formula: F destination = dock, message: 'x\" message \"y'}\n"
        f"checker: {{id: mine, socket: /run/c, timeout: 51 ms, uid: {USER.pw_uid}}}\n"
    )
    code, shown = shell(*signing())
    assert code == 0
    assert '  rule plain: "F destination = dock"\n' in shown
    assert '  rule said: "F destination = dock", message "x\\u{22} message \\u{22}y"\n' in shown
    assert f"  asks mine at /run/c, user {USER.pw_uid} ({USER.pw_name}), within 0.051 s\n" in shown
    assert "NOT FOR `authguard gate`: it takes a checker that answers within 0.05 s" in shown


def test_a_checkers_user_is_a_number_that_this_machine_may_not_know(shell: Shell) -> None:
    taken = {entry.pw_uid for entry in pwd.getpwall()}
    free = next(number for number in range(70_000, 80_000) if number not in taken)
    for uid, told in ((f"uid: {free}", f"user {free} (no such user here)"), ("", "the gate's own")):
        Path("s.yaml").write_text(
            SOUND + f"checker: {{id: mine, socket: /run/c, timeout: 50 ms, {uid}}}\n"
        )
        code, shown = shell(*signing())
        assert (code, told in shown, "NOT FOR" in shown) == (0, True, False)


def test_what_is_made_says_what_it_means_whatever_things_are_called(shell: Shell) -> None:
    plain = site_without("pick", "place")  # of which every envelope speaks
    room = plain["regions"]["plant-room"]
    for number, name in enumerate(
        ("123", "null", "yes", "1.5", "12:30", "0x1f", "1e3", "2026-01-01")
    ):
        plain["objects"][name] = {"kind": "medicine", "home": "dock", "mass_g": 7}
        plain["regions"][name] = {**room, "map": f"map-{number}", "names": []}
    plain["vocabulary"] |= {
        "on": {"fields": []},
        "clean": {"fields": []},
        "go": {"moves": True, "fields": []},
    }
    Path("odd.yaml").write_text(json.dumps(plain))
    own = envelope_of(read_site(Path("odd.yaml")))
    assert (own.paced, own.in_place) == ({"go": 1500}, ("clean",))
    assert shell(*MAKE, "--site", "odd.yaml")[0] == 0
    assert shell(*signing(site="odd.yaml"))[0] == 0
    assert opened() == own


def test_a_robot_that_the_site_does_not_have_gets_nothing(shell: Shell) -> None:
    code, refused = shell.json(*MAKE, "--robot", "courier-2")
    assert (code, refused["error"]["code"]) == (4, "NAME_UNKNOWN")
    assert refused["error"]["where"] == "--robot"
    assert "`courier-1`" in refused["error"]["message"]
    assert not Path("s.yaml").exists()


def test_with_a_root_the_site_has_to_be_authentic(shell: Shell) -> None:
    shell(*MAKE)
    stem = "trust/keys/site-authority-1"
    keys = ["--key", f"{stem}.key.pem", "--cert", f"{stem}.cert.pem"]
    assert shell("site", "sign", "h/site.yaml", *keys, "--out", "site.token")[0] == 0
    assert shell(*signing(site="site.token"), "--trust", "trust")[0] == 0
    data = Path("site.token").read_bytes()
    Path("site.token").write_bytes(data.replace(b'"signature":"', b'"signature":"AA', 1))
    Path("s.token").unlink()
    assert shell(*signing(site="site.token"), "--trust", "trust")[0] == 4
    assert not Path("s.token").exists()


def test_a_token_of_another_kind_or_signature_is_none(shell: Shell) -> None:
    Path("m.token").write_bytes(scenarios.token())
    for trust in ([], ["--trust", "trust"]):
        code, refused = shell.json("safety-config", "show", "m.token", *trust)
        assert (code, refused["error"]["code"]) == (4, "WRONG_KIND")
    shell(*MAKE)
    shell(*signing())
    code, shown = shell("safety-config", "show", "s.token")
    assert (code, shown.splitlines()[0].startswith("not verified")) == (0, True)
    code, told = shell.json("safety-config", "show", "s.token")
    assert (code, told["valid"]) == (0, None)
    data = Path("s.token").read_bytes()
    Path("s.token").write_bytes(data.replace(b'"signature":"', b'"signature":"AA', 1))
    assert shell("safety-config", "show", "s.token", "--trust", "trust")[0] == 4
    assert shell("safety-config", "show", "nowhere.token")[0] == 5


def test_a_place_that_cannot_be_written_to_is_an_error(shell: Shell) -> None:
    shell(*MAKE)
    Path("taken").mkdir()
    assert shell(*signing(), "--out", "taken")[0] == 5
    assert shell(*MAKE[:-1], "nowhere/s.yaml")[0] == 5
    assert list(Path("taken").iterdir()) == []
