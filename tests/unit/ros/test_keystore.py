# SPDX-License-Identifier: Apache-2.0
"""A keystore lets the gate's process alone move the robot, or the check says who else could.

Source: lessons L1, L7, L21; docs/spec/ros-map.md#check
"""

from __future__ import annotations

import os
import shutil
from base64 import b64encode
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.integrations.ros.documents import governance, governance_faults, read_permissions
from authguard_r.integrations.ros.keycheck import (
    KeystoreCode,
    KeystoreFault,
    check_enclave,
    check_keystore,
)
from authguard_r.integrations.ros.keystore import ENCLAVES, KEY, PRIVATE, PUBLIC, make_keystore
from authguard_r.integrations.ros.rights import rights_of
from fixtures.ros_keystores import NOW, certify, example, home, map_of, plain_map, resign

PLANNER, GATE, BASE = "/llm/planner", "/authguard/gate", "/robot/base"
GOAL = "<topic>rt/llm/cmd_vel</topic>"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "keystore"
    make_keystore(example(), folder)
    return folder


@pytest.fixture
def keystore(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "keystore"))


def found(keystore: Path) -> list[tuple[KeystoreCode, str]]:
    """Return what is wrong: the codes, and at which enclave."""
    root = f"{keystore / ENCLAVES}"
    faults = check_keystore(example(), keystore)
    return [(fault.code, fault.where.removeprefix(root)) for fault in faults]


def test_what_is_made_is_sound_and_for_every_enclave_of_the_map(keystore: Path) -> None:
    assert found(keystore) == []
    for enclave in rights_of(example()):
        assert home(keystore, enclave).joinpath(KEY).stat().st_mode & 0o777 == 0o600
    for key in (keystore / PRIVATE).iterdir():
        assert key.stat().st_mode & 0o777 == 0o600


def test_a_keystore_is_never_written_over_another(keystore: Path) -> None:
    with pytest.raises(EnvironmentFault, match="new or empty"):
        make_keystore(example(), keystore)
    blocked = keystore / "file"
    blocked.write_text("")
    with pytest.raises(EnvironmentFault, match="cannot make"):
        make_keystore(example(), blocked / "x")


@pytest.mark.parametrize(
    "pattern",
    ["rt/cmd_vel", "*", "rt/*", "rt/cmd_???", "rt/[c]md_vel", "rt/cmd\\_vel", "r*l"],
)
def test_l21_whatever_pattern_could_reach_the_robot_is_found(keystore: Path, pattern: str) -> None:
    resign(keystore, PLANNER, "permissions", {GOAL: f"<topic>{pattern}</topic>"})
    assert (KeystoreCode.ACTUATES, PLANNER) in found(keystore)


@pytest.mark.parametrize(
    "topic",
    [
        "rq/navigate_to_pose/_action/send_goalRequest",
        "rq/navigate_to_pose/_action/cancel_goalRequest",
        "rr/navigate_to_pose/_action/get_resultReply",
        "rt/navigate_to_pose/_action/feedback",
        "rq/lightRequest",
        "rr/lightReply",
        "rq/controller_server/set_parametersRequest",
        "rq/base/change_stateRequest",
        "rt/authguard/heartbeat",
        "rt/authguard/decisions",
        "rt/authguard/status",
    ],
)
def test_l1_every_way_to_move_the_robot_is_one_that_is_found(keystore: Path, topic: str) -> None:
    resign(keystore, PLANNER, "permissions", {GOAL: f"<topic>{topic}</topic>"})
    codes = found(keystore)
    assert (KeystoreCode.ACTUATES, PLANNER) in codes
    assert (KeystoreCode.LACKS, PLANNER) in codes


@pytest.mark.parametrize("topic", ["rt/odom", "rt/camera/text"])
def test_every_way_to_lie_about_the_robot_is_one_that_is_found(keystore: Path, topic: str) -> None:
    resign(keystore, PLANNER, "permissions", {GOAL: f"{GOAL}<topic>{topic}</topic>"})
    assert (KeystoreCode.FALSIFIES, PLANNER) in found(keystore)


ALLOWS = "<allow_rule><domains><id>42</id></domains>"


@pytest.mark.parametrize(
    ("enclave", "change", "code"),
    [
        (PLANNER, {"<default>DENY": "<default>ALLOW"}, KeystoreCode.ACTUATES),
        (PLANNER, {"<default>DENY</default>": ""}, KeystoreCode.ACTUATES),
        (PLANNER, {"CN=/llm/planner": f"CN={GATE}"}, KeystoreCode.FOREIGN),
        (PLANNER, {GOAL: f"{GOAL}<topic>rt/goal_pose</topic>"}, KeystoreCode.WIDER),
        (PLANNER, {"<id>42</id>": "<id>43</id>"}, KeystoreCode.LACKS),
        (BASE, {"<topic>rt/cmd_vel</topic>": "<topic>rt/x</topic>"}, KeystoreCode.LACKS),
        (
            BASE,
            {"<permissions>": "<grants>", "</permissions>": "</grants>"},
            KeystoreCode.UNREADABLE,
        ),
        (BASE, {"<?xml": "<!DOCTYPE dds [<!ENTITY a 'b'>]><?xml"}, KeystoreCode.UNREADABLE),
        (BASE, {"<not_after>": "<not_after>soon"}, KeystoreCode.UNREADABLE),
        (BASE, {"<not_after>2": "<not_after>1"}, KeystoreCode.EXPIRED),
    ],
)
def test_permissions_that_are_not_the_maps_are_found(
    keystore: Path, enclave: str, change: dict[str, str], code: KeystoreCode
) -> None:
    resign(keystore, enclave, "permissions", change)
    codes = dict(found(keystore))
    assert code in codes
    assert codes[code].startswith(enclave)


@pytest.mark.parametrize(
    "domains",
    ["<id_range><min>40</min><max>50</max></id_range>", "<id_range><min>0</min></id_range>", "x"],
)
def test_a_rule_is_for_every_domain_that_it_might_mean(keystore: Path, domains: str) -> None:
    rule = f"<allow_rule><domains>{domains}</domains><publish><topics><topic>rt/cmd_vel</topic>"
    rule += "</topics></publish></allow_rule>"
    if domains == "x":
        rule = rule.replace("<domains>x</domains>", "")
    resign(keystore, PLANNER, "permissions", {ALLOWS: rule + ALLOWS})
    assert (KeystoreCode.ACTUATES, PLANNER) in found(keystore)


def test_a_rule_that_nobody_can_read_is_for_every_domain(keystore: Path) -> None:
    resign(
        keystore, PLANNER, "permissions", {"<id>42</id>": "<id>all</id>", GOAL: "<topic>*</topic>"}
    )
    assert (KeystoreCode.ACTUATES, PLANNER) in found(keystore)


def test_a_rule_for_another_domain_moves_nothing_here(keystore: Path) -> None:
    rule = ALLOWS.replace("42", "7") + "<publish><topics><topic>*</topic></topics></publish>"
    resign(keystore, PLANNER, "permissions", {ALLOWS: rule + "</allow_rule>" + ALLOWS})
    assert found(keystore) == []


def test_a_number_that_another_reads_otherwise_is_for_every_domain(keystore: Path) -> None:
    resign(
        keystore, PLANNER, "permissions", {"<id>42</id>": "<id>4_3</id>", GOAL: "<topic>*</topic>"}
    )
    assert (KeystoreCode.ACTUATES, PLANNER) in found(keystore)


ANYTHING = "<publish><topics><topic>*</topic></topics></publish>"


@pytest.mark.parametrize(
    "change",
    [
        {ALLOWS: f'<allow_rule xmlns="urn:x"><domains/>{ANYTHING}</allow_rule>{ALLOWS}'},
        {ALLOWS: f"<permit_rule>{ANYTHING}</permit_rule>{ALLOWS}"},
        {GOAL: "<topic>*<!-- not here -->/nowhere</topic>"},
        {GOAL: "<topic>*<?x?>/nowhere</topic>"},
        {GOAL: "<topic>*<![CDATA[/nowhere]]></topic>"},
        {GOAL: f"{GOAL}<subtopic>*</subtopic>"},
        {"<default>DENY</default>": "<default>DENY</default><default>ALLOW</default>"},
        {"<validity>": "<validity/><validity>"},
        {"<dds ": '<dds xmlns="urn:x" '},
        {"<subject_name>": "<subject_name>CN=/other</subject_name><subject_name>"},
    ],
    ids=lambda change: " ".join(change.values())[:40],
)
def test_l21_what_another_reader_might_see_otherwise_is_no_document(
    keystore: Path, change: dict[str, str]
) -> None:
    """Authorities sign what they see; what a middleware sees moves the robot."""
    resign(keystore, PLANNER, "permissions", change)
    assert KeystoreCode.UNREADABLE in {code for code, _ in found(keystore)}


def test_l21_a_governance_with_a_rule_that_we_do_not_see_is_none(keystore: Path) -> None:
    rule = '<domain_rule xmlns="urn:x"><domains><id>42</id></domains></domain_rule>'
    resign(keystore, BASE, "governance", {"<domain_rule>": f"{rule}<domain_rule>"})
    assert KeystoreCode.UNREADABLE in {code for code, _ in found(keystore)}


def test_a_comment_between_elements_is_nobodys_matter(keystore: Path) -> None:
    resign(keystore, PLANNER, "permissions", {ALLOWS: f"<!-- the planner's -->{ALLOWS}"})
    assert found(keystore) == []


def test_bytes_of_another_encoding_are_no_document(keystore: Path) -> None:
    text = (home(keystore, BASE) / "governance.xml").read_text()
    with pytest.raises(MalformedError, match="XML"):
        list(governance_faults(text.encode("utf-16"), domain=42, where="x"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<enable_join_access_control>true", "<enable_join_access_control>false"),
        ("<allow_unauthenticated_participants>false", "<allow_unauthenticated_participants>TRUE"),
        ("<allow_unauthenticated_participants>false", "<allow_unauthenticated_participants>1"),
        ("<enable_write_access_control>true", "<enable_write_access_control>0"),
        ("<data_protection_kind>ENCRYPT", "<data_protection_kind>NONE"),
        ("<rtps_protection_kind>SIGN</rtps_protection_kind>", ""),
        ("<topic_expression>*", "<topic_expression>rt/odom"),
    ],
)
def test_a_governance_that_lets_more_in_is_found(keystore: Path, old: str, new: str) -> None:
    resign(keystore, BASE, "governance", {old: new})
    assert (KeystoreCode.OPEN, BASE) in found(keystore)


def test_a_truth_value_is_read_as_xml_means_it() -> None:
    said = governance(42).replace(b">true<", b">1<").replace(b">false<", b">0<")
    assert list(governance_faults(said, domain=42, where="x")) == []
    for wrong in (b"<dds/>", b"<x", governance(7)):
        with pytest.raises(MalformedError):
            list(governance_faults(wrong, domain=42, where="x"))
    with pytest.raises(MalformedError):
        read_permissions(b"<dds/>", domain=42, where="x")


def copied(keystore: Path, name: str) -> None:
    """Give the planner a file of the gate's."""
    shutil.copy(home(keystore, GATE) / name, home(keystore, PLANNER) / name)


def swapped(keystore: Path) -> None:
    """Put another authority's certificate into an enclave."""
    other = keystore / PUBLIC / "permissions_ca.cert.pem"
    shutil.copy(other, home(keystore, BASE) / "identity_ca.cert.pem")


def nameless(keystore: Path) -> None:
    """Break the name in an enclave's certificate."""
    path = home(keystore, BASE) / "cert.pem"
    (whole,) = x509.load_pem_x509_certificates(path.read_bytes())
    broken = bytearray(whole.public_bytes(Encoding.DER))
    broken[broken.index(bytes.fromhex("06035504030c")) + 7] = 0xFF  # no UTF-8
    text = b64encode(broken).decode()
    path.write_text(f"-----BEGIN CERTIFICATE-----\n{text}\n-----END CERTIFICATE-----\n")


def edited(keystore: Path) -> None:
    """Change permissions without the authority's key."""
    path = home(keystore, PLANNER) / "permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"rt/llm/cmd_vel", b"rt/cmd_vel"))


Break = Callable[[Path], object]


@pytest.mark.parametrize(
    ("spoil", "code", "where"),
    [
        (lambda k: shutil.rmtree(home(k, BASE)), KeystoreCode.MISSING, BASE),
        (lambda k: shutil.copytree(home(k, GATE), home(k, "/old")), KeystoreCode.FOREIGN, "/old"),
        (lambda k: shutil.copytree(home(k, GATE), home(k, "/old")), KeystoreCode.ACTUATES, "/old"),
        (lambda k: shutil.copytree(home(k, GATE), home(k, "/old")), KeystoreCode.SHARED, "/old"),
        (lambda k: home(k, BASE).joinpath(KEY).chmod(0o640), KeystoreCode.EXPOSED, BASE),
        (lambda k: copied(k, KEY), KeystoreCode.FOREIGN, PLANNER),
        (lambda k: copied(k, "permissions.p7s"), KeystoreCode.FOREIGN, PLANNER),
        (
            lambda k: home(k, BASE).joinpath(KEY).write_text("x"),
            KeystoreCode.UNREADABLE,
            f"{BASE}/{KEY}",
        ),
        (
            lambda k: home(k, BASE).joinpath("cert.pem").write_text("x"),
            KeystoreCode.UNREADABLE,
            BASE,
        ),
        (
            lambda k: home(k, BASE).joinpath("governance.p7s").unlink(),
            KeystoreCode.UNREADABLE,
            BASE,
        ),
        (swapped, KeystoreCode.FOREIGN, BASE),
        (nameless, KeystoreCode.UNREADABLE, BASE),
        (edited, KeystoreCode.FORGED, PLANNER),
    ],
)
def test_an_enclave_that_is_not_what_it_says_is_found(
    keystore: Path, spoil: Break, code: KeystoreCode, where: str
) -> None:
    spoil(keystore)
    assert any(got == code and at.startswith(where) for got, at in found(keystore)), found(keystore)


def test_an_enclave_of_another_authority_is_found(keystore: Path, tmp_path: Path) -> None:
    make_keystore(example(), tmp_path / "other")
    shutil.rmtree(home(keystore, GATE))
    shutil.copytree(home(tmp_path / "other", GATE), home(keystore, GATE))
    codes = [code for code, _ in found(keystore)]
    assert KeystoreCode.FOREIGN in codes
    assert KeystoreCode.FORGED in codes


def named(*uris: str) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri) for uri in uris])


def test_a_keystore_of_another_robot_is_found(tmp_path: Path) -> None:
    """Its enclaves have the same names, and it is as sound as this one's."""
    other = map_of({**plain_map(), "robot": "courier-9"})
    make_keystore(other, tmp_path / "other")
    assert check_keystore(other, tmp_path / "other") == ()
    faults = check_keystore(example(), tmp_path / "other")
    assert {fault.code for fault in faults} == {KeystoreCode.FOREIGN}
    assert {fault.where for fault in faults} == set(rights_of(example()))
    assert all("courier-9" in fault.message for fault in faults)


@pytest.mark.parametrize(
    "extensions",
    [(), (named("urn:example:courier-1"),), (x509.SubjectAlternativeName([x509.DNSName("x")]),)],
)
def test_a_gate_whose_enclave_names_no_robot_is_found(
    keystore: Path, extensions: tuple[x509.ExtensionType, ...]
) -> None:
    certify(keystore, GATE, *extensions)
    certify(keystore, PLANNER, *extensions)  # it may be a planner of several robots
    assert found(keystore) == [(KeystoreCode.FOREIGN, GATE)]


def test_an_enclave_may_be_of_several_robots_and_a_gates_own_name_counts(
    keystore: Path, tmp_path: Path
) -> None:
    uri = "urn:authguard-r:robot:"
    certify(keystore, PLANNER, named(f"{uri}courier-9", f"{uri}courier-1"))
    assert found(keystore) == []
    plain = plain_map()
    plain["enclaves"]["gate"] = "/courier-1/gate"
    make_keystore(map_of(plain), tmp_path / "named")
    certify(tmp_path / "named", "/courier-1/gate")
    assert check_keystore(map_of(plain), tmp_path / "named") == ()


def test_extensions_that_nobody_can_read_are_found(keystore: Path) -> None:
    san = x509.ObjectIdentifier("2.5.29.17")
    certify(keystore, PLANNER, x509.UnrecognizedExtension(san, b"\x30\x03\x86\x05x"))
    assert (KeystoreCode.UNREADABLE, f"{PLANNER}/cert.pem") in found(keystore)


def test_what_has_ended_is_found(keystore: Path) -> None:
    later = NOW + timedelta(days=400)
    codes = {fault.code for fault in check_keystore(example(), keystore, now=later)}
    assert codes == {KeystoreCode.EXPIRED}


def test_keys_may_lie_with_their_processes(keystore: Path) -> None:
    for enclave in rights_of(example()):
        home(keystore, enclave).joinpath(KEY).unlink()
    assert found(keystore) == []


def test_an_enclave_that_the_map_does_not_have_is_found(keystore: Path, tmp_path: Path) -> None:
    """Whatever it may do, no list of what moves the robot is long enough to say that it is safe."""
    plain = plain_map()
    plain["processes"]["/robot/helper"] = {"nodes": ["/helper"], "publishes": ["/initialpose"]}
    make_keystore(map_of(plain), tmp_path / "wider")
    faults = check_keystore(example(), tmp_path / "wider")
    assert {fault.where for fault in faults} == {"/robot/helper"}
    assert KeystoreCode.STRANGE in {fault.code for fault in faults}


def test_an_enclave_behind_a_link_is_found(keystore: Path, tmp_path: Path) -> None:
    """ROS follows it, to wherever it leads."""
    elsewhere = shutil.copytree(home(keystore, PLANNER), tmp_path / "elsewhere")
    (keystore / ENCLAVES / "other").symlink_to(elsewhere)
    assert found(keystore) == [(KeystoreCode.UNREADABLE, "/other")]


def test_a_folder_that_nobody_can_look_into_is_found(keystore: Path) -> None:
    here = os.open(keystore / ENCLAVES, os.O_RDONLY)
    for _ in range(20):  # deeper than a path may be long
        os.mkdir("x" * 250, dir_fd=here)
        inner = os.open("x" * 250, os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = inner
    os.close(here)
    (fault,) = check_keystore(example(), keystore)
    assert (fault.code, fault.message) == (
        KeystoreCode.UNREADABLE,
        "cannot be looked into: File name too long",
    )
    shutil.rmtree(keystore / ENCLAVES / ("x" * 250))


def test_a_map_that_moved_on_is_found(keystore: Path) -> None:
    plain = plain_map()
    plain["mediated"]["light"]["private"] = "/lamp"
    codes = {fault.code for fault in check_keystore(map_of(plain), keystore)}
    assert codes == {KeystoreCode.LACKS, KeystoreCode.WIDER}


def test_what_is_no_keystore_is_said_so(keystore: Path) -> None:
    with pytest.raises(EnvironmentFault, match="expected a keystore"):
        check_keystore(example(), keystore / "nothing")
    (keystore / PUBLIC / "identity_ca.cert.pem").unlink()
    with pytest.raises(EnvironmentFault):
        check_keystore(example(), keystore)
    (fault,) = check_enclave(example(), keystore, GATE)
    assert isinstance(fault, KeystoreFault)
    assert fault.code is KeystoreCode.UNREADABLE
