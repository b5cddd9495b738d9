"""`cadcam` and `python -m cadcam`: the command line, which ends in one line from its first moment on."""

from __future__ import annotations

import sys


def main() -> int:
    """Run the command line and return its exit code; an interruption while it is being loaded shows no traceback."""
    try:
        from cadcam.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("cadcam: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
