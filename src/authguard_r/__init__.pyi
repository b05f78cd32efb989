# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

from authguard_r.access.files import read_binding as read_binding
from authguard_r.client.blocking import GateClient as GateClient
from authguard_r.client.stopping import stop_robot as stop_robot
from authguard_r.core.action import Action as Action
from authguard_r.core.decision import Decision as Decision
from authguard_r.core.errors import AuthGuardError as AuthGuardError
from authguard_r.core.mission import Mission as Mission
from authguard_r.core.token import VerifiedMission as VerifiedMission
from authguard_r.core.token import sign_object as sign_object
from authguard_r.core.token import verify_mission as verify_mission
from authguard_r.enforcement.evaluation import evaluate as evaluate
from authguard_r.keys.trust import read_trust as read_trust
from authguard_r.normalize import read_plan as read_plan
from authguard_r.normalize.bind import Binder as Binder
from authguard_r.operations.simulation import simulate as simulate
from authguard_r.server.wiring import Gate as Gate
from authguard_r.server.wiring import LogSettings as LogSettings
from authguard_r.server.wiring import assemble as assemble
from authguard_r.site.source import read_site as read_site
from authguard_r.wire.messages import ClientRole as ClientRole

def lazy(package: str, homes: dict[str, str], root: str = ...) -> Callable[[str], object]: ...
