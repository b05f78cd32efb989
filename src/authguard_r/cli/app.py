# SPDX-License-Identifier: Apache-2.0
"""Every command in one place, so that `authguard --help` is the table of contents.

A command line imports the module of its command and no other: a stop does not wait for the parser
of other commands.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

from authguard_r.operations.command_tree import CommandEntry, Program, command_tree

#: What each group is about.
GROUPS: Final = {
    "mission": "Draft, review, sign and manage missions",
    "mission template": "Missions that are signed once and filled in many times",
    "mission instance": "Fill in a signed template",
    "approvals": "Open approval requests: list, show, answer, watch",
    "site": "The site model: regions, objects, robots and their names",
    "site import": "Draft a site model from the file of another program",
    "binding": "What each field of each tool means",
    "ros": "ROS 2: the map, its keystore and its checks",
    "audit": "The audit log: verify, show, replay, explain, export",
    "witness": "A witness that cosigns the checkpoints of audit logs",
    "keys": "Keys, certificates and revocation lists",
    "gate-config": "The gate's signed configuration: who may use which role",
    "safety-config": "The robot's signed safety limits",
    "risk-policy": "The organization's signed risk policy",
    "emergency": "What the robot may do without a mission",
    "emergency policy": "The signed emergency policy",
    "advanced": "Rare commands: threshold signatures, lists, processes",
    "advanced revocations": "Bring revocation lists to a gate or a trust folder",
    "advanced frost": "Threshold signatures: t of n people approve as one",
    "advanced frost dkg": "Make a group key that no member ever holds",
}

#: Each command by its words, with the module and function that it is, and its line in a list.
COMMANDS: Final = {
    words: CommandEntry(*told)
    for words, told in {
        "status": ("status:status", "Show the robot, the mission and what needs an answer"),
        "watch": ("watch:watch", "Show decisions, requests and alerts as they happen"),
        "explain": ("explain:explain", "Explain the last refusal, or any record of the log"),
        "stop": ("stop:stop", "Stop the robot now"),
        "resume": ("resume:resume", "Resume a stopped or suspended mission"),
        "mission draft": ("draft:draft", "Draft a mission from a sentence"),
        "mission compile": ("mission:compile", "Compile a draft to a mission"),
        "mission review": ("mission:review", "Show what a mission grants, row by row"),
        "mission check": ("mission:check", "Check a mission for mistakes and risks"),
        "mission sign": ("sign:sign", "Show a mission, ask, and sign it"),
        "mission verify": ("mission:verify", "Verify the signature of a mission"),
        "mission show": ("mission:show", "Print a mission, without verifying it"),
        "mission diff": ("mission:diff", "Show what a new version changes"),
        "mission issue": ("orders:issue", "Give the gate a mission; activate it later"),
        "mission activate": ("orders:activate", "Give the gate a mission and activate it"),
        "mission revoke": ("orders:revoke", "End a mission now"),
        "mission complete": ("orders:complete", "Declare a mission complete"),
        "mission suspend": ("orders:suspend", "Suspend a mission"),
        "mission resume": ("orders:resume", "Resume a suspended mission"),
        "mission resolve": ("orders:resolve", "Say how an action ended that the gate lost"),
        "mission choose": ("orders:choose", "Choose one of the rows that a grant offers"),
        "mission template compile": ("templates:compile", "Compile a draft with holes"),
        "mission template review": ("templates:review", "Show all missions of a template"),
        "mission template sign": ("templates:sign", "Show a template, ask, and sign it"),
        "mission template show": ("templates:show", "Print a template, without verifying it"),
        "mission template issue": ("templates:issue", "Make a scheduler's key and certificate"),
        "mission template admit": ("templates:admit", "Give the gate a signed template"),
        "mission template withdraw": ("templates:withdraw", "End a template and its missions"),
        "mission instance sign": ("instances:sign", "Fill in every hole, and sign"),
        "approvals list": ("approvals:list", "List the open requests"),
        "approvals show": ("approvals:show", "Show one request in full"),
        "approvals approve": ("approvals:approve", "Show a request, ask, and approve it"),
        "approvals deny": ("approvals:deny", "Show a request, ask, and deny it"),
        "approvals watch": ("approvals:watch", "Show requests and answers as they happen"),
        "approvals preapprove": ("preapprove:preapprove", "Approve low-risk actions ahead"),
        "demo": ("demo:demo", "Run the hospital story on the simulated robot"),
        "examples": ("examples:examples", "Copy the example files to a folder"),
        "init": ("init:init", "Create a set-up for your tools that refuses every call"),
        "learn": ("learn:learn", "Propose a binding and a mission from a shadow run"),
        "site check": ("site:check", "Check a site model; name every fault"),
        "site show": ("site:show", "Show regions, objects, robots and names"),
        "site diff": ("site:diff", "Show what a new version changes"),
        "site sign": ("site:sign", "Sign a site model"),
        "site verify": ("site:verify", "Verify the signature of a site model"),
        "site import scene-graph": ("site:scene_graph", "From a scene graph (JSON)"),
        "site import nav2-map": ("site:nav2_map", "From a map server's map (YAML and PGM)"),
        "binding check": ("binding:check", "Check that every field of every tool is bound"),
        "binding list": ("binding:list", "List the bindings of this package"),
        "binding show": ("binding:show", "Show each tool, with a sample call"),
        "binding schemas": ("binding:schemas", "Print the tools as a language model is shown them"),
        "normalize": ("normalize:normalize", "Read planner output; print its actions"),
        "decide": ("decide:decide", "Decide one action as a dry run"),
        "run": ("run:run", "Enforce a plan on the simulated robot"),
        "mcp": ("mcp:mcp", "Serve a robot's MCP server to a planner, through the gate"),
        "serve": ("serve:serve", "Answer decisions over HTTP (OpenID AuthZEN)"),
        "ros keystore": ("ros:keystore", "Write a keystore from a map"),
        "ros check": ("ros:check", "Check that only the gate can move the robot"),
        "robot": ("robot:robot", "Run the simulated robot as a process"),
        "estimator": ("estimator:estimator", "Sign sensor values and send them to the gate"),
        "audit verify": ("log_verify:verify", "Verify that a log is complete and unchanged"),
        "audit show": ("log_show:show", "Print a log as a timeline"),
        "audit explain": ("log_explain:explain", "Explain one record"),
        "audit replay": ("replay:replay", "Make every decision of a log again"),
        "audit export": ("log_export:export", "Write a log as JSON Lines or CSV"),
        "audit key": ("log_keys:key", "Print the keys that verify a robot's log"),
        "audit prompts": ("prompts:prompts", "Count how often people were asked"),
        "audit growth": ("growth:growth", "Show how much of a log each mission wrote"),
        "audit segments": ("segments:segments", "List the segments of a log"),
        "audit reader": ("readers:reader", "Make a key that reads sealed fields"),
        "audit shred": ("shred:shred", "Destroy sealed fields of a mission"),
        "witness init": ("witness:init", "Create a witness"),
        "witness add": ("witness:add", "Register a log"),
        "witness forget": ("witness:forget", "Remove a log"),
        "witness show": ("witness:show", "Show its logs and what it refused"),
        "witness serve": ("witness:serve", "Serve requests to cosign"),
        "doctor": ("doctor:doctor", "Find every unsafe or missing part of a set-up"),
        "gate": ("gate:gate", "Run the gate of one robot"),
        "keys init": ("keys:init", "Create a trust folder"),
        "keys request": ("key_requests:request", "Make a key and a certificate request"),
        "keys issue": ("key_answers:issue", "Answer a request with a certificate"),
        "keys install": ("key_answers:install", "Install the answer to a request"),
        "keys rotate": ("key_requests:rotate", "Request the next key of the same name"),
        "keys revoke": ("key_lists:revoke", "Revoke certificates"),
        "keys lists": ("key_lists:lists", "Sign the revocation lists again"),
        "keys show": ("key_lists:show", "Show who may sign what, and until when"),
        "keys protect": ("key_files:protect", "Encrypt a key file with a passphrase"),
        "keys unprotect": ("key_files:unprotect", "Decrypt a key file"),
        "keys public": ("key_files:public", "Print the public key of a key"),
        "gate-config make": ("gate_config:make", "Create a configuration to edit and sign"),
        "gate-config sign": ("gate_config:sign", "Show a configuration, ask, and sign it"),
        "gate-config show": ("gate_config:show", "Show who may use which role"),
        "safety-config make": ("safety_config:make", "Create a configuration to edit and sign"),
        "safety-config sign": ("safety_config:sign", "Show a configuration, ask, and sign it"),
        "safety-config show": ("safety_config:show", "Show the limits"),
        "risk-policy make": ("risk_policy:make", "Create a policy to edit and sign"),
        "risk-policy sign": ("risk_policy:sign", "Show a policy, ask, and sign it"),
        "risk-policy show": ("risk_policy:show", "Show a policy"),
        "emergency call": ("emergency:call", "Call an emergency capability of the gate"),
        "emergency policy make": ("emergency:make", "Create a policy to edit and sign"),
        "emergency policy check": ("emergency:check", "Check a policy"),
        "emergency policy sign": ("emergency:sign", "Show a policy, ask, and sign it"),
        "emergency policy show": ("emergency:show", "Show a policy"),
        "recover": ("recover:recover", "Let the gate continue after its store was restored"),
        "metrics": ("metrics:metrics", "Print or serve metrics for Prometheus"),
        "advanced mcp-tools": ("mcp:mcp_tools", "List a robot's MCP tools and their bindings"),
        "advanced stop-process": ("stop_lane:stop_lane", "Run the process that serves stops"),
        "advanced revocations install": ("key_lists:install", "Install newer lists"),
        "advanced frost deal": ("frost:deal", "Make a group's key and its shares"),
        "advanced frost dkg plan": ("frost:plan", "List who makes a key together"),
        "advanced frost dkg offer": ("frost:offer", "Round 1: make a secret and an offer"),
        "advanced frost dkg exchange": ("frost:exchange", "Round 2: check the offers"),
        "advanced frost dkg finish": ("frost:finish", "Write your share and the group"),
        "advanced frost protect": ("frost:protect", "Encrypt your share with a passphrase"),
        "advanced frost certify": ("frost:certify", "Issue the group's certificate"),
        "advanced frost ballot": ("frost:ballot", "Write what the group signs"),
        "advanced frost commit": ("frost:commit", "Round 1: make nonces"),
        "advanced frost share": ("frost:share", "Round 2: show, ask, and sign your part"),
        "advanced frost aggregate": ("frost:aggregate", "Make the approval of the parts"),
        "advanced frost submit": ("frost:submit", "Give the gate the approval"),
        "advanced frost show": ("frost:show", "Show what a file is"),
    }.items()
}

AUTHGUARD: Final = Program(
    name="authguard",
    package="authguard_r.cli",
    distribution="authguard-r",
    help="Let a language model plan for a robot, within the mission that an operator signed.",
    commands=COMMANDS,
    groups=GROUPS,
    sections={
        "For operators": ("status", "watch", "explain", "stop", "resume", "mission", "approvals"),
        "For engineers": (
            *("demo", "examples", "init", "site", "binding", "normalize", "decide", "run"),
            *("learn", "mcp", "serve", "ros", "robot", "estimator"),
        ),
        "For auditors": ("audit", "witness"),
        "For administrators": (
            *("doctor", "gate", "keys", "gate-config", "safety-config", "risk-policy"),
            *("emergency", "recover", "metrics", "advanced"),
        ),
    },
    services=frozenset(
        {"gate", "robot", "estimator", "mcp", "serve", "advanced stop-process", "witness serve"}
    ),
    renamed={
        "mission lint": "mission check",
        "emergency policy lint": "emergency policy check",
        "frost inspect": "advanced frost show",
        "frost": "advanced frost",
        "revocations": "advanced revocations",
        "mcp-tools": "advanced mcp-tools",
        "stop-lane": "advanced stop-process",
    },
    renamed_options={
        **{
            command: {"--run": "--gate"}
            for command in ("doctor", "gate", "mcp", "serve", "robot", "estimator", "advanced")
        },
        "stop": {"--why": "--reason"},
        "advanced frost submit": {"--why": "--reason"},
        "advanced frost dkg finish": {"--from": "--contribution"},
        "audit show": {"--from": "--first", "--to": "--last", "--reason": "--code"},
        "audit replay": {"--from": "--first"},
        "audit verify": {"--key": "--log-key"},
        "audit segments": {"--key": "--log-key"},
        "emergency call": {"--key": "--call"},
        "keys install": {"--dir": "--trust"},
    },
)


@cache
def program(first: str = "") -> Any:
    """Return the tree of commands, for a command line that begins with this word."""
    return command_tree(AUTHGUARD, first)
