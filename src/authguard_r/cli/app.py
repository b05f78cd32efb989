# SPDX-License-Identifier: Apache-2.0
"""Every command in one place, so that `authguard --help` is the table of contents."""

from __future__ import annotations

import typer

from authguard_r.cli import (
    audit,
    binding,
    decide,
    demo,
    doctor,
    draft,
    keys,
    normalize,
    orders,
    run,
    site,
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
app.command("doctor")(doctor.doctor)
app.add_typer(keys.app, name="keys")
app.add_typer(site.app, name="site")
app.add_typer(binding.app, name="binding")
orders.app.command("draft")(draft.draft_command)
app.add_typer(orders.app, name="mission")
app.command("normalize")(normalize.normalize_command)
app.command("decide")(decide.decide_command)
app.command("run")(run.run_command)
app.command("stop")(run.stop_command)
app.add_typer(audit.app, name="audit")
