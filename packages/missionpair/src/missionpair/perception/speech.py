# SPDX-License-Identifier: Apache-2.0
"""Speech: a text as sound in a synthetic voice, and what a small recognizer hears of it."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from random import Random

from missionpair.perception import hearing
from missionpair.perception.tools import package, package_version, run, version_of

#: Voices, each with the program that has it.
VOICES = {
    "en-us": "espeak-ng",
    "en-gb": "espeak-ng",
    "awb": "flite",
    "rms": "flite",
    "slt": "flite",
}


def voice_of(key: str) -> str:
    """Return the voice that the dice of a key draw; the same for the same key."""
    return Random(f"voice {key}").choice(sorted(VOICES))  # noqa: S311


def spoken(text: str, voice: str) -> bytes:
    """Return a text as it is spoken, as a WAV file.

    Args:
        text: what is said.
        voice: one of `VOICES`.

    Raises:
        PerceptionError: the voice's program is not installed, or it failed.
    """
    with tempfile.TemporaryDirectory(prefix="missionpair-") as folder:
        said, heard = Path(folder) / "said.txt", Path(folder) / "said.wav"
        said.write_text(text, encoding="utf-8")
        if VOICES[voice] == "flite":
            run("flite", "-voice", voice, "-f", str(said), "-o", str(heard))
        else:
            run("espeak-ng", "-v", voice, "-s", "140", "-f", str(said), "-w", str(heard))
        return heard.read_bytes()


def hear(wav: bytes) -> str:
    """Return what the recognizer hears; empty where it hears nothing.

    Raises:
        PerceptionError: the extra `perception` is not installed, or the recognizer failed.
    """
    package("moonshine_voice")  # says what to install
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        file.write(wav)
        file.flush()
        heard = run(sys.executable, str(Path(hearing.__file__)), file.name)
    return " ".join(heard.decode(errors="replace").split())


def speaker(voice: str) -> str:
    """Return the speaker's name with its version."""
    return version_of(VOICES[voice])


def recognizer_name() -> str:
    """Return the recognizer's name with its version."""
    return f"{package_version('moonshine-voice')} tiny-en"
