"""Child processes: what they say and when, how long they run, how much memory they take."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

THREADS = 2


@dataclass(frozen=True)
class Ran:
    """A child that ended well: its lines with the seconds since its start, its peak memory, and how many
    cores other processes took beside it, on average."""

    lines: list[tuple[float, str]]
    seconds: float
    peak_mib: float
    others: float


class Failed(Exception):
    """A peer that cannot be built or run; the message is what the table says."""


def busy_seconds() -> float:
    """Seconds that all cores together have worked since the machine started; 0 where Linux's count is not."""
    stat = Path("/proc/stat")
    if not stat.is_file():
        return 0.0
    user, nice, system, _idle, _wait, irq, soft, *_ = (int(n) for n in stat.read_text().split()[1:11])
    return (user + nice + system + irq + soft) / os.sysconf("SC_CLK_TCK")


def environment(**more: str) -> dict[str, str]:
    """This process's environment with as many threads for everybody. OpenSplat's rasteriser starts its own
    two; a second pool in torch would spin beside them, hence `OMP_NUM_THREADS` per peer."""
    return os.environ | {"RAYON_NUM_THREADS": str(THREADS), "OMP_NUM_THREADS": str(THREADS)} | more


def run(
    command: Sequence[object],
    log: Path,
    env: dict[str, str] | None = None,
    cwd: Path | None = None,
    limit: float | None = None,
) -> Ran:
    """Runs a command; its output goes to `log` as it comes. Raises Failed, with its last line.

    `limit` seconds after its start, at its next line, it is ended.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    begin, worked, lines = time.perf_counter(), busy_seconds(), []
    with log.open("w", encoding="utf-8") as file:
        child = subprocess.Popen(
            [str(c) for c in command],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=env or environment(),
            cwd=cwd,
        )
        assert child.stdout is not None
        for line in child.stdout:
            now = time.perf_counter() - begin
            lines.append((now, line.rstrip("\n")))
            file.write(f"{now:9.3f} {line}")
            file.flush()
            if limit is not None and now > limit:
                child.kill()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        last = next((text for _, text in reversed(lines) if text.strip()), "no output")
        raise Failed(
            f"`{Path(str(command[0])).name}` ended with status {child.returncode}: {last} (see {log.name})"
        )
    seconds = time.perf_counter() - begin
    others = busy_seconds() - worked - usage.ru_utime - usage.ru_stime
    return Ran(lines, seconds, usage.ru_maxrss / 1024, max(others, 0.0) / seconds)


def replace_all(copy: Path, replacements: Mapping[str, Sequence[tuple[str, str]]]) -> None:
    """Changes files of a copy, by path in it. Raises Failed where there is nothing to replace."""
    for name, pairs in replacements.items():
        text = (copy / name).read_text()
        for old, new in pairs:
            if old not in text:
                raise Failed(f"{name} has no {old.strip()!r}: another version than this was written for")
            text = text.replace(old, new)
        (copy / name).write_text(text)
