# SPDX-License-Identifier: Apache-2.0
"""A token that signs: SoftHSM2, one folder with its own configuration for each test.

    with Token(tmp_path) as token:
        token.make("operator-1")
        open_key(token.uri("operator-1"), lambda _: token.pin)

Debian has it in the package `softhsm2`. Where it is not installed its tests are skipped, but not
in continuous integration (`AUTHGUARD_CI`), which installs it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pkcs11
import pytest
from pkcs11 import Attribute, KeyType, Mechanism, ObjectClass

MODULES = ("/usr/lib/softhsm/libsofthsm2.so", "/usr/lib64/softhsm/libsofthsm2.so")
MODULE = next((path for path in MODULES if Path(path).is_file()), MODULES[0])
TOOL = shutil.which("softhsm2-util")
#: DER of the object identifier 1.3.101.112.
ED25519 = bytes.fromhex("06032b6570")
needs_token = pytest.mark.skipif(
    "AUTHGUARD_CI" not in os.environ and (TOOL is None or not Path(MODULE).is_file()),
    reason="needs SoftHSM2 (Debian: softhsm2)",
)


class Token:
    """One initialized token, and nothing else, for the module of this process."""

    pin = "274918"
    label = "a token"

    def __init__(self, folder: Path) -> None:
        self._store = folder / "token"
        self._config = folder / "softhsm2.conf"
        self._before = os.environ.get("SOFTHSM2_CONF")

    def __enter__(self) -> Self:
        self._store.mkdir()
        self._config.write_text(
            f"directories.tokendir = {self._store}\nobjectstore.backend = file\nlog.level = ERROR\n"
        )
        os.environ["SOFTHSM2_CONF"] = str(self._config)  # the module reads it when it is loaded
        self.add(self.label)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pkcs11.lib(MODULE).finalize()
        if self._before is None:
            del os.environ["SOFTHSM2_CONF"]
        else:
            os.environ["SOFTHSM2_CONF"] = self._before

    def add(self, label: str) -> None:
        """Initialize one more token."""
        words = ["--init-token", "--free", "--label", label, "--pin", self.pin]
        subprocess.run([str(TOOL), *words, "--so-pin", "12345678"], check=True, capture_output=True)
        # what asks next sees it; unloading would crash what still refers to the module
        pkcs11.lib(MODULE).reinitialize()

    def uri(self, name: str, *, token: str | None = None) -> str:
        spelled = (token or self.label).replace(" ", "%20")
        return f"pkcs11:token={spelled};object={name}?module-path={MODULE}"

    def session(self) -> Any:
        """Return a session of the token's owner, to put things into it; close it."""
        token = pkcs11.lib(MODULE).get_token(token_label=self.label)
        return token.open(rw=True, user_pin=self.pin)

    def make(self, name: str, *, id: bytes = b"\1", **changes: Any) -> None:  # noqa: A002
        """Make an Ed25519 pair inside; `changes` are of the private key's template."""
        template = {Attribute[key.upper()]: value for key, value in changes.items()}
        with self.session() as session:
            session.create_domain_parameters(
                KeyType.EC_EDWARDS, {Attribute.EC_PARAMS: ED25519}, local=True
            ).generate_keypair(
                mechanism=Mechanism.EC_EDWARDS_KEY_PAIR_GEN,
                store=True,
                label=name,
                id=id,
                private_template=template,
            )

    def drop(self, name: str, kind: ObjectClass) -> None:
        """Destroy one part of a pair."""
        with self.session() as session:
            session.get_key(kind, label=name).destroy()

    def put_public(self, name: str, point: bytes, *, id: bytes = b"\1") -> None:  # noqa: A002
        """Put a public key in, whoever's it is."""
        with self.session() as session:
            session.create_object(
                {
                    Attribute.CLASS: ObjectClass.PUBLIC_KEY,
                    Attribute.KEY_TYPE: KeyType.EC_EDWARDS,
                    Attribute.TOKEN: True,
                    Attribute.LABEL: name,
                    Attribute.ID: id,
                    Attribute.EC_PARAMS: ED25519,
                    Attribute.EC_POINT: point,
                }
            )
