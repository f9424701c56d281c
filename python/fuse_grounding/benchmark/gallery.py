"""Pictures of single episodes of a benchmark, as `fuse run --out` leaves them: for people to step through."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from fuse_grounding.agent import Session
from fuse_grounding.environment import Episode
from fuse_grounding.errors import FuseError
from fuse_grounding.grounding import Grounded
from fuse_grounding.record import StepEntry
from fuse_grounding.runfolder import RunFolder

FOLDER = "gallery"


class Gallery:
    """A watcher that writes `ROOT/METHOD/EPISODE/`, whole or not at all; without the map.

    What goes wrong with pictures is not the method's failure: `close` tells it.
    """

    def __init__(self, root: str, method: str, episode: Episode):
        self._final = Path(root) / method / episode.episode_id
        self._partial = self._final.with_name(f".{episode.episode_id}.partial")
        self._files = RunFolder(
            self._partial, episode.episode_id, episode.scene_id, episode.seed, map_too=False
        )
        self._session: Session | None = None
        self._problem: str | None = None

    def started(self, session: Session) -> None:
        """A new folder with the record."""

        def begin() -> None:
            shutil.rmtree(self._partial, ignore_errors=True)
            self._partial.mkdir(parents=True)
            self._files.started(session)

        self._try(begin)

    def stepped(self, session: Session, step: StepEntry) -> None:
        """The step's pictures."""
        self._try(lambda: self._files.stepped(session, step))

    def finished(self, session: Session, grounded: Grounded) -> None:
        """The last pictures."""
        self._session = session
        self._try(lambda: self._files.finished(session, grounded))

    def close(self) -> tuple[str, ...]:
        """Gives the folder its name, metrics in the record; what went wrong, if anything did."""

        def end() -> None:
            assert self._session is not None
            self._session.record.write(self._partial / "episode.json")
            shutil.rmtree(self._final, ignore_errors=True)
            self._partial.rename(self._final)

        if self._session is not None:
            self._try(end)
        if self._session is None or self._problem is not None:
            shutil.rmtree(self._partial, ignore_errors=True)
        return () if self._problem is None else (f"no gallery in {self._final}: {self._problem}",)

    def _try(self, what: Callable[[], None]) -> None:
        if self._problem is None:
            try:
                what()
            except (OSError, FuseError) as error:
                self._problem = str(error)
