# SPDX-License-Identifier: Apache-2.0
"""Run a local server with a scripted stand-in: `python -m missionpair.servers --help`.

Prints its address in one line, then answers until it is ended.
"""

from __future__ import annotations

import argparse
import signal
import sys

from missionpair.servers import SERVERS


def main() -> int:
    """Serve until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(
        prog="python -m missionpair.servers",
        description="A scripted stand-in behind a model server's protocol, on the loopback.",
    )
    parser.add_argument("--protocol", choices=sorted(SERVERS), required=True)
    parser.add_argument("--port", type=int, default=0, help="0 takes any that is free")
    parser.add_argument(
        "--behavior",
        default="obedient",
        help="obedient, resistant, mixed:SEED, odd:KIND or faulty:FAULT; see the how-to",
    )
    given = parser.parse_args()
    stops = {signal.SIGTERM, signal.SIGINT}
    signal.pthread_sigmask(signal.SIG_BLOCK, stops)  # before any thread is there
    try:
        server = SERVERS[given.protocol](given.behavior, port=given.port)
    except (ValueError, OSError, OverflowError) as error:
        parser.error(str(error))
    with server:
        sys.stdout.write(f"{server.base_url}\n")
        sys.stdout.flush()
        signal.sigwait(stops)
    return 0


if __name__ == "__main__":
    sys.exit(main())
