# SPDX-License-Identifier: Apache-2.0
"""One process on a secured DDS: hears, or writes, the velocities that ROS 2 would call /cmd_vel.

    peer.py hear|write TOPIC DOMAIN [ENCLAVE_FOLDER [KEY_FOLDER]]

Without a folder it has no security. With a second one, the private key is that one's. What it
writes is its process's number, so that whoever hears knows from whom. It says `ready` and then,
writing, `matched` once somebody hears it; hearing, each number that is new. It ends with its input.
"""

from __future__ import annotations

import os
import select
import sys
from dataclasses import dataclass
from pathlib import Path

from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PLUGINS = Path(os.environ["CYCLONEDDS_HOME"]).parent / "libraries" / "libddsc0debian"
BETWEEN_S = 0.02


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


def plugin(kind: str, name: str, inside: str) -> str:
    library = f'path="{PLUGINS}/libdds_security_{name}.so"'
    calls = f'initFunction="init_{inside}" finalizeFunction="finalize_{inside}"'
    return f"<{kind}><Library {library} {calls}/>"


def security(folder: str, keys: str) -> str:
    """Return what makes a participant one of an enclave: the files that ROS 2 would use."""
    return "".join(
        (
            "<Security>",
            plugin("Authentication", "auth", "authentication"),
            f"<IdentityCA>file:{folder}/identity_ca.cert.pem</IdentityCA>",
            f"<IdentityCertificate>file:{folder}/cert.pem</IdentityCertificate>",
            f"<PrivateKey>file:{keys}/key.pem</PrivateKey></Authentication>",
            plugin("Cryptographic", "crypto", "crypto"),
            "</Cryptographic>",
            plugin("AccessControl", "ac", "access_control"),
            f"<PermissionsCA>file:{folder}/permissions_ca.cert.pem</PermissionsCA>",
            f"<Governance>file:{folder}/governance.p7s</Governance>",
            f"<Permissions>file:{folder}/permissions.p7s</Permissions></AccessControl>",
            "</Security>",
        )
    )


def settings(domain: int, secured: str) -> str:
    return "".join(
        (
            f'<CycloneDDS><Domain Id="{domain}"><General><Interfaces>',
            '<NetworkInterface name="lo" multicast="false"/></Interfaces>',
            "<AllowMulticast>false</AllowMulticast></General>",
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>",
            '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>',
            secured,
            "</Domain></CycloneDDS>",
        )
    )


class Matched(Listener):
    """Says when somebody hears."""

    def on_publication_matched(self, writer: DataWriter, status: object) -> None:
        print("matched", flush=True)


def is_told_to_end() -> bool:
    return bool(select.select([sys.stdin], [], [], BETWEEN_S)[0])


def main() -> None:
    """Take part until the input ends."""
    role, name, domain, *folders = sys.argv[1:]
    number = int(domain)
    secured = security(folders[0], folders[-1]) if folders else ""
    held = Domain(number, settings(number, secured))
    try:
        participant = DomainParticipant(number)
        topic = Topic(participant, name, Twist)
        quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1))
        if role == "hear":
            hear(DataReader(participant, topic, qos=quality))
        else:
            write(DataWriter(participant, topic, qos=quality, listener=Matched()))
    except Exception as error:  # noqa: BLE001 - whatever the library calls its refusal
        print(f"refused {type(error).__name__} {error}"[:200], flush=True)
    del held


def hear(reader: DataReader) -> None:
    heard: set[float] = set()
    print("ready", flush=True)
    while not is_told_to_end():
        for sample in reader.take(N=10):
            # a writer that has gone leaves a sample without a value
            if isinstance(sample, Twist) and sample.linear.x not in heard:
                heard.add(sample.linear.x)
                print(f"heard {int(sample.linear.x)}", flush=True)


def write(writer: DataWriter) -> None:
    nothing = Vector3(0.0, 0.0, 0.0)
    print("ready", flush=True)
    while not is_told_to_end():
        writer.write(Twist(Vector3(float(os.getpid()), 0.0, 0.0), nothing))


if __name__ == "__main__":
    main()
