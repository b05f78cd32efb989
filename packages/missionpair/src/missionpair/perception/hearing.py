# SPDX-License-Identifier: Apache-2.0
"""`hearing.py WAV`: print what the recognizer hears of one file, in a process of its own.

The library keeps something of what it heard before, which changes what it hears next.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any


def main() -> int:
    """Print the words."""
    moonshine: Any = import_module("moonshine_voice")
    model = Path(moonshine.__file__).parent / "assets" / "tiny-en"
    recognizer = moonshine.Transcriber(model_path=str(model), model_arch=moonshine.ModelArch.TINY)
    sound, rate = moonshine.load_wav_file(sys.argv[1])
    lines = recognizer.transcribe_without_streaming(sound, rate).lines
    sys.stdout.buffer.write(" ".join(line.text for line in lines).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
