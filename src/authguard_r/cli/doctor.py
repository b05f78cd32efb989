# SPDX-License-Identifier: Apache-2.0
"""`authguard doctor`: every unsafe or missing part of a set-up, with its mend (L7)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from msgspec import to_builtins
from msgspec.structs import replace

from authguard_r.access.files import read_binding
from authguard_r.cli.binding import compared_with
from authguard_r.cli.doctor_policies import Policies, policy_advice
from authguard_r.cli.doctor_ros import RosParts, ros_advice
from authguard_r.cli.gate_config import open_config
from authguard_r.cli.gate_peers import user_number
from authguard_r.cli.inputs import JsonFlag, load_site, wall_now
from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.trust import read_trust
from authguard_r.operations.checkup import GateSetup, checkup, is_safe
from authguard_r.operations.checkup.advice import Advice, AdviceCode, Level, unsafe, warning
from authguard_r.site.check import unreviewed
from authguard_r.site.model import Site
from authguard_r.wire.output import emit

T = TypeVar("T")


class _Lying:
    """What lies in a folder under the names that `init` and its how-to give; nothing without one.

    Args:
        folder: where to look; it has to be there.
    """

    def __init__(self, folder: Path | None) -> None:
        if folder is not None and not folder.is_dir():
            raise typer.BadParameter(f"expected a folder, got `{folder}`", param_hint="FOLDER")
        self._folder = folder

    def at(self, given: Path | None, name: str) -> Path | None:
        """Return what an option named, else what lies there under the name."""
        if given is not None or self._folder is None or not name:
            return given
        path = self._folder / name
        return path if path.exists() else None

    def tools(self, given: Path | None) -> Path | None:
        """Return the binding that a person stands behind, else the one that refuses everything."""
        return self.at(given, "mine.yaml") or self.at(given, "binding.yaml")

    def interfaces(self) -> list[str] | None:
        """Return the folder's description of the tools, None when there is none."""
        listed = self.at(None, "interface.yaml")
        return None if listed is None else [str(listed)]

    def gate(self, ending: str) -> str:
        """Return the name of the gate's key or certificate, empty unless there is just one."""
        pattern = f"trust/keys/gate-*.{ending}"
        found = [] if self._folder is None else list(self._folder.glob(pattern))
        return str(found[0].relative_to(self._folder)) if self._folder and len(found) == 1 else ""


_FolderArgument = Annotated[
    Path | None,
    typer.Argument(help="A folder with the file names of `init`."),
]
_TrustOption = Annotated[Path | None, typer.Option("--trust", help="The trust folder.")]
_StoreOption = Annotated[Path | None, typer.Option("--store", help="The store.")]
_SiteOption = Annotated[Path | None, typer.Option("--site", help="The site model.")]
_BindingOption = Annotated[
    Path | None, typer.Option("--binding", help="The planner's tools; needs --site.")
]
_InterfaceOption = Annotated[
    list[str] | None,
    typer.Option("--interface", help="Interface of the tools; repeatable."),
]
_ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="The gate's configuration; needs --trust.")
]
_RiskPolicyOption = Annotated[
    Path | None,
    typer.Option("--risk-policy", help="The organization's signed policy; needs --trust."),
]
_EmergencyOption = Annotated[
    Path | None,
    typer.Option(
        "--emergency-policy", help="The signed emergency policy; needs --trust and --site."
    ),
]
_KeyOption = Annotated[Path | None, typer.Option("--key", help="A private key.")]
_CertOption = Annotated[Path | None, typer.Option("--cert", help="The key's certificates.")]
_RunOption = Annotated[Path | None, typer.Option("--gate", help="The gate's run folder.")]
_CounterOption = Annotated[
    Path | None, typer.Option("--counter", help="File of the outside counter.")
]
_UserOption = Annotated[
    str | None, typer.Option("--user", help="User that runs the gate (default: you).")
]
_RosMapOption = Annotated[Path | None, typer.Option("--ros", help="The map of a robot on ROS 2.")]
_KeystoreOption = Annotated[
    Path | None, typer.Option("--keystore", help="Its whole keystore; needs --ros.")
]
_EnclaveOption = Annotated[
    str | None,
    typer.Option("--enclave", help="Enclave to check for this shell; needs --ros."),
]


def doctor_command(
    folder: _FolderArgument = None,
    trust: _TrustOption = None,
    store: _StoreOption = None,
    site: _SiteOption = None,
    binding: _BindingOption = None,
    interface: _InterfaceOption = None,
    config: _ConfigOption = None,
    risk_policy: _RiskPolicyOption = None,
    emergency: _EmergencyOption = None,
    key: _KeyOption = None,
    cert: _CertOption = None,
    run: _RunOption = None,
    counter: _CounterOption = None,
    user: _UserOption = None,
    ros_map: _RosMapOption = None,
    keystore: _KeystoreOption = None,
    enclave: _EnclaveOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Find every unsafe or missing part of a set-up, and print how to fix it."""
    lies = _Lying(folder)
    trust, site, binding = lies.at(trust, "trust"), lies.at(site, "site.yaml"), lies.tools(binding)
    config, store = lies.at(config, "gate.token"), lies.at(store, "robot.db")
    named = Policies(
        risk=lies.at(risk_policy, "policy.token"), emergency=lies.at(emergency, "emergency.token")
    )
    _require_both((binding, site, "--site"), (config, trust, "--trust"))
    _require_both((named.risk, trust, "--trust"), (named.emergency, trust, "--trust"))
    _require_both((named.emergency, site, "--site"), (keystore, ros_map, "--ros"))
    if enclave is not None and ros_map is None:
        raise typer.BadParameter("it is looked at by its map alone", param_hint="--enclave")
    setup = GateSetup(
        demo=_is_demo(trust),
        uid=os.geteuid() if user is None else user_number(user, where="--user"),
        trust=trust,
        key=lies.at(key, lies.gate("key.pem")),
        chain=lies.at(cert, lies.gate("cert.pem")),
        model=site,
        tools=binding,
        store=store,
        run=lies.at(run, "run"),
        counter=lies.at(counter, "counter"),
        files=_present(site, binding, config, named.risk, named.emergency, ros_map),
        deep=True,
        around=_around(folder, trust),
    )
    setup, faults = _read(setup, interface or lies.interfaces(), config)
    now = wall_now(None)
    found = (
        *checkup(setup, now),
        *policy_advice(named, setup, now),
        *ros_advice(RosParts(ros=ros_map, keystore=keystore, enclave=enclave), setup),
        *faults,
        *_open(setup.site, site),
    )
    payload = {"safe": is_safe(found), "advice": [to_builtins(item) for item in found]}
    emit(payload, [_line(item) for item in found], as_json=as_json)
    return 0 if is_safe(found) else 5


def _around(folder: Path | None, trust: Path | None) -> tuple[Path, ...]:
    """Return where the how-to lays a person's own key: in the folder, beside the trust folder."""
    beside = folder if folder is not None or trust is None else trust.absolute().parent
    return () if beside is None else (beside,)


def _require_both(*parts: tuple[Path | None, Path | None, str]) -> None:
    """Require beside each part the one that it cannot be read without, by that one's option."""
    for given, needed, name in parts:
        if given is not None and needed is None:
            raise typer.BadParameter(f"`{given}` cannot be read without it", param_hint=name)


def _read(
    setup: GateSetup, compare: list[str] | None, config: Path | None
) -> tuple[GateSetup, list[Advice]]:
    """Return the set-up with those of its parts that can be read, and what is wrong with others.

    Args:
        setup: the files and folders.
        compare: what the tools say of themselves.
        config: the gate's configuration.
    """
    faults: list[Advice] = []
    trust, binding = setup.trust, setup.tools
    model = _part(faults, "site", AdviceCode.SITE, setup.model, lambda path: load_site(path, trust))
    tools = surfaces = configured = None
    if model is not None:
        tools = _part(
            faults, "binding", AdviceCode.BINDING, binding, lambda p: read_binding(p, model)
        )
        surfaces = _part(
            faults, "binding", AdviceCode.BINDING, binding, lambda p: compared_with(str(p), compare)
        )
    if trust is not None:
        configured = _part(
            faults, "config", AdviceCode.CONFIG, config, lambda p: open_config(p, trust)
        )
    return replace(
        setup, site=model, binding=tools, interface=surfaces or (), config=configured
    ), faults


def _part(
    faults: list[Advice], part: str, code: AdviceCode, path: Path | None, read: Callable[[Path], T]
) -> T | None:
    """Return a part once it can be read; what is wrong with it is one more finding."""
    if path is None:
        return None
    try:
        return read(path)
    except AuthGuardError as error:
        mend = f"authguard {'gate-config' if code is AdviceCode.CONFIG else part} --help"
        faults.append(unsafe(part, code, str(error), place=str(path), mend=mend))
        return None


def _open(model: Site | None, path: Path | None) -> Iterator[Advice]:
    """Yield what a skeleton or an import left for a person to say."""
    mend = f"authguard site check {path}"
    for place in () if model is None else unreviewed(model):
        message = "unreviewed: review it; until then it cannot be signed"
        yield warning("site", AdviceCode.SITE, message, place=place, mend=mend)
    for robot, held in () if model is None else model.robots.items():
        if not held.profile.tools:
            place = f"robots.{robot}.profile.tools"
            yield warning(
                "site", AdviceCode.SITE, f"`{robot}` can do nothing yet", place=place, mend=mend
            )


def _present(*paths: Path | None) -> tuple[Path, ...]:
    return tuple(path for path in paths if path is not None)


def _is_demo(trust: Path | None) -> bool:
    """True for a root that says so; what is wrong with the folder, the checkup says."""
    try:
        return trust is not None and read_trust(trust).demo
    except AuthGuardError:
        return False


def _line(item: Advice) -> str:
    """Return a finding for people; a place only when nothing else names it."""
    told = item.level is Level.OK or item.place in f"{item.part} {item.message} {item.mend}"
    place = "" if told else f" (at {item.place})"
    return f"{item.level:8} {item.part}: {item.message}{place}" + (
        f" -> {item.mend}" if item.mend else ""
    )
