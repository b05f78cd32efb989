# SPDX-License-Identifier: Apache-2.0
"""Whether a binding lets anything through that is not checked, or that no planner may have.

How-to: docs/howto/deploy.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.binding.check import BindingReport, check_binding
from authguard_r.normalize.binding import Binding, ToolWay, effect_of, ways
from authguard_r.normalize.interface import Surface
from authguard_r.operations.checkup.advice import Advice, AdviceCode, fine, unsafe, warning
from authguard_r.site.model import Site

#: Names by which the robot's own belief is changed, as ROS 2 and Nav2 spell them; compared exactly.
_BELIEFS = frozenset(
    {
        "composition_interfaces/srv/LoadNode",
        "composition_interfaces/srv/UnloadNode",
        "initialpose",
        "lifecycle_msgs/srv/ChangeState",
        "nav2_msgs/srv/ClearCostmapAroundRobot",
        "nav2_msgs/srv/ClearCostmapExceptRegion",
        "nav2_msgs/srv/ClearEntireCostmap",
        "nav2_msgs/srv/LoadMap",
        "nav2_msgs/srv/ManageLifecycleNodes",
        "nav2_msgs/srv/SetInitialPose",
        "rcl_interfaces/srv/SetParameters",
        "rcl_interfaces/srv/SetParametersAtomically",
        "robot_localization/srv/SetPose",
        "set_initial_pose",
    }
)


def binding_advice(
    binding: Binding,
    site: Site,
    *,
    interface: tuple[Surface, ...],
    check: str = "authguard binding check --help",
) -> Iterator[Advice]:
    """Yield what a binding leaves open at a site.

    Args:
        binding: sound or not.
        site: the sound site whose words it speaks.
        interface: what the planner's tools say of themselves; empty: nothing to compare with.
        check: the command that shows it all, as it can be pasted but for the interface's file.
    """
    report = check_binding(binding, site, interface=interface)
    unmapped = frozenset(report.unmapped or ())
    for fault in report.faults:
        code = (
            AdviceCode.UNMAPPED
            if f"{fault.where}: {fault.message}" in unmapped
            else AdviceCode.BINDING
        )
        yield unsafe("binding", code, fault.message, place=fault.where, mend=check)
    yield from _compared(report, check)
    yield from _beliefs(binding, site)


def _compared(report: BindingReport, check: str) -> Iterator[Advice]:
    if report.interface is None:
        message = "compared with no interface: nothing shows that every field is bound"
        yield warning("binding", AdviceCode.UNCOMPARED, message, mend=check)
    elif report.uncompared:
        message = f"the interface says nothing of {', '.join(report.uncompared)}"
        yield warning("binding", AdviceCode.UNCOMPARED, message, mend=check)
    elif not report.faults:
        yield fine("binding", AdviceCode.BINDING, f"{report.ways} ways, every field bound")


def _beliefs(binding: Binding, site: Site) -> Iterator[Advice]:
    """What changes a robot's beliefs must be of a type that no planner is ever granted."""
    refused = 0
    for way in ways(binding):
        kind = site.vocabulary.get(way.tool.type)
        told = ", ".join(sorted(_named(way) & _BELIEFS))
        if kind is not None and kind.state_writing:
            refused += 1
        elif told:
            yield unsafe(
                "binding",
                AdviceCode.STATE_WRITING,
                f"`{told}` changes what the robot believes, and `{way.tool.type}` can be granted",
                place=way.place,
                mend="bind it to a type that is `state_writing`",
            )
    if refused:
        message = f"{refused} ways are of types that no mission can grant: always refused"
        yield fine("binding", AdviceCode.STATE_WRITING, message)


def _named(way: ToolWay) -> frozenset[str]:
    """Return every name that a way holds constant, without outer slashes."""
    constants = [argument.constant() for argument in way.tool.arguments.values()]
    words = [*constants, *way.tool.when.values(), effect_of(way.tool), way.tool.message, way.name]
    return frozenset(word.strip("/ ") for word in words if isinstance(word, str))
