# SPDX-License-Identifier: Apache-2.0
"""Every command in one place, so that `authguard --help` is the table of contents.

A command line imports and makes what its first word leads to and nothing else: a stop is not to
wait for the parser of everything that is no stop.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any, Final

import typer

#: The commands, each with the module and the function that it is.
COMMANDS: Final = {
    "demo": "demo:demo",
    "init": "init:init_command",
    "learn": "learn:learn_command",
    "doctor": "doctor:doctor",
    "mcp": "mcp:mcp_command",
    "mcp-tools": "mcp:mcp_tools_command",
    "serve": "serve:serve_command",
    "normalize": "normalize:normalize_command",
    "decide": "decide:decide_command",
    "run": "run:run_command",
    "gate": "gate:gate_command",
    "status": "operate:status_command",
    "watch": "watch:watch_command",
    "stop": "stop:stop_command",
    "resume": "operate:resume_command",
    "recover": "recover:recover_command",
    "explain": "operate:explain_command",
    "metrics": "metrics:metrics_command",
    "stop-lane": "stop_lane:stop_lane_command",
    "robot": "robot:robot_command",
    "estimator": "estimator:estimator_command",
}

#: The groups of commands, each with the module whose `app` it is.
GROUPS: Final = {
    "keys": "keys",
    "revocations": "key_lists",
    "gate-config": "gate_config",
    "safety-config": "safety_config",
    "emergency": "emergency",
    "site": "site",
    "risk-policy": "risk_policy",
    "approvals": "approvals",
    "binding": "binding",
    "mission": "orders",
    "audit": "audit",
    "frost": "frost",
    "ros": "ros",
    "witness": "witness",
}

#: What other modules have in a group, after the group's own; an `app` is a group in the group.
ADDED: Final = {
    "keys": {
        "protect": "key_files:protect_command",
        "unprotect": "key_files:unprotect_command",
        "public": "key_files:public_command",
        "request": "key_requests:request_command",
        "rotate": "key_requests:rotate_command",
        "issue": "key_answers:issue_command",
        "install": "key_answers:install_command",
        "revoke": "key_lists:revoke_command",
        "lists": "key_lists:lists_command",
        "show": "key_lists:show_command",
    },
    "approvals": {"preapprove": "preapprove:preapprove_command"},
    "mission": {
        "draft": "draft:draft_command",
        "template": "templates:app",
        "instance": "instances:app",
    },
    "audit": {
        "verify": "log_verify:verify_command",
        "export": "log_export:export_command",
        "key": "log_keys:key_command",
        "prompts": "prompts:prompts_command",
        "growth": "growth:growth_command",
        "segments": "segments:segments_command",
        "reader": "readers:reader_command",
        "show": "log_show:show_command",
        "replay": "replay:replay_command",
        "shred": "shred:shred_command",
        "explain": "log_explain:explain_command",
    },
}


@cache
def program(first: str = "") -> Any:
    """Return the tree of commands that a command line's first word leads to.

    Any word that names no command and no group gets the whole tree: for help, or to suggest one.
    """
    app = typer.Typer(
        name="authguard",
        help="Hold a robot that a language model drives to the mission that an operator signed.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(lambda: None)  # a command that is alone keeps its name
    everything = first not in {*COMMANDS, *GROUPS}
    for name, place in COMMANDS.items():
        if everything or name == first:
            app.command(name)(_named(place))
    for name, place in GROUPS.items():
        if everything or name == first:
            app.add_typer(_group(name, f"{place}:app"), name=name)
    return typer.main.get_command(app)


@cache
def _group(name: str, place: str) -> typer.Typer:
    """Return a group with what other modules add to it; they are added once."""
    group: typer.Typer = _named(place)
    for word, added in ADDED.get(name, {}).items():
        found = _named(added)
        if isinstance(found, typer.Typer):
            group.add_typer(found, name=word)
        else:
            group.command(word)(found)
    return group


def _named(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(f"authguard_r.cli.{module}"), name)
