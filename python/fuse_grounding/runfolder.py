"""The folder of one run: the record after every step, pictures, the map. Interrupted, it stays readable."""

from __future__ import annotations

import shutil
from pathlib import Path

from fuse_grounding import visualize
from fuse_grounding.agent import Session
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.grounding import Grounded
from fuse_grounding.parts import Glance
from fuse_grounding.planning.protocol import EvidenceMaps
from fuse_grounding.record import StepEntry


def check(folder: Path, force: bool = False) -> None:
    """Raises InputError unless `folder` is missing or empty; `force` also allows an earlier run.

    An earlier run is a folder with an `episode.json`.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output directory {folder} is a file")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    if not force:
        raise InputError(f"output directory {folder} exists and is not empty; choose another --out")
    if not (folder / "episode.json").is_file():
        raise InputError(f"output directory {folder} is not an earlier run; --force leaves it alone")


def prepare(folder: Path, force: bool = False) -> Path:
    """Makes an empty folder to write into, removing an earlier run under `force`. Raises InputError."""
    try:
        check(folder, force)
        if folder.is_dir() and any(folder.iterdir()):
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"output directory {folder} cannot be written: {error.strerror}") from None
    return folder


class RunFolder:
    """Writes `episode.json`, `steps/NN/*.png`, `overview.png`, `grounding.png`, `scene.ply`."""

    def __init__(
        self,
        folder: Path,
        episode_id: str | None = None,
        scene: str | None = None,
        seed: int | None = None,
        *,
        map_too: bool = True,
    ):
        """The episode's name, scene and seed go into the record, where they are known.

        Without `map_too`, `scene.ply` is left out.
        """
        self.folder, self._map_too = folder, map_too
        self._episode = (episode_id, scene, seed)

    def started(self, session: Session) -> None:
        """The record without steps."""
        session.record.episode_id, session.record.scene, session.record.seed = self._episode
        self._write_record(session)

    def stepped(self, session: Session, step: StepEntry) -> None:
        """The step's pictures, then the record that mentions it."""
        view = session.glance
        assert view is not None
        maps = view.maps
        if maps is None and session.spatial is None:
            maps = session.evidence_of(view)  # semantics, for people
        self._write_step(view, maps)
        self._write_record(session)

    def finished(self, session: Session, grounded: Grounded) -> None:
        """The last pictures, the map, the whole record.

        The last view decided nothing, so that its evidence is rendered here, from the map as it was.
        """
        view, last = session.returned, session.glance
        assert view is not None
        assert last is not None
        if last.maps is None:
            self._write_step(last, session.evidence_of(last))
        maps = view.maps or session.evidence_of(view)
        visualize.write(
            self.folder / "overview.png",
            visualize.overview(grounded.rgb, maps, grounded.mask, _title(session, grounded)),
        )
        visualize.write(
            self.folder / "grounding.png",
            visualize.mask_over(grounded.rgb, grounded.mask, _caption(grounded)),
        )
        if session.spatial is not None and self._map_too:
            session.spatial.map.save(self.folder / "scene.ply")
        self._write_record(session)

    def _write_record(self, session: Session) -> None:
        try:
            session.record.write(self.folder / "episode.json")
        except OSError as error:
            raise FuseError(f"{self.folder / 'episode.json'} cannot be written: {error}") from None

    def _write_step(self, glance: Glance, maps: EvidenceMaps | None) -> None:
        rgb, folder = glance.observation.rgb, self.folder / "steps" / f"{glance.viewpoint.index:02d}"
        folder.mkdir(parents=True, exist_ok=True)
        visualize.write(folder / "observation.png", visualize.picture(rgb))
        if maps is None:
            return
        visualize.write(folder / "semantic.png", visualize.heat(rgb, maps.semantic, 1.0))
        if maps.geometric is not None:
            visualize.write(folder / "geometric.png", visualize.heat(rgb, maps.geometric, 0.8))
        visualize.write(folder / "evidence.png", visualize.heat(rgb, maps.field, 1.8))


def _title(session: Session, grounded: Grounded) -> str:
    record = session.record
    where = _where(grounded)
    labels = ", ".join(session.hypotheses.labels)
    return f'"{record.query}"  ->  {record.verb}: {labels}   |   {record.method}, {where}'


def _where(grounded: Grounded) -> str:
    view = grounded.viewpoint
    ring = "" if view.node is None else f", node {view.node}, {view.pitch_deg:.0f} deg down"
    return f"view {view.index}{ring}"


def _caption(grounded: Grounded) -> str:
    if not grounded.found:
        return f"nothing found ({_where(grounded)})"
    score = "" if grounded.score is None else f"  grounding score {grounded.score:.3f}"
    return f"{grounded.label}  instance score {grounded.instance_score:.3f}{score}  {_where(grounded)}"
