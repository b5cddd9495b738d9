"""`cadcam board`: a calibration board to print, at true scale."""

from __future__ import annotations

import argparse

from cadcam.cli.arguments import Verbs, verb
from cadcam.cli.boards import BOARD_HELP
from cadcam.cli.output import check_target

_SHEETS = (".pdf", ".svg")
_EXAMPLES = f"""\
  cadcam board chessboard:9x6:25mm -o board.pdf --page a4
  cadcam board charuco:8x11:20mm:15mm:5X5_100 -o board.svg
  cadcam calibrate images/*.png --board chessboard:9x6:25mm -o camera.json      then, with pictures of it

{BOARD_HELP}"""
_DESCRIPTION = """\
Write a calibration board as SVG or PDF at true scale. Print it without "fit to page", measure it with a ruler or
callipers (what it must measure is printed below it), and give what you measured to cadcam calibrate --board. Glue it on
something stiff and flat: glass, aluminium, a sandwich panel. A chessboard with one even and one odd side, or a ChArUco
board, has only one way up."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "board",
        run,
        short="a calibration board to print, at true scale",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("board", metavar="BOARD", help="the board, such as chessboard:9x6:25mm (see below)")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="sheet to write: .pdf or .svg")
    parser.add_argument("--page", metavar="SIZE", help="paper: a4, a3 ... letter (default: the board with a margin)")


def run(arguments: argparse.Namespace) -> None:
    """Write the sheet."""
    from cadcam.target.boards.pattern import parse_pattern
    from cadcam.target.sheet import write_sheet

    check_target(arguments.output, _SHEETS)
    pattern = parse_pattern(arguments.board)
    sheet = write_sheet(arguments.output, pattern, page=arguments.page)
    width, height = pattern.size_mm
    print(
        f"wrote {arguments.output}: {pattern} on {sheet[0]:.4g} x {sheet[1]:.4g} mm; print it without scaling: the "
        f"black area must measure {width:.2f} x {height:.2f} mm"
    )
