"""`fuse run QUERY`: one whole episode, told step by step, with its record and pictures in a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fuse_grounding import knowledge
from fuse_grounding.agent import Agent
from fuse_grounding.benchmark.metrics import evaluate
from fuse_grounding.cli.capture import PhotoNotes, open_capture, photographed
from fuse_grounding.cli.console import Narrator, interruptible, print_json
from fuse_grounding.config import Config, SensorConfig
from fuse_grounding.environment import ReplayEnvironment, TabletopEnvironment, make_episode
from fuse_grounding.errors import InputError
from fuse_grounding.record import EpisodeRecord
from fuse_grounding.runfolder import RunFolder, check, prepare

Segmenter = Annotated[
    str | None,
    typer.Option(
        help="embedded, embedded_patches, sam3, clip_patches or package.module:Class; default: embedded."
    ),
]
Weights = Annotated[Path | None, typer.Option(help="Checkpoint folder or file of the segmenter.")]
OpenVocabulary = Annotated[
    str | None,
    typer.Option(
        help="What becomes of labels that the segmenter does not know: leave_out (default), nearest."
    ),
]


def configure(path: Path | None, overrides: list[str], **choices: str | Path | None) -> Config:
    """The configuration file, then `--set`, then the named options. Raises InputError."""
    named = []
    for key, value in choices.items():
        if value is not None:
            # A path is a string whatever it looks like; other values are read as `--set` reads them.
            text = json.dumps(str(value)) if isinstance(value, Path) else value
            named.append(f"{key.replace('__', '.')}={text}")
    return Config.load(path, [*overrides, *named])


def next_folder(root: Path) -> Path:
    """The first of root/001, root/002, ... that does not exist."""
    number = 1
    while (root / f"{number:03d}").exists():
        number += 1
    return root / f"{number:03d}"


def command(
    query: Annotated[str, typer.Argument(help='What it is for, such as "cut a piece of rope".')],
    scene: Annotated[str | None, typer.Option(help="Scene, of `fuse episodes scenes`.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    method: Annotated[str | None, typer.Option(help="How to search; default: fuse.")] = None,
    segmenter: Segmenter = None,
    weights: Weights = None,
    open_vocabulary: OpenVocabulary = None,
    capture: Annotated[
        Path | None,
        typer.Option(help="Folder of photos to search instead of a made scene (docs/capture.md)."),
    ] = None,
    start: Annotated[
        str | None, typer.Option(help="Photo to start from; default: the first by name.")
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            help="Mean distance from camera to scene in metres; or `poses`: they are in metres, z up."
        ),
    ] = None,
    hfov: Annotated[
        float | None,
        typer.Option(help="Horizontal field of view of the photos, degrees; default: EXIF, COLMAP."),
    ] = None,
    source: Annotated[
        str | None, typer.Option("--knowledge", help="graph, plain, llm, oracle or direct; default: graph.")
    ] = None,
    registration: Annotated[str | None, typer.Option(help="colmap or posed; default: colmap.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Empty or new folder; default: the next runs/NNN.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier run in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the record as JSON only.")] = False,
) -> None:
    """Run one episode: from a query in words to the grounded object."""
    settings = configure(
        config,
        overrides or [],
        method=method,
        segmenter__name=segmenter,
        segmenter__weights=weights,
        knowledge__open_vocabulary=open_vocabulary,
        knowledge__source=source,
        registration__backend=registration,
    )
    out = out or next_folder(Path("runs"))
    check(out, force)
    verb = knowledge.parse(query).verb
    narrator = Narrator(quiet=as_json)
    if capture is not None:
        if scene is not None or seed != 0:
            raise InputError(f"--capture {capture} is the scene: --scene and --seed are for made ones")
        if settings.sensor != SensorConfig():
            raise InputError(f"--capture {capture}: photos come from a real sensor; leave out `sensor`")
        replay = open_capture(capture, settings, start, scale, hfov)
        agent = Agent(photographed(settings, replay))
        if agent.start(query).policy.start == "canonical":
            raise InputError(f"method `{settings.method}` looks straight down, where --capture has no photo")
        _run_capture(agent, replay, query, prepare(out, force), narrator, as_json)
        return
    for name, value in (("--start", start), ("--scale", scale), ("--hfov", hfov)):
        if value is not None:
            raise InputError(f"{name} {value} is for photos: --capture names their folder")
    agent = Agent(settings)
    with interruptible():
        episode = make_episode(verb, scene, seed, query=query)
    environment = TabletopEnvironment(episode, agent.config.render.device, sensor=agent.config.sensor)
    folder = prepare(out, force)
    files = RunFolder(folder, episode.episode_id, episode.scene_id, episode.seed)
    narrator.say(f"episode     {episode.episode_id}: scene {episode.scene_id}, seed {episode.seed}")
    try:
        grounded = agent.run(environment, query, watchers=[files, narrator])
    finally:
        narrator.close()
    assert grounded.record.result is not None
    grounded.record.result.metrics = evaluate(grounded, environment, agent.segmenter, agent.config)
    _conclude(grounded.record, folder, narrator, as_json)


def _run_capture(
    agent: Agent, world: ReplayEnvironment, query: str, folder: Path, narrator: Narrator, as_json: bool
) -> None:
    """An episode among photos: there is no truth to measure it by."""
    name = world.capture.folder.resolve().name
    files = RunFolder(folder, name, str(world.capture.folder))
    narrator.say(f"capture     {world.capture.folder}: {len(world.capture.names)} photos, from {world.photo}")
    try:
        grounded = agent.run(world, query, watchers=[PhotoNotes(world), files, narrator])
    finally:
        narrator.close()
    _conclude(grounded.record, folder, narrator, as_json)


def _conclude(record: EpisodeRecord, folder: Path, narrator: Narrator, as_json: bool) -> None:
    assert record.result is not None
    record.write(folder / "episode.json")
    narrator.result(record.result, str(folder))
    if record.photos is not None and record.result.view is not None:
        narrator.say(f"photo       {record.photos[record.result.view.index]}")
    if as_json:
        print_json({"out": str(folder), **record.model_dump(mode="json")})
