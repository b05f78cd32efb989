# SPDX-License-Identifier: Apache-2.0
"""The README's two commands on a bare machine: Debian's Python 3.11 and pip, and nothing else.

The machine is a folder that `debootstrap` fills, kept in `.environments/bare`. The commands run
inside it with `chroot`, in namespaces of their own, on a copy of what is committed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
from io import BytesIO
from pathlib import Path
from tempfile import mkdtemp

from runner.environments import PLACE, require_programs
from runner.groups import ROOT, GroupError

PACKAGES = ("python3", "python3-venv", "python3-pip", "ca-certificates")
#: Where pip finds packages on this machine, and how it trusts them; taken over as it is here.
SETTINGS = ("/etc/pip.conf", "/etc/ssl/certs", "/etc/resolv.conf", "/etc/hosts")
#: Variables that say how installers reach their registries from here, and the seed of random tests.
KEPT = ("PIP_", "UV_", "SSL_CERT_", "AUTHGUARD_SEED")
COMMANDS = "python3 dev.py demo && python3 dev.py test"


def run() -> str:
    """Run the README's commands; return how they ended."""
    programs = {"debootstrap": "debootstrap", "unshare": "util-linux", "chroot": "coreutils"}
    require_programs(programs)
    machine = _machine()
    home = machine / "srv" / "project"
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    _copy(home)
    script = f"""
        mount --make-rprivate /
        mount -t proc proc {machine}/proc
        mount --rbind /dev {machine}/dev
        mount -t tmpfs tmpfs {machine}/tmp
        {_bound(machine)}
        exec chroot {machine} sh -c 'cd /srv/project && {COMMANDS}'
    """
    words = ["unshare", "--mount", "--pid", "--fork", "sh", "-euc", script]
    kept = {name: value for name, value in os.environ.items() if name.startswith(KEPT)}
    env = {**kept, "HOME": "/root", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8"}
    try:
        code = subprocess.call(words, env=env)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    return "passed" if code == 0 else f"failed: exit {code}"


def _machine() -> Path:
    """Return the folder of the bare machine, made if it is not there."""
    folder = PLACE / "bare"
    if not (folder / "made").is_file():
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(exist_ok=True)
        made = Path(mkdtemp(prefix="bare-", dir=folder.parent))
        how = ["--variant=minbase", f"--include={','.join(PACKAGES)}", "bookworm", str(made)]
        done = subprocess.run(["debootstrap", *how], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise GroupError(f"the bare machine cannot be made:\n{done.stdout[-2_000:]}")
        made.chmod(0o755)
        (made / "made").touch()
        made.rename(folder)
    return folder


def _bound(machine: Path) -> str:
    """Return the lines that show this machine's settings for pip inside the bare one."""
    places = [Path(place) for place in SETTINGS]
    places += [
        Path(os.environ[name])
        for name in ("PIP_CONFIG_FILE", "PIP_CERT", "PIP_FIND_LINKS")
        if name in os.environ
    ]
    places += [Path.home() / ".config" / "pip" / "pip.conf"]
    lines = []
    for place in dict.fromkeys(places):
        if place.exists():
            inside = machine / place.relative_to("/")
            inside.parent.mkdir(parents=True, exist_ok=True)
            if place.is_dir():
                inside.mkdir(exist_ok=True)
            else:
                inside.touch()
            lines.append(f"mount --bind {place.resolve()} {inside}")
    return "\n".join(lines)


def _copy(home: Path) -> None:
    """Copy what is committed, as a clone has it."""
    done = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=False)
    if done.returncode != 0:
        raise GroupError(f"`git archive` failed: {done.stderr.decode(errors='replace')}")
    with tarfile.open(fileobj=BytesIO(done.stdout)) as archive:
        archive.extractall(home, filter="data")
