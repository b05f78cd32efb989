# SPDX-License-Identifier: Apache-2.0
"""Whether a process of ours really runs in its enclave: looked at before the first node is made.

ROS 2 ignores an invalid setting and goes on without security: `TRUE`, `enforce`, a variable that is
not set, a folder that is missing. Each is a refusal here.
Spec page: docs/spec/ros-map.md#self-check
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.keycheck import KeystoreCode, KeystoreFault, check_enclave
from authguard_r.integrations.ros.keystore import ENCLAVES, KEY
from authguard_r.integrations.ros.map import RosMap

ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"
KEYSTORE, OVERRIDE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
DOMAIN, RMW = "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION"
#: What keeps to a keystore of DDS; where nothing is said, ROS takes the first.
SECURED = (
    "rmw_fastrtps_cpp",
    "rmw_fastrtps_dynamic_cpp",
    "rmw_cyclonedds_cpp",
    "rmw_connextdds",
)
#: A file of Fast DDS that says how messages are carried; it passes over one that it cannot read.
PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
#: The only words that ROS 2 takes for security that is enforced.
EXACTLY = {ENABLE: "true", STRATEGY: "Enforce"}


def require_security(ros: RosMap, enclave: str, environment: Mapping[str, str]) -> Path:
    """Return the keystore that this process's nodes are going to be made with.

    Args:
        ros: the map.
        enclave: which one the process has to be in.
        environment: its variables.

    Raises:
        EnvironmentFault: its nodes would be plain ones, or another's; the first fault is named.
    """
    for fault in security_faults(ros, enclave, environment):
        raise EnvironmentFault(
            f"{fault.message}; without it ROS 2 makes a node that anyone can imitate",
            reason=Reason.SETUP_INVALID,
            where=fault.where,
        )
    return Path(environment[KEYSTORE])


def security_faults(
    ros: RosMap, enclave: str, environment: Mapping[str, str], *, uid: int | None = None
) -> Iterator[KeystoreFault]:
    """Yield why a process with these variables would not be in its enclave.

    Args:
        ros: the map.
        enclave: which one the process has to be in.
        environment: its variables.
        uid: its user; absent: every user.
    """
    for name, wanted in (*EXACTLY.items(), (DOMAIN, str(ros.domain))):
        said = environment.get(name)
        if said != wanted:
            got = "nothing" if said is None else f"`{said}`"
            yield _fault(name, f"expected exactly `{wanted}`, got {got}")
    if environment.get(RMW, SECURED[0]) not in SECURED:
        wanted = ", ".join(f"`{name}`" for name in SECURED)
        yield _fault(RMW, f"expected one of {wanted} or nothing, got `{environment[RMW]}`")
    if environment.get(OVERRIDE, enclave) != enclave:
        yield _fault(OVERRIDE, f"expected `{enclave}` or nothing, got `{environment[OVERRIDE]}`")
    for name in PROFILES:
        if name in environment and not os.access(environment[name], os.R_OK):
            yield _fault(name, f"expected a file that can be read, got `{environment[name]}`")
    keystore = environment.get(KEYSTORE, "")
    if not keystore.startswith("/"):
        yield _fault(KEYSTORE, f"expected an absolute path, got `{keystore}`")
        return
    home = Path(keystore) / ENCLAVES / enclave.removeprefix("/")
    if not home.is_dir():
        yield _fault(KEYSTORE, f"expected the enclave's folder `{home}`")
        return
    yield from _key_faults(home / KEY, os.geteuid() if uid is None else uid)
    yield from check_enclave(ros, Path(keystore), enclave)


def _key_faults(path: Path, uid: int) -> Iterator[KeystoreFault]:
    """Yield why the key is not its process's user's alone."""
    try:
        held = path.stat()
    except OSError as error:
        yield _fault(str(path), f"expected the enclave's key: {error.strerror}")
        return
    if stat.S_IMODE(held.st_mode) & 0o077 or held.st_uid != uid:
        yield _fault(str(path), "expected a key that only its owner, this user, can read")


def _fault(where: str, message: str) -> KeystoreFault:
    return KeystoreFault(code=KeystoreCode.PLAIN, where=where, message=message)
