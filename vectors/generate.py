# SPDX-License-Identifier: Apache-2.0
"""Writes the vectors: inputs with the answers that every implementation must give.

    .venv/bin/python vectors/generate.py [FOLDER]

Instants and keys are fixed, so that the files change only when the language does; `token.json`
has fresh keys each time. Schema: vectors/README.md
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from making import (
    ROOT,
    approval,
    certificate,
    encoding,
    gate,
    lifecycle,
    normalizing,
    repair,
    replies,
    retention,
    revocation,
    risk,
    stated,
    template,
    tokens,
)

from fixtures import frame_streams, reply_page

Json = dict[str, Any]


def main(folder: Path) -> None:
    """Write every file."""
    write(folder / "approval.json", approval.approval_vectors())
    write(folder / "certificate.json", certificate.certificate_vectors())
    write(folder / "encoding.json", encoding.encoding_vectors())
    write(folder / "frames.json", frame_streams.every())
    write(folder / "gate.json", gate.gate_vectors())
    write(folder / "lifecycle.json", lifecycle.lifecycle_vectors())
    write(folder / "normalize.json", normalizing.normalize_vectors())
    write(folder / "repair.json", repair.repair_vectors())
    write(folder / "replies.json", replies.reply_vectors())
    write(folder / "retention.json", retention.retention_vectors())
    write(folder / "revocation.json", revocation.revocation_vectors())
    write(folder / "risk.json", risk.risk_vectors())
    write(folder / "stated.json", stated.stated_vectors())
    write(folder / "template.json", template.template_vectors())
    write(folder / "token.json", tokens.token_vectors())


def write_pages(folder: Path) -> None:
    """Write the reference pages that list what the vectors hold."""
    (folder / "replies.md").write_text(reply_page.reply_page(), encoding="utf-8")


def write(path: Path, content: Json) -> None:
    """Write one file in a stable form."""
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=True)
    path.write_text(text + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "vectors")
    if len(sys.argv) == 1:
        write_pages(ROOT / "docs" / "reference")
