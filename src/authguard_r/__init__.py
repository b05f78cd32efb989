# SPDX-License-Identifier: Apache-2.0
"""AuthGuard-R: a robot driven by a language model does what an operator signed, action by action.

The public interface is the names in `__all__`, `authguard_r.client` and `authguard_r.integrations`;
docs/reference/python.md shows each. Everything else is internal and may change in any release.
In-process use is advisory: a planner in the same process can go around any library
(docs/explanation/architecture.md).

A name is imported from its module when it is first used, so importing one part of the package, as
the stop process does, loads no other part. `__init__.pyi` gives the names their types.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module


def lazy(package: str, homes: dict[str, str], root: str = "authguard_r") -> Callable[[str], object]:
    """Return a package's `__getattr__`: each name is imported from its module when it is used."""

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{root}.{homes[name]}"), name)

    return load


_HOMES = {
    "Action": "core.action",
    "AuthGuardError": "core.errors",
    "Binder": "normalize.bind",
    "ClientRole": "wire.messages",
    "Decision": "core.decision",
    "Gate": "server.wiring",
    "GateClient": "client.blocking",
    "LogSettings": "server.wiring",
    "Mission": "core.mission",
    "VerifiedMission": "core.token",
    "assemble": "server.wiring",
    "evaluate": "enforcement.evaluation",
    "read_binding": "access.files",
    "read_plan": "normalize",
    "read_site": "site.source",
    "read_trust": "keys.trust",
    "sign_object": "core.token",
    "simulate": "operations.simulation",
    "stop_robot": "client.stopping",
    "verify_mission": "core.token",
}
__all__ = list(_HOMES)
__getattr__ = lazy(__name__, _HOMES)
