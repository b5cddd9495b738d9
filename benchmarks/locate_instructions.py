"""Instructions per photo from a rough start to a pose with covariance, by library.

    python benchmarks/locate_instructions.py ../shared/data/shipblock_clean

A processor's time depends on what else the machine does; a count of instructions does not, to a part in a thousand, and
tells an improvement of one per cent from none. Needs valgrind: of a run that locates some photos and one that locates
none, both under callgrind, the difference is counted. Several minutes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from cadcam.locate.in_photos import locate_part
from locate_sets import PhotoSet

PHOTOS = 12
WARM = 2  # starts before the counted ones
LIBRARIES = {"_raster": "cadcam's core", "multiarray": "NumPy", "linalg": "NumPy", "python": "Python", "blas": "BLAS"}


def locate_some(folder: Path, noise: int, count: int) -> None:
    """Locate the first `count` of PHOTOS starts spread over a set, after WARM others."""
    photos = PhotoSet(folder)
    starts = photos.starts[:: max(1, len(photos.starts) // PHOTOS)][:PHOTOS]
    photo = {start.frame: photos.photo(noise, start.frame) for start in starts}
    assert photos.part.likenesses is not None
    for start in (*starts[:WARM], *starts[:count]):
        locate_part(photos.part, [photo[start.frame]], start.pose)


def counted(folder: Path, noise: int, count: int) -> Counter[str]:
    """Return the instructions of a run that locates so many photos, by file of code."""
    fixed = {**os.environ, "PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "out"
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}", sys.executable, __file__, str(folder)]
        done = subprocess.run([*command, "--noise", str(noise), "--run", str(count)], capture_output=True, env=fixed)
        if done.returncode:
            raise SystemExit(done.stderr.decode()[-2000:])
        return by_file(out)


def by_file(out: Path) -> Counter[str]:
    """Return the instructions that callgrind counted, by object file; what functions called is counted there."""
    names: dict[str, str] = {}
    total: Counter[str] = Counter()
    current, of_call = "", False
    for line in out.read_text().splitlines():
        if line.startswith(("ob=", "cob=")):  # a name is written out once, wherever it comes first
            field, _, value = line.partition("=")
            number, _, name = value.partition(" ")
            known = names.setdefault(number, name)
            current = known if field == "ob" else current
        elif line.startswith("calls="):
            of_call = True
        elif line[:1].isdigit() or line[:1] in ("+", "-", "*"):
            total[current] += 0 if of_call else int(line.split()[1])
            of_call = False
    return total


def library_of(file: str) -> str:
    """Return what an object file belongs to."""
    return next((name for part, name in LIBRARIES.items() if part in Path(file).name), "the rest")


def main() -> None:
    """Print millions of instructions a photo, for each noise level."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a set of photos (shipblock_clean, or one by locate_scene.py)")
    parser.add_argument("--noise", type=int, help="this level alone")
    parser.add_argument("--run", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.run is not None:
        locate_some(asked.folder, asked.noise, asked.run)
        return
    if shutil.which("valgrind") is None:
        raise SystemExit("valgrind is not installed; it counts the instructions")
    columns = [*dict.fromkeys(LIBRARIES.values()), "the rest"]
    print("| noise | millions a photo | " + " | ".join(columns) + " |\n" + "|---" * (2 + len(columns)) + "|")
    for noise in PhotoSet(asked.folder).noises if asked.noise is None else [asked.noise]:
        some, none = (counted(asked.folder, noise, count) for count in (PHOTOS, 0))
        share: Counter[str] = Counter()
        for file in some:
            share[library_of(file)] += some[file] - none[file]
        each = [share[column] / PHOTOS / 1e6 for column in columns]
        print(f"| {noise} | {sum(each):.0f} | " + " | ".join(f"{millions:.0f}" for millions in each) + " |", flush=True)


if __name__ == "__main__":
    main()
