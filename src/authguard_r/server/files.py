# SPDX-License-Identifier: Apache-2.0
"""The files that a gate is started with, and how they become parts that are read and authentic.

Spec page: docs/spec/gate-protocol.md#start-and-end
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import msgspec
from msgspec import Struct

from authguard_r.access.files import read_binding, trusted_site
from authguard_r.access.gate_config import open_gate_config
from authguard_r.anchoring.anchor import read_counter
from authguard_r.anchoring.counter import Counter, FileCounter
from authguard_r.approvals.organization import open_policy
from authguard_r.core.encoding import Tag, b64, digest_of, encode_fast
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.emergency.opened import open_emergency
from authguard_r.estop.files import EStopFiles
from authguard_r.keys.clock_floor import boot_ms, token_ms
from authguard_r.keys.signer import folder_signer, read_signer
from authguard_r.keys.trust import Trust, read_file, read_trust
from authguard_r.normalize.binding import binding_digest
from authguard_r.safety import SafetyConfig, default_config, open_config, safety_digest
from authguard_r.server.parts import EmergencyParts, GateParts, SimulatedRobot
from authguard_r.server.wiring import root_digest
from authguard_r.site.model import Site, site_digest
from authguard_r.store.clocks import SystemClock, committed_ms

#: The file descriptor that the structured log goes to.
STDERR = 2


class GateFiles(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Paths of everything that a gate reads, and the robot that it is for.

    Args:
        robot: the robot.
        trust: the trust folder.
        site: the site model, signed or, in a demonstration, YAML.
        binding: the planner's tools: YAML, or a shipped name.
        config: the signed gate configuration.
        store: the store's file; the gate makes it if it is absent.
        run: the run folder, for the sockets.
        key: the gate's private key.
        cert: the gate's certificate chain.
        safety: the signed safety configuration; None: the profile's limits, in a demonstration.
        risk_policy: the organization's signed risk policy.
        emergency: the signed emergency policy.
        emergency_journal: its journal; None: beside the store.
        counter: the file of the counter outside of the store.
        demo: accept a trust root that says `demo`.
        simulate: run a symbolic robot inside the gate's process; needs `demo`.
        checked: the `parts_digest` of the parts that were checked; the gate starts with no others.
    """

    robot: RobotId
    trust: Path
    site: Path
    binding: str
    config: Path
    store: Path
    run: Path
    key: Path
    cert: Path
    safety: Path | None = None
    risk_policy: Path | None = None
    emergency: Path | None = None
    emergency_journal: Path | None = None
    counter: Path | None = None
    demo: bool = False
    simulate: bool = False
    checked: str = ""

    @property
    def outside(self) -> Counter | None:
        """The counter outside of the store."""
        return None if self.counter is None else FileCounter(Path(self.counter))


def ask(files: GateFiles) -> str:
    """Return the argument that names these files to the gate's process.

    Raises:
        EnvironmentFault: a path is not UTF-8.
    """
    try:
        return msgspec.json.encode(files, enc_hook=str).decode()
    except UnicodeEncodeError as error:
        raise EnvironmentFault(
            "expected paths in UTF-8", reason=Reason.FILE_UNAVAILABLE, where="arguments"
        ) from error


def asked(argument: str) -> GateFiles:
    """Return the files that an argument names."""
    return msgspec.json.decode(argument, type=GateFiles, dec_hook=lambda kind, it: kind(it))


def start_time(files: GateFiles, trust: Trust) -> Now:
    """Return the machine's clock, or the latest time that is known to be over if that is later.

    A machine without a clock yet starts at that time. Its gate serves stops, and refuses the rest
    until the clock is set.
    """
    counted = read_counter(files.outside, verifier=trust)
    signed_ms = token_ms(read_file(files.config))
    known_ms = (committed_ms(files.store), counted.time_ms, signed_ms)
    return Now(boot_ms(SystemClock().wall_ms(), trust, *known_ms), 0)


def open_parts(files: GateFiles) -> GateParts:
    """Return the parts of a gate, each read and authentic.

    Raises:
        AuthGuardError: a part cannot be read, is not sound or is not authentic.
    """
    trust = read_trust(files.trust)
    now = start_time(files, trust)
    site = trusted_site(files.site, trust, now)
    stop_process = EStopFiles(
        run=files.run,
        robot=files.robot,
        trust=files.trust,
        key=files.key,
        cert=files.cert,
        config=files.config,
    )
    policy = files.risk_policy
    return GateParts(
        run=files.run,
        trust=trust,
        signer=read_signer(files.key, files.cert),
        site=site,
        binding=read_binding(files.binding, site),
        safety=_safety(files, trust, site, now),
        config=open_gate_config(
            read_file(files.config), verifier=trust, now=now, robot=files.robot
        ),
        store=files.store,
        estop=None if files.simulate else stop_process,
        journal=STDERR,
        demo=files.demo,
        key=files.key,
        simulated=_simulated(files, trust, site) if files.simulate else None,
        risk=None if policy is None else open_policy(read_file(policy), verifier=trust, now=now),
        counter=files.outside,
        emergency=_emergency(files, trust, site, now),
    )


def parts_digest(parts: GateParts) -> str:
    """Return a SHA-256 of everything signed or written by people that a gate starts with."""
    risk, emergency = parts.risk, parts.emergency
    content = (
        root_digest(parts.trust),
        [b64(certificate) for certificate in parts.signer.chain],
        site_digest(parts.site),
        binding_digest(parts.binding),
        digest_of(Tag.GATE, parts.config),
        safety_digest(parts.safety),
        None if risk is None else risk.digest,
        None if emergency is None else emergency.policy.digest,
    )
    return sha256(encode_fast(content)).hexdigest()


def require_checked(files: GateFiles, parts: GateParts) -> None:
    """Refuse parts that are not those that were checked before the gate's process began.

    Raises:
        EnvironmentFault: a file has changed since, or no check was made.
    """
    if files.checked != parts_digest(parts):
        raise EnvironmentFault(
            "the set-up is not the one that was checked: start the gate with `authguard gate`",
            reason=Reason.SETUP_INVALID,
            where="setup",
        )


def _safety(files: GateFiles, trust: Trust, site: Site, now: Now) -> SafetyConfig:
    if files.safety is not None:
        return open_config(read_file(files.safety), verifier=trust, now=now)
    if not trust.demo:
        raise EnvironmentFault(
            "expected a safety officer's signed configuration outside demonstration",
            reason=Reason.SIGNATURE_INVALID,
            where="--safety",
        )
    return default_config(site, files.robot)


def _emergency(files: GateFiles, trust: Trust, site: Site, now: Now) -> EmergencyParts | None:
    if files.emergency is None:
        return None
    token = read_file(files.emergency)
    policy = open_emergency(token, verifier=trust, now=now, site=site, robot=files.robot)
    return EmergencyParts(policy=policy, journal=files.emergency_journal)


def _simulated(files: GateFiles, trust: Trust, site: Site) -> SimulatedRobot:
    if not (files.demo and trust.demo):
        raise EnvironmentFault(
            "only with --demo and a root that says `demo`",
            reason=Reason.SETUP_INVALID,
            where="--simulate",
        )
    # a gate of a real robot does not load the simulator
    from authguard_r.sim.robot import SymbolicRobot
    from authguard_r.sim.world import initial_state

    now_ms = SystemClock().wall_ms()
    return SymbolicRobot(
        site,
        files.robot,
        initial_state(site, site.robots[files.robot].home),
        estimator=folder_signer(files.trust, f"estimator-{files.robot}"),
        start_ms=now_ms,
        epoch=now_ms,
    )
