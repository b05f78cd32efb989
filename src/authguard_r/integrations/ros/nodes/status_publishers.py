# SPDX-License-Identifier: Apache-2.0
"""What the node says and hears beside what it mediates: plans as text, what is shown, decisions.

Spec page: docs/spec/ros.md
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from authguard_r.client.controller import ControllerSession
from authguard_r.client.reconnecting import GatePlace
from authguard_r.integrations.ros.channels import require_channels
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.names import TypePart
from authguard_r.integrations.ros.nodes.actions import Public
from authguard_r.integrations.ros.nodes.body import RosBody
from authguard_r.integrations.ros.nodes.decisions import Decisions
from authguard_r.integrations.ros.nodes.diagnostics import Diagnostics
from authguard_r.integrations.ros.nodes.displayed_topics import Relay
from authguard_r.integrations.ros.nodes.loop import kept
from authguard_r.integrations.ros.nodes.text_plans import TextPlanServer
from authguard_r.integrations.ros.nodes.values import load_type
from authguard_r.site.model import Site

_DECISION = "authguard_interfaces/msg/Decision"
_STATUS = "authguard_interfaces/msg/GateStatus"


class StatusPublishers:
    """All of it.

    Args:
        ros: what is published, and where.
        site: its input channels.

    Raises:
        MalformedError: what is shown names a channel that the site does not have.
        EnvironmentFault: a type is not installed.
    """

    def __init__(self, ros: RosMap, site: Site) -> None:
        require_channels(ros, site)
        self._ros = ros
        self._decision = load_type(_DECISION, TypePart.MESSAGE)
        self._status = load_type(_STATUS, TypePart.MESSAGE)
        self._shown = {key: load_type(one.type, TypePart.MESSAGE) for key, one in ros.shown.items()}

    def serve(
        self, public: Public, place: GatePlace, *, body: RosBody, session: ControllerSession
    ) -> None:
        """Make what planners and displays see; on the thread of ROS.

        Args:
            public: the node.
            place: which gate.
            body: the robot.
            session: the gate's connections.
        """
        ros = self._ros
        decisions = Decisions(public, place, ros.decisions, self._decision)
        diagnostics = Diagnostics(
            public, ros, body=body, session=session, decisions=decisions, kind=self._status
        )
        work: list[Callable[[], Coroutine[Any, Any, None]]] = [
            decisions.stay,
            decisions.publish,
            diagnostics.stay,
        ]
        work += [Relay(public, key, ros.shown[key], kind).stay for key, kind in self._shown.items()]
        if ros.proposals is not None:
            work.append(TextPlanServer(public, ros.proposals).stay)
        for one in work:
            public.spinner.soon(lambda one=one: public.spinner.begin(kept(one, public.log)))
