"""Write the sample parts into models/: the calibration bench, a machined bracket, a ship block of 10 000 triangles.

Run it as `python examples/sample_parts.py [FOLDER]`. The files are the same each time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cadcam
from cadcam.cad.parts import calibration_bench, machined_bracket, ship_block
from cadcam.cad.read import describe


def main(folder: Path) -> None:
    """Write the models into the folder, each in another format, and say what they are."""
    folder.mkdir(parents=True, exist_ok=True)
    models = {
        "bench.glb": calibration_bench(),
        "bracket.stl": machined_bracket(),
        "shipblock_10k.obj": ship_block(triangles=10_000),
    }
    for name, mesh in models.items():
        cadcam.write_model(folder / name, mesh)
        print(f"{name}: {describe(mesh)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "models")
