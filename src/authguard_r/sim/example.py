# SPDX-License-Identifier: Apache-2.0
"""Where the hospital example lies: in the wheel, or in the checkout."""

from __future__ import annotations

from pathlib import Path

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason


def bundled_hospital() -> Path:
    """Return the folder of the hospital example: in the wheel, or in the checkout.

    Raises:
        EnvironmentFault: neither is there.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "sim" / "hospital", package.parents[1] / "examples" / "hospital"):
        if (folder / "site.yaml").is_file():
            return folder
    raise EnvironmentFault(
        "the hospital example is missing", reason=Reason.FILE_UNAVAILABLE, where=str(package)
    )
