"""Pages in headless Chromium, without any network."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from pathlib import Path

import pytest


def driven(page: Path, script: str, *, width: int = 1200, height: int = 1000, ms: int = 9000) -> dict[str, str]:
    """Return what a script says of a page: the data-* entries of its own body, once `f`, the page's frame, is loaded.

    The page keeps its own size, whatever the browser's window is. Skips the test where there is no browser.
    """
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium here")
    driver = page.parent / "driver.html"
    frame = f'<iframe id="f" src="{page.name}" width="{width}" height="{height}" style="border:0"></iframe>'
    driver.write_text(f"<body>{frame}<script>{script}</script>")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
    flags += [f"--virtual-time-budget={ms}", f"--user-data-dir={page.parent / 'profile'}"]
    done = subprocess.run(
        [chromium, *flags, "--dump-dom", driver.as_uri()], capture_output=True, text=True, timeout=120, check=False
    )
    if "<body" not in done.stdout:
        pytest.skip(f"Chromium does not run here: {done.stderr[-200:]}")
    return {key: html.unescape(value) for key, value in re.findall(r'data-(\w+)="([^"]*)"', done.stdout)}


def beyond(page: Path, width: int, what: str = "html") -> list[int]:
    """Return by how many px the content of each such element is wider than it."""
    script = (
        f"f.onload=()=>{{const all=[...f.contentDocument.querySelectorAll('{what}')];"
        "document.body.dataset.w=all.map(e=>e.scrollWidth-e.clientWidth).join(' ')}"
    )
    return [int(w) for w in driven(page, script, width=width, height=900, ms=4000)["w"].split()]
