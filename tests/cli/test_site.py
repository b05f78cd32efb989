# SPDX-License-Identifier: Apache-2.0
"""`authguard site` as authors and site authorities call it: exit codes, shapes, refusals."""

from __future__ import annotations

import io
import json
import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.authoring.keys.setup import AUTHORITIES
from authguard_r.cli import call
from authguard_r.core.quantities import to_timestamp
from authguard_r.keys.certificate import build_authority, build_leaf, build_root
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import site_digest
from fixtures import scenarios

AUTHORITY = [
    "--key",
    "trust/keys/site-authority-1.key.pem",
    "--cert",
    "trust/keys/site-authority-1.cert.pem",
]
GRAPH = {
    "regions": [{"name": "Hall", "coords": [0, 0]}, {"name": "Yard", "coords": [4, 0]}],
    "objects": [{"name": "lamp", "coords": [0, 0]}],
    "object_connections": [["lamp", "Hall"]],
    "region_connections": [["Hall", "Yard"]],
}


class Shell:
    """One working folder with the hospital in it, and what the last command printed."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str], patch: Any) -> None:
        self.folder = folder
        self._capsys = capsys
        self._patch = patch

    def __call__(self, *arguments: str, stdin: bytes = b"") -> tuple[int, str]:
        self._patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        code = call(list(arguments))
        out = self._capsys.readouterr()
        assert "Traceback" not in out.out + out.err
        return code, out.out or out.err

    def json(self, *arguments: str, stdin: bytes = b"") -> tuple[int, Any]:
        code, out = self(*arguments, "--json", stdin=stdin)
        return code, json.loads(out)

    def refused(self, *arguments: str) -> tuple[int, str, str]:
        """Return the exit code, the reason and the place of an error."""
        code, out = self.json(*arguments)
        return code, out["error"]["code"], out["error"]["where"]


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> Shell:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(scenarios.HOSPITAL, tmp_path / "h")
    shutil.copytree(scenarios.trust_folder(), tmp_path / "trust")
    for path in (tmp_path / "trust" / "keys").glob(f"*{scenarios.OTHER}*"):
        path.unlink()
    return Shell(tmp_path, capsys, monkeypatch)


@pytest.fixture
def token(shell: Shell) -> str:
    code, made = shell.json("site", "sign", "h/site.yaml", *AUTHORITY, "--out", "s.token")
    assert (code, made) == (0, {"file": "s.token", "digest": site_digest(scenarios.site())})
    return "s.token"


def certify_for_work(folder: Path) -> None:
    """Certify a demo set-up's keys anew, under a root that does not say `demo`."""
    now = datetime.fromtimestamp(scenarios.START_MS / 1000 - 86_400, UTC)
    old, at = read_trust(folder), scenarios.NOW
    keys = {
        path.name.removesuffix(".key.pem"): load_pem_private_key(path.read_bytes(), None)
        for path in (folder / "keys").glob("*.key.pem")
    }
    root_key: Any = keys["root"]
    root = build_root(root_key, name="Hospital root", now=now, days=365)
    authorities = {}
    for name, roles in AUTHORITIES.items():
        key: Any = keys[name]
        certificate = build_authority(
            key.public_key(), name=name, roles=roles, issuer=root, key=root_key, now=now, days=365
        )
        authorities[name] = (key, certificate)
        (folder / "authorities" / f"{name}.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    for path in (folder / "keys").glob("*.cert.pem"):
        chain = x509.load_pem_x509_certificates(path.read_bytes())
        leaf = old.identify(tuple(c.public_bytes(Encoding.DER) for c in chain), at)
        member: Any = keys[path.name.removesuffix(".cert.pem")]
        issuer_key, issuer = next(
            authorities[name] for name, roles in AUTHORITIES.items() if leaf.role in roles
        )
        certificate = build_leaf(
            member.public_key(),
            principal=leaf.principal,
            role=leaf.role,
            issuer=issuer,
            key=issuer_key,
            now=now,
            days=365,
            robots=leaf.scope.robots and tuple(leaf.scope.robots),
            regions=leaf.scope.regions and tuple(leaf.scope.regions),
            profile=leaf.profile,
        )
        path.write_bytes(b"".join(c.public_bytes(Encoding.PEM) for c in (certificate, issuer)))
    (folder / "root.pem").write_bytes(root.public_bytes(Encoding.PEM))


def mission(shell: Shell, site: str) -> None:
    """Compile and sign the hospital's mission as `m.token`."""
    at = to_timestamp(scenarios.START_MS)
    compiled = ("mission", "compile", "h/mission.yaml", "--site", site, "--out", "m.json")
    assert shell(*compiled, "--now", at)[0] == 0
    keys = ("--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem")
    assert shell("mission", "sign", "m.json", *keys, "--yes", "--out", "m.token")[0] == 0


def decide(shell: Shell, site: str) -> tuple[int, Any]:
    """Ask whether the robot may look around."""
    plain = {"type": "scan_obstacles", "tool": "lidar"}
    (shell.folder / "a.json").write_text(json.dumps(plain))
    asked = ("--trust", "trust", "--token", "m.token", "--action", "a.json", "--site", site)
    return shell.json("decide", *asked, "--now", to_timestamp(scenarios.START_MS))


# -- check and show --------------------------------------------------------------------------------


def test_check_names_every_fault_at_once(shell: Shell) -> None:
    text = (shell.folder / "h" / "site.yaml").read_text()
    broken = text.replace("tags: [hazardous]", "tags: [z, a]").replace(
        "home: station-102", "home: cellar"
    )
    (shell.folder / "b.yaml").write_text(broken)
    code, found = shell.json("site", "check", "b.yaml")
    assert code == 4
    assert [fault["where"] for fault in found["faults"]] == [
        "regions.plant-room.tags",
        "objects.sharps-bin.home",
    ]
    code, out = shell("site", "check", "b.yaml")
    assert (code, out.count("\n")) == (4, 2)
    assert shell("site", "check", "h/site.yaml")[0] == 0


def test_check_names_what_the_default_risk_policy_does_not_list(shell: Shell) -> None:
    text = (shell.folder / "h" / "site.yaml").read_text()
    assert text.count("kind: medicine") == 2
    (shell.folder / "t.yaml").write_text(text.replace("kind: medicine", "kind: tote", 1))
    code, found = shell.json("site", "check", "t.yaml")
    (note,) = found["notes"]
    assert (code, "object class `tote` (`package-p1`)" in note) == (0, True)
    assert "from 60 on 3 people" in note
    assert "set_pose" not in note  # no mission can grant it
    assert shell("site", "check", "t.yaml")[1].splitlines()[1] == f"note: {note}"


def test_check_names_every_schema_fault_at_once_with_the_allowed_values(shell: Shell) -> None:
    text = (shell.folder / "h" / "site.yaml").read_text()
    for old, new in (
        ("approach: [17000, 1500]", "approach: [17000, x]"),  # of the public corridor
        ("station-101:\n    {map: main", "station-101:\n    {mop: main"),
        ("  pick:\n", "  pick:\n    physical: much\n"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    (shell.folder / "bad.yaml").write_text(text)
    code, answer = shell.json("site", "check", "bad.yaml")
    assert code == 4
    assert [(fault["where"], fault["message"]) for fault in answer["faults"]] == [
        ("regions.public-corridor.approach[1]", "expected a whole number, got text"),
        (
            "regions.station-101",
            (
                "object contains unknown field `mop` (did you mean `map`?); allowed: "
                "approach, floor, map, names, points, tags, within"
            ),
        ),
        ("regions.station-101", "object missing required field `map`"),
        ("vocabulary.pick.physical", "expected a whole number, got text"),
    ]
    assert answer["error"]["where"] == "bad.yaml:regions.public-corridor.approach[1]"
    code, answer = shell.json("site", "check", "h/binding.yaml")
    assert "expected `authguard-r/site/1`" in answer["error"]["message"]


def test_check_takes_words_from_the_standard_vocabulary(shell: Shell) -> None:
    text = (shell.folder / "h" / "site.yaml").read_text()
    (shell.folder / "w.yaml").write_text(f"{text}words: [open, close]\n")
    code, shown = shell.json("site", "show", "w.yaml")
    assert code == 0
    assert {"open", "close", "navigate"} <= set(shown["vocabulary"])
    (shell.folder / "w.yaml").write_text(f"{text}words: [fly]\n")
    assert shell.refused("site", "check", "w.yaml") == (4, "MALFORMED", "w.yaml:words[0]")


def test_show_draws_a_map_and_tells_the_rest(shell: Shell) -> None:
    code, shown = shell.json("site", "show", "h/site.yaml", "--svg", "map.svg")
    assert code == 0
    assert shown["digest"] == site_digest(scenarios.site())
    assert shown["model"]["regions"]["dock"]["approach"] == [36000, 1500]
    assert ["dock", "public-corridor"] in [pair["between"] for pair in shown["adjacent"]]
    assert (shell.folder / "map.svg").read_text().startswith("<svg ")
    text = (shell.folder / "h" / "site.yaml").read_text()
    more = (
        "people:\n  ann: {roles: [operator], names: [Ann]}\n"
        "emergency: {places: {dock: charging}}\nbaseline: [announce]\n"
    )
    braked = "max_speed_mm_s: 1500\n      brake_mm_s2: 900\n      reaction_ms: 200"
    (shell.folder / "m.yaml").write_text(text.replace("max_speed_mm_s: 1500", braked) + more)
    code, out = shell("site", "show", "m.yaml")
    assert code == 0
    for line in ("ann", "dock                 charging", "  announce", "stops within 1550 mm"):
        assert line in out


# -- diff ------------------------------------------------------------------------------------------


def test_diff_says_nothing_of_one_site_and_tells_a_moved_name_first(
    shell: Shell, token: str
) -> None:
    code, found = shell.json("site", "diff", "h/site.yaml", token)
    assert (code, found["changes"]) == (0, [])
    text = (shell.folder / "h" / "site.yaml").read_text()
    swapped = text.replace("Billing Office", "Charging Desk").replace(
        "Charging Dock", "Billing Office"
    )
    (shell.folder / "n.yaml").write_text(swapped.replace("version: 1", "version: 2"))
    code, found = shell.json("site", "diff", "h/site.yaml", "n.yaml")
    assert code == 1
    first = found["changes"][0]
    assert (first["effect"], first["old"], first["new"]) == ("meaning", "office-2", "dock")
    assert found["changes"][-1]["effect"] == "counts"
    code, out = shell("site", "diff", "h/site.yaml", "n.yaml")
    assert (code, out.splitlines()[0][:7]) == (1, "MEANING")


# -- import ----------------------------------------------------------------------------------------


def test_an_imported_scene_is_sound_and_is_not_signed_before_somebody_looked(shell: Shell) -> None:
    (shell.folder / "My Scene.json").write_text(json.dumps(GRAPH))
    code, made = shell.json("site", "import", "scene-graph", "My Scene.json", "--out", "i.yaml")
    assert code == 0
    assert (made["site"], made["regions"]) == ("my-scene", ["hall", "yard", "way-1"])
    code, found = shell.json("site", "check", "i.yaml")
    assert (code, found["faults"]) == (0, [])
    assert "objects.lamp.kind" in found["unreviewed"]
    code, reason, where = shell.refused("site", "sign", "i.yaml", *AUTHORITY)
    assert (code, reason, where) == (4, "MALFORMED", "i.yaml:regions.hall.tags")
    assert not (shell.folder / "i.token").exists()
    reviewed = (shell.folder / "i.yaml").read_text().replace("unreviewed", "public")
    (shell.folder / "i.yaml").write_text(
        f"{reviewed}words: standard\n".replace("vocabulary: {}\n", "")
    )
    assert shell("site", "sign", "i.yaml", *AUTHORITY)[0] == 0
    assert shell("site", "verify", "i.token", "--trust", "trust")[0] == 0


def test_an_imported_map_is_sound(shell: Shell) -> None:
    cells = bytes([0] * 10 + ([0] + [254] * 8 + [0]) * 8 + [0] * 10)
    (shell.folder / "hall.pgm").write_bytes(b"P5 10 10 255\n" + cells)
    (shell.folder / "hall.yaml").write_text(
        "image: hall.pgm\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    made = ("site", "import", "nav2-map", "hall.yaml", "--out", "i.yaml", "--floor", "2")
    code, found = shell.json(*made, "--id", "hall-2", "--min-area", "15.5")
    assert (code, found["site"], found["regions"]) == (0, "hall-2", ["area-1"])
    assert shell("site", "check", "i.yaml")[0] == 0
    assert shell.refused(*made, "--min-area", "17")[0] == 4


@pytest.mark.parametrize(
    "options",
    [
        ["--radius", "x"],
        ["--radius", "nan"],
        ["--radius", "0.01"],
        ["--radius", "-1"],
        ["--radius", "1e999999"],
        ["--id", "§"],
        ["--floor", "x"],
    ],
)
def test_an_option_that_means_nothing_is_wrong_usage(shell: Shell, options: list[str]) -> None:
    (shell.folder / "g.json").write_text(json.dumps(GRAPH))
    made = ("site", "import", "scene-graph", "g.json", "--out", "i.yaml")
    assert shell.refused(*made, *options)[:2] == (2, "USAGE")
    assert not (shell.folder / "i.yaml").exists()


def test_a_refused_import_writes_nothing(shell: Shell) -> None:
    (shell.folder / "g.json").write_text("{")
    made = ("site", "import", "scene-graph", "g.json", "--out", "i.yaml")
    assert shell.refused(*made) == (4, "MALFORMED", "g.json")
    (shell.folder / "g.json").write_bytes(b"\xff")
    assert shell.refused(*made)[0] == 4
    assert not (shell.folder / "i.yaml").exists()
    assert shell.refused("site", "import", "nav2-map", "none.yaml", "--out", "i.yaml")[0] == 5


# -- sign and verify -------------------------------------------------------------------------------


def test_a_signed_site_says_whose_it_is(shell: Shell, token: str) -> None:
    code, found = shell.json("site", "verify", token, "--trust", "trust")
    assert code == 0
    assert (found["valid"], found["signer"], found["role"]) == (
        True,
        "site-authority-1",
        "site_authority",
    )
    assert found["digest"] == site_digest(scenarios.site())
    assert shell("site", "check", token)[0] == shell("site", "show", token)[0] == 0


def test_an_operator_s_signature_makes_no_site(shell: Shell) -> None:
    keys = ("--key", "trust/keys/operator-1.key.pem", "--cert", "trust/keys/operator-1.cert.pem")
    assert shell("site", "sign", "h/site.yaml", *keys, "--out", "o.token")[0] == 0
    assert shell.refused("site", "verify", "o.token", "--trust", "trust")[:2] == (4, "ROLE_DENIED")


def test_plain_yaml_is_no_signed_site(shell: Shell) -> None:
    assert shell.refused("site", "verify", "h/site.yaml", "--trust", "trust")[0] == 4


def test_a_signed_site_serves_wherever_a_plain_one_does(shell: Shell, token: str) -> None:
    mission(shell, token)
    code, answer = decide(shell, token)
    assert code in {0, 1}
    assert (code, answer["reasons"]) == (decide(shell, "h/site.yaml")[0], answer["reasons"])
    assert "SITE_MISMATCH" not in answer["reasons"]


def test_the_attack_a_forged_site_beside_a_trust_root_is_refused_by_every_command(
    shell: Shell, token: str
) -> None:
    """The office is moved onto the dock's name, and the signature is kept."""
    mission(shell, token)
    real = json.loads((shell.folder / token).read_text())
    text = (shell.folder / "h" / "site.yaml").read_text()
    (shell.folder / "f.yaml").write_text(text.replace("version: 1", "version: 2"))
    assert shell("site", "sign", "f.yaml", *AUTHORITY, "--out", "f.token")[0] == 0
    forged = json.loads((shell.folder / "f.token").read_text())
    mixed = {**forged, "endorsements": real["endorsements"]}
    (shell.folder / "x.token").write_text(
        json.dumps(mixed, sort_keys=True, separators=(",", ":")) + "\n"
    )
    asked = ("--trust", "trust", "--site", "x.token", "--store", "r.db")
    assert decide(shell, "x.token")[1]["error"]["code"] == "SIGNATURE_INVALID"
    for command in (
        ("run", "--token", "m.token", "--binding", "h/binding.yaml", "--plan", "a.json"),
        ("stop",),
        ("mission", "activate", "m.token"),
    ):
        assert shell.refused(*command, *asked)[:2] == (4, "SIGNATURE_INVALID")
    assert not (shell.folder / "r.db").exists()
    normalize = ("normalize", "--binding", "h/binding.yaml", "--token", "m.token")
    assert shell.refused(*normalize, *asked[:4])[:2] == (4, "SIGNATURE_INVALID")


def test_outside_demonstration_only_a_signed_site_is_taken(shell: Shell, token: str) -> None:
    """Who can write the file could move the walls under a signed mission."""
    certify_for_work(shell.folder / "trust")
    assert not read_trust(shell.folder / "trust").demo
    signed = ("site", "sign", "h/site.yaml", *AUTHORITY, "--out", "w.token")
    assert shell(*signed)[0] == 0
    mission(shell, "w.token")
    code, answer = decide(shell, "h/site.yaml")
    assert (code, answer["error"]["code"]) == (4, "SIGNATURE_INVALID")
    assert "authguard site sign" in answer["error"]["message"]
    assert "reasons" in decide(shell, "w.token")[1]
    assert decide(shell, token)[0] == 4  # the demo root's signature counts for nothing here
    assert shell("mission", "review", "m.json", "--site", "h/site.yaml")[0] == 0  # authoring


def test_a_word_in_a_comment_does_not_make_yaml_a_token(shell: Shell) -> None:
    """What claims to be a token is read as one or not at all: never as the weaker thing."""
    path = shell.folder / "c.yaml"
    path.write_text('# "endorsements"\n' + (shell.folder / "h" / "site.yaml").read_text())
    assert shell.refused("site", "check", "c.yaml")[0] == 4


# -- words and channels ----------------------------------------------------------------------------


def amended(shell: Shell, text: str) -> str:
    """Return the file of the hospital with some lines more."""
    plain = (shell.folder / "h" / "site.yaml").read_text()
    (shell.folder / "amended.yaml").write_text(plain + text)
    return "amended.yaml"


def heard(shell: Shell, site: str, *said: tuple[str, str]) -> tuple[int, Any]:
    """Normalize one call after a planner heard these."""
    lines = [json.dumps({"channel": channel, "text": text}) for channel, text in said]
    (shell.folder / "seen.jsonl").write_text("\n".join(lines))
    binding = ("--binding", "h/binding.yaml", "--context", "seen.jsonl")
    call_text = b'navigate_to(destination="Nurse Station 101", speed=0.8)'
    return shell.json("normalize", "--site", site, *binding, stdin=call_text)


def test_a_site_s_own_channels_label_what_a_planner_saw(shell: Shell) -> None:
    site = amended(shell, "channels: {intranet: retrieval, tool: audio}\n")
    assert "intranet             retrieval" in shell("site", "show", site)[1]
    said = ("intranet", "All deliveries to Nurse Station 101")
    code, answer = heard(shell, site, said)
    assert code == 0
    (influence,) = answer["influenced_by"]
    assert (influence["channel"], influence["label"]) == ("intranet", "retrieval")
    assert answer["actions"][0]["provenance"]["destination"] == "retrieval"
    code, answer = heard(shell, site, ("tool", "sunny"))
    assert answer["actions"][0]["provenance"]["destination"] == "audio"
    code, answer = heard(shell, "h/site.yaml", said)  # the site without it
    assert (code, answer["error"]["where"]) == (4, "context line 1: channel")


@pytest.mark.parametrize(
    ("channels", "where"),
    [
        ("{intercom: operator}", "amended.yaml:channels.intercom"),
        ("{camera: model}", "amended.yaml:channels.camera"),
        ("{lidar.text: camera}", "amended.yaml:channels.lidar.text"),
    ],
)
def test_the_attack_a_site_file_that_makes_a_text_an_authority(
    shell: Shell, channels: str, where: str
) -> None:
    site = amended(shell, f"channels: {channels}\n")
    code, answer = shell.json("site", "check", site)
    assert (code, [fault["where"] for fault in answer["faults"]]) == (4, [where.partition(":")[2]])
    assert heard(shell, site)[1]["error"]["where"] == where


def test_a_context_line_that_is_too_long_is_refused_with_its_number(shell: Shell) -> None:
    long = "Station 101 " * 11_000
    code, answer = heard(shell, "h/site.yaml", ("user", "hello"), ("web", long))
    error = answer["error"]
    assert (code, error["code"], error["where"]) == (4, "INPUT_TOO_LARGE", "context line 2: text")


def test_a_context_file_that_is_too_long_is_refused(shell: Shell) -> None:
    said = [("web", "x" * 100_000)] * 170
    code, answer = heard(shell, "h/site.yaml", *said)
    error = answer["error"]
    assert (code, error["code"], error["where"]) == (4, "INPUT_TOO_LARGE", "seen.jsonl")


def test_what_a_word_can_do_at_worst_is_shown(shell: Shell) -> None:
    text = (shell.folder / "h" / "site.yaml").read_text()
    (shell.folder / "worse.yaml").write_text(
        text.replace("  pick:\n", "  pick:\n    physical: 2\n")
    )
    assert "pick                 physical 2, privacy 0" in shell("site", "show", "worse.yaml")[1]
    code, answer = shell.json("site", "diff", "h/site.yaml", "worse.yaml")
    (change,) = answer["changes"]
    assert (code, change["effect"], change["where"]) == (1, "meaning", "vocabulary.pick.physical")


def test_a_file_of_another_kind_is_named(shell: Shell) -> None:
    (shell.folder / "b.yaml").write_bytes((shell.folder / "h" / "binding.yaml").read_bytes())
    code, out = shell("site", "check", "b.yaml")
    assert (code, "this file is a binding: got " in out) == (4, True)
    assert "expected `authguard-r/site/1`" in out
    code, out = shell("mission", "compile", "h/site.yaml", "--site", "h/site.yaml")
    assert (code, "this file is a site file, expected a draft" in out) == (4, True)
