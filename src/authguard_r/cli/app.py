# SPDX-License-Identifier: Apache-2.0
"""Every command in one place, so that `authguard --help` is the table of contents."""

from __future__ import annotations

import typer

from authguard_r.cli import (
    approvals,
    attend,
    audit,
    binding,
    decide,
    demo,
    doctor,
    draft,
    emergency,
    estimator,
    frost,
    gate,
    gate_config,
    growth,
    init,
    instances,
    key_answers,
    key_files,
    key_lists,
    key_requests,
    keys,
    learn,
    log_explain,
    log_export,
    log_keys,
    log_show,
    log_verify,
    mcp,
    metrics,
    normalize,
    orders,
    prompts,
    readers,
    recover,
    replay,
    risk_policy,
    robot,
    ros,
    run,
    safety_config,
    segments,
    serve,
    shred,
    site,
    stop_lane,
    templates,
    watch,
    witness,
)

app = typer.Typer(
    name="authguard",
    help="Hold a robot that a language model drives to the mission that an operator signed.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("demo")(demo.demo)
app.command("init")(init.init_command)
app.command("learn")(learn.learn_command)
app.command("doctor")(doctor.doctor)
app.command("mcp")(mcp.mcp_command)
app.command("mcp-tools")(mcp.mcp_tools_command)
app.command("serve")(serve.serve_command)
keys.app.command("protect")(key_files.protect_command)
keys.app.command("unprotect")(key_files.unprotect_command)
keys.app.command("public")(key_files.public_command)
keys.app.command("request")(key_requests.request_command)
keys.app.command("rotate")(key_requests.rotate_command)
keys.app.command("issue")(key_answers.issue_command)
keys.app.command("install")(key_answers.install_command)
keys.app.command("revoke")(key_lists.revoke_command)
keys.app.command("lists")(key_lists.lists_command)
keys.app.command("show")(key_lists.show_command)
app.add_typer(keys.app, name="keys")
app.add_typer(key_lists.app, name="revocations")
app.add_typer(gate_config.app, name="gate-config")
app.add_typer(safety_config.app, name="safety-config")
app.add_typer(emergency.app, name="emergency")
app.add_typer(site.app, name="site")
app.add_typer(risk_policy.app, name="risk-policy")
app.add_typer(approvals.app, name="approvals")
app.add_typer(binding.app, name="binding")
orders.app.command("draft")(draft.draft_command)
orders.app.add_typer(templates.app, name="template")
orders.app.add_typer(instances.app, name="instance")
app.add_typer(orders.app, name="mission")
app.command("normalize")(normalize.normalize_command)
app.command("decide")(decide.decide_command)
app.command("run")(run.run_command)
app.command("gate")(gate.gate_command)
app.command("status")(attend.status_command)
app.command("watch")(watch.watch_command)
app.command("stop")(attend.stop_command)
app.command("resume")(attend.resume_command)
app.command("recover")(recover.recover_command)
app.command("explain")(attend.explain_command)
app.command("metrics")(metrics.metrics_command)
app.command("stop-lane")(stop_lane.stop_lane_command)
app.command("robot")(robot.robot_command)
app.command("estimator")(estimator.estimator_command)
audit.app.command("verify")(log_verify.verify_command)
audit.app.command("export")(log_export.export_command)
audit.app.command("key")(log_keys.key_command)
audit.app.command("prompts")(prompts.prompts_command)
audit.app.command("growth")(growth.growth_command)
audit.app.command("segments")(segments.segments_command)
audit.app.command("reader")(readers.reader_command)
audit.app.command("show")(log_show.show_command)
audit.app.command("replay")(replay.replay_command)
audit.app.command("shred")(shred.shred_command)
audit.app.command("explain")(log_explain.explain_command)
app.add_typer(audit.app, name="audit")
app.add_typer(frost.app, name="frost")
app.add_typer(ros.app, name="ros")
app.add_typer(witness.app, name="witness")
