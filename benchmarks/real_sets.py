"""Every public data set in one run: ours, the published values, and what OpenCV gets, as Markdown.

    python benchmarks/real_sets.py ../shared/data

Runs real_calibrations.py, real_boards.py, handeye.py and measure.py on the sets that the folder holds; their tables
stand in docs/benchmarks (real_calibrations.md, real_boards.md, real_handeye.md, measure.md). Takes some minutes. Rows
of OpenCV need opencv-python-headless; its hand-eye rows a version before 5; the wall of dots h5py.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def commands(data: Path) -> list[list[str]]:
    """Return the scripts with their arguments."""
    found = [
        ["real_calibrations.py", str(data)],
        ["real_boards.py", str(data), "--only", "left,right,pair,franka,circles,zhang,dots"],
        ["handeye.py", str(data), "--real-only"],
    ]
    cavity = data / "openptv_cavity"
    return [*found, *([["measure.py", str(cavity)]] if cavity.is_dir() else [])]


def main() -> int:
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        print(__doc__, file=sys.stderr)
        return 2
    failed = 0
    for script, *arguments in commands(Path(sys.argv[1])):
        print(f"\n<!-- {script} -->\n", flush=True)
        failed |= subprocess.run([sys.executable, str(HERE / script), *arguments], check=False).returncode
    return failed


if __name__ == "__main__":
    sys.exit(main())
