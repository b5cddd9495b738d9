"""`cadcam` and `python -m cadcam`: the command line, which ends in one line from its first moment on."""

from __future__ import annotations

import sys
import warnings


def main() -> int:
    """Run the command line and return its exit code; an interruption while it is being loaded shows no traceback."""
    if not sys.warnoptions:  # numpy's, of overflow: what comes of it is refused in words that name file and value
        warnings.simplefilter("ignore", RuntimeWarning)
    try:
        from cadcam.cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("cadcam: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    raise SystemExit(main())
