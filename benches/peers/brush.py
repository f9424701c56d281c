"""Brush, a trainer on `wgpu`, headless; without a GPU it computes on Mesa's software driver.

Its lock file names commits of burn, cubecl and wgpu on GitHub. A copy takes burn and wgpu from the registry
instead: the releases next to those commits, without the changes for browsers and macOS that the commits are
for.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from peers.process import Failed, run

BURN = "0.22.0-pre.3"
NEVER = 1_000_000
WEIGHTS = "crates/lpips/burn_mapped.bpk"


def registry_manifest(text: str) -> str:
    """Brush's workspace manifest with burn from the registry and its command line alone.

    Raises Failed where the manifest is not as this was written for.
    """
    text, burn = re.subn(
        r'git = "https://github.com/tracel-ai/burn", branch = "main"', f'version = "={BURN}"', text
    )
    text, members = re.subn(
        r"members = \[.*?\]\ndefault-members = \[.*?\]", 'members = ["apps/brush-cli"]', text, flags=re.S
    )
    head, patches, _ = text.partition("[patch.crates-io]")
    if not (burn and members and patches):
        raise Failed("its Cargo.toml is another than this was written for")
    return head


def build(sources: Path, folder: Path, minutes: float) -> Path:
    """The executable, within so many minutes; another call goes on where one ended. Raises Failed."""
    program = folder / "target" / "release" / "brush-cli"
    if program.is_file():
        return program
    copy = folder / "source"
    if not copy.is_dir():
        shutil.copytree(sources, copy, ignore=shutil.ignore_patterns(".git"))
        manifest = copy / "Cargo.toml"
        manifest.write_text(registry_manifest(manifest.read_text()))
        (copy / "Cargo.lock").unlink(missing_ok=True)
        # Weights of a loss that is off; checkouts without large files lack them.
        (copy / WEIGHTS).touch()
    command = ["cargo", "build", "--release", "-p", "brush-cli", "--target-dir", folder / "target"]
    try:
        run(command, folder / "build.log", cwd=copy, limit=60 * minutes)
    except Failed as failure:
        log = (folder / "build.log").read_text()
        if "error" not in log and (done := log.count(" Compiling ")):
            why = f"not built within {minutes:.0f} minutes: cargo had come to the {done}th crate"
            raise Failed(why) from None
        raise failure from None
    return program


def iteration(program: Path, scene: Path, folder: Path, short: int, long: int) -> dict[str, Any]:
    """Seconds an iteration without densification: what a longer run takes more than a shorter one."""
    fixed = ["--refine-every", NEVER, "--export-every", NEVER, "--eval-every", NEVER]
    ran = [
        run(
            [program, scene / "train", "--total-train-iters", n, *fixed],
            folder / f"iteration-{n}.log",
        )
        for n in (short, long)
    ]
    seconds = (ran[1].seconds - ran[0].seconds) / (long - short)
    return {"seconds": seconds, "peak_mib": ran[1].peak_mib, "others": ran[1].others}
