# SPDX-License-Identifier: Apache-2.0
"""What a robot on ROS 2 has beside its gate, as its processes would find it when they start.

Each look is the one that a process takes, or `authguard ros check`: nothing is looked at in another
way here. Needs no ROS; where there is one, types are loaded too.
How-to: docs/howto/ros-nav2.md
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

from msgspec import Struct

from authguard_r.cli.ros import require_extra
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.integrations.ros.calls import fitted
from authguard_r.integrations.ros.map import RosMap, read_map
from authguard_r.integrations.ros.names import TypePart
from authguard_r.integrations.ros.rights import rights_of
from authguard_r.keys.trust import read_file
from authguard_r.operations.checkup import GateSetup
from authguard_r.operations.checkup.advice import (
    Advice,
    AdviceCode,
    fine,
    in_demonstration,
    unsafe,
    warning,
)
from authguard_r.operations.checkup.custody import file_advice, folder_advice

_MAP, _SECURITY, _KEYSTORE, _TYPES = "ros map", "ros security", "keystore", "ros types"
_CLOCK = "rt/clock"
_RMW, _DEFAULT_RMW = "RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"
_FASTDDS = frozenset({"rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"})
_FASTDDS_LIBRARY = "librmw_fastrtps_shared_cpp.so"
#: What that library says of itself where it was built without security, and else does not hold.
_INSECURE = b"doesn't have the security libraries"


class RosParts(Struct, frozen=True, kw_only=True):
    """What is looked at; without a map nothing is.

    Args:
        ros: the robot's map.
        keystore: the keystore, all of it.
        enclave: as whose process this environment is looked at; None: the gate's node's.
    """

    ros: Path | None = None
    keystore: Path | None = None
    enclave: str | None = None


def ros_advice(
    named: RosParts, setup: GateSetup, environment: Mapping[str, str] = os.environ
) -> Iterator[Advice]:
    """Yield whether the processes of a robot on ROS 2 would start, and whom they would let pass.

    Args:
        named: the map and what goes with it.
        setup: the set-up beside them; what of it could not be read was said already.
        environment: the variables that its processes would start with.
    """
    if named.ros is None:
        return
    try:
        ros = read_map(named.ros)
    except AuthGuardError as error:
        place, mend = error.where or str(named.ros), f"authguard ros check {named.ros}"
        yield unsafe(_MAP, AdviceCode.ROS_MAP, error.message, place=place, mend=mend)
        return
    told = f"`{ros.robot}`, domain {ros.domain}, {len(ros.mediated)} mediated"
    yield fine(_MAP, AdviceCode.ROS_MAP, told, place=str(named.ros))
    yield from _fitted(ros, named.ros, setup)
    yield from _clocks(ros)
    yield rmw_advice(environment)
    yield from _types(ros)
    try:
        require_extra()
    except EnvironmentFault as error:
        mend = "pip install 'authguard-r[ros]'"
        yield unsafe(_KEYSTORE, AdviceCode.LIBRARY, error.message, place=error.where, mend=mend)
        return
    yield from _enforced(ros, named, environment, setup.uid)
    if named.keystore is not None:
        found = _keystore(ros, named.keystore, setup.uid)
        yield from map(in_demonstration, found) if setup.demo else found


def _fitted(ros: RosMap, path: Path, setup: GateSetup) -> Iterator[Advice]:
    """Whether the gate's node serves this map with the gate's binding at this site."""
    mend = f"authguard ros check {path} --binding BINDING --site SITE"
    if setup.binding is None or setup.site is None:
        message = "compared with no binding: nothing shows that each name is one of its ways"
        yield warning(_MAP, AdviceCode.BINDING, message, place=str(path), mend=mend)
        return
    try:
        fitted(setup.binding, ros, setup.site)
    except MalformedError as error:
        yield unsafe(
            _MAP,
            AdviceCode.BINDING,
            f"{error.message} (at {error.where})",
            place=str(path),
            mend=mend,
        )
    else:
        yield fine(_MAP, AdviceCode.BINDING, "every mediated name is a way of the binding")


def _clocks(ros: RosMap) -> Iterator[Advice]:
    """Whether `/clock` may set the time: our nodes ignore it, the robot's own may use it."""
    found = [name for name, rights in rights_of(ros).items() if _CLOCK in rights.publish]
    for enclave in found:
        message = f"`{enclave}` may publish `/clock`: it stops every timer under `use_sim_time`"
        mend = "leave `/clock` out of the map: a robot has no simulated time"
        yield unsafe(
            "ros clock", AdviceCode.ROS_CLOCK, message, place=f"processes.{enclave}", mend=mend
        )
    if not found:
        message = "no process may publish `/clock`; the gate uses the monotonic clock alone"
        yield fine("ros clock", AdviceCode.ROS_CLOCK, message)


def rmw_advice(environment: Mapping[str, str]) -> Advice:
    """Return whether what makes the nodes has DDS security, where that can be known.

    Args:
        environment: names it, and where its library lies.
    """
    name = environment.get(_RMW, "") or _DEFAULT_RMW
    library = _library(environment) if name in _FASTDDS else None
    if library is not None and _INSECURE in read_file(library):
        message = f"`{name}` was built without DDS security: with security on, it makes no node"
        mend = "install ROS 2 as its distribution builds it"
        return unsafe("rmw", AdviceCode.ROS_RMW, message, place=str(library), mend=mend)
    message = f"not known whether `{name}` was built with DDS security"
    mend = "start the dead-man in its enclave: without DDS security it is refused"
    if name not in {*_FASTDDS, "rmw_cyclonedds_cpp"}:
        mend = f"use `{_DEFAULT_RMW}`: another may read no keystore"
    return warning("rmw", AdviceCode.ROS_RMW, message, place=_RMW, mend=mend)


def _library(environment: Mapping[str, str]) -> Path | None:
    """Return the library that the loader would find first."""
    prefixes = filter(None, environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    loaded = filter(None, environment.get("LD_LIBRARY_PATH", "").split(os.pathsep))
    folders = (*map(Path, loaded), *(Path(prefix) / "lib" for prefix in prefixes))
    paths = (folder / _FASTDDS_LIBRARY for folder in folders)
    return next((path for path in paths if os.access(path, os.R_OK) and path.is_file()), None)


def _types(ros: RosMap) -> Iterator[Advice]:
    """Whether every type of the map is installed here."""
    if find_spec("rclpy") is None or find_spec("rosidl_parser") is None:
        message = "no rclpy here: whether the types of the map are installed is unknown"
        yield warning(_TYPES, AdviceCode.ROS_TYPE, message, mend="source ROS 2, and ask again")
        return
    from authguard_r.integrations.ros.nodes.values import load_type

    items = {f"mediated.{key}.type": item.type for key, item in ros.mediated.items()}
    items |= {f"shown.{key}.type": item.type for key, item in ros.shown.items()}
    is_whole = True
    for place, kind in items.items():
        package, part, _ = kind.split("/")
        try:
            load_type(kind, TypePart(part))
        except AuthGuardError as error:
            mend = f"apt install ros-$ROS_DISTRO-{package.replace('_', '-')}"
            yield unsafe(_TYPES, AdviceCode.ROS_TYPE, error.message, place=place, mend=mend)
            is_whole = False
    if is_whole:
        yield fine(_TYPES, AdviceCode.ROS_TYPE, f"all {len(items)} of the map load")


def _enforced(
    ros: RosMap, named: RosParts, environment: Mapping[str, str], uid: int
) -> Iterator[Advice]:
    """Whether a process with these variables would be in its enclave, by its own look."""
    from authguard_r.integrations.ros.security import (
        DOMAIN,
        EXACTLY,
        KEYSTORE,
        OVERRIDE,
        security_faults,
    )

    enclave = named.enclave or ros.enclaves.gate
    if enclave not in rights_of(ros):
        message = f"`{enclave}` is no enclave of the map"
        mend = f"name one of its own: {', '.join(rights_of(ros))}"
        yield unsafe(_SECURITY, AdviceCode.ROS_SECURITY, message, place="--enclave", mend=mend)
        return
    mends = {name: f"export {name}={word}" for name, word in EXACTLY.items()}
    mends |= {DOMAIN: f"export {DOMAIN}={ros.domain}", OVERRIDE: f"unset {OVERRIDE}"}
    mends |= {KEYSTORE: f"export {KEYSTORE}=FOLDER, made by: authguard ros keystore"}
    faults = tuple(security_faults(ros, enclave, environment, uid=uid))
    for fault in faults:
        mend = mends.get(fault.where, f"make it `{enclave}`'s own user's, mode 600; or a new one")
        message = f"as `{enclave}`: {fault.message}"
        yield unsafe(_SECURITY, AdviceCode.ROS_SECURITY, message, place=fault.where, mend=mend)
    if not faults:
        yield fine(
            _SECURITY, AdviceCode.ROS_SECURITY, f"a process here is in `{enclave}`, enforced"
        )


def _keystore(ros: RosMap, folder: Path, uid: int) -> Iterator[Advice]:
    """Whom a whole keystore lets move the robot, and who has its keys."""
    from authguard_r.integrations.ros.keycheck import check_keystore
    from authguard_r.integrations.ros.keystore import ENCLAVES, KEY, PRIVATE

    mend = "make a new one from the map: authguard ros keystore"
    try:
        faults = check_keystore(ros, folder)
    except AuthGuardError as error:
        yield unsafe(
            _KEYSTORE, AdviceCode.ROS_KEYSTORE, error.message, place=error.where, mend=mend
        )
        return
    for fault in faults:
        message = f"{fault.code}: {fault.message}"
        yield unsafe(_KEYSTORE, AdviceCode.ROS_KEYSTORE, message, place=fault.where, mend=mend)
    if not faults:
        message = f"of every enclave there, `{ros.enclaves.gate}` alone can move the robot"
        yield fine(_KEYSTORE, AdviceCode.ROS_KEYSTORE, message, place=str(folder))
    for path in sorted((folder / PRIVATE).glob("*.key.pem")):
        message = "an authority's key: anyone who has it can act as any process"
        yield warning(
            _KEYSTORE, AdviceCode.STRAY_KEY, message, place=str(path), mend="keep it off the robot"
        )
    homes = {name: folder / ENCLAVES / name.removeprefix("/") for name in rights_of(ros)}
    # what cannot be looked into was said to be missing
    yield from _owners(
        {n: home for n, home in homes.items() if os.access(home / KEY, os.F_OK)}, uid
    )


def _owners(homes: Mapping[str, Path], uid: int) -> Iterator[Advice]:
    """Whether each key is one user's, and no other user can put anything in a file's place."""
    from authguard_r.integrations.ros.keystore import KEY

    owners: dict[int, list[str]] = {}
    for name, home in homes.items():
        owner = (home / KEY).stat().st_uid
        owners.setdefault(owner, []).append(name)
        for path in (home, *sorted(home.iterdir())):
            yield from file_advice(f"enclave {name}", path, uid=owner)
    for owner, names in owners.items():
        if len(names) > 1:
            message = f"user {owner} has the keys of {', '.join(names)}: each can be the others"
            mend = "give each process a user of its own, and its folder to that user"
            yield unsafe(
                _KEYSTORE, AdviceCode.SHARED_USER, message, place=str(homes[names[0]]), mend=mend
            )
    yield from folder_advice(homes.values(), uid=uid)
